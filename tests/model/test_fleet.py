"""Zones of the ground: which points they hold."""

from __future__ import annotations

import math

import pytest

from thorvaldc.model import Pose, Zone


@pytest.mark.parametrize(
    ("x", "y", "holds"),
    [
        # 4 m x 1 m about (10, 5), turned by 90 degrees: 1 m along x and 4 m along y.
        (10.0, 5.0, True),
        (10.49, 6.99, True),
        (9.51, 3.01, True),
        (10.51, 5.0, False),
        (9.49, 5.0, False),
        (10.0, 7.01, False),
        (10.0, 2.99, False),
    ],
)
def test_points_in_a_turned_zone(x: float, y: float, holds: bool) -> None:
    pose = Pose.from_xyz_rpy((10.0, 5.0, 0.5), (0.0, 0.0, math.pi / 2))
    assert Zone(pose, (4.0, 1.0)).holds(x, y) is holds


def test_a_zone_with_height_or_bumps_is_not_level() -> None:
    assert Zone(Pose(), (1.0, 1.0), friction=0.3).level
    assert not Zone(Pose(), (1.0, 1.0), height=0.1).level
    assert not Zone(Pose(), (1.0, 1.0), amplitude=0.1).level
