"""A map and a filter made of the measurements of a drive."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.figure import EXAMPLE
from bench.sensors import filtered, mapped, room, with_gnss
from tests.examples import example_robot


@pytest.mark.slow
def test_a_drive_gives_a_map_of_the_room(tmp_path: Path) -> None:
    result = mapped(room(EXAMPLE, tmp_path, 16.0))
    assert result.error < 0.02
    assert result.covered > 0.98


def test_a_map_of_a_bad_lidar_is_worse(tmp_path: Path) -> None:
    assert mapped(room(EXAMPLE, tmp_path, 6.0, errors=5.0)).error > 0.04


@pytest.mark.slow
def test_the_filter_of_the_generated_files_is_consistent() -> None:
    robot = example_robot("4wd4ws_wide")
    white = filtered(with_gnss(robot, 0.0), runs=5).mean()
    assert 0.5 < white < 2.0
    # Fixes whose errors last make the filter too sure of its position.
    assert filtered(with_gnss(robot, 0.9), runs=5).mean() > 1.3 * white
