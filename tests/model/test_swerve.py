"""The yaw after the loss of a bus, by hand for simple robots."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.examples import example_robot
from tests.runtime.can_base.test_even_stop import robot
from thorvaldc.model.stopping import (
    BUS_LOST,
    BUS_SILENT,
    bus_response_time,
    swerve_bounds,
    yaw_per_metre,
)


def test_one_bus_for_each_side() -> None:
    """The yaw is the difference of the paths by the track."""
    model = robot("Thorvald script")
    port = model.buses[0]
    ys = [wheel.y for wheel in model.wheels if wheel.driven]
    track = max(ys) - min(ys)
    assert yaw_per_metre(model, [port]) == pytest.approx(1.0 / track)
    unknown = bus_response_time(port) + 2.0 / model.driver.rate
    bounds = {b.kind: b.yaw for b in swerve_bounds(model)}
    assert bounds[BUS_LOST] == pytest.approx(0.8 * unknown / track)
    assert bounds[BUS_SILENT] == pytest.approx(0.8 * (0.5 + unknown) / track)


def test_a_heartbeat_period_of_the_master_is_unknown() -> None:
    bounds = [
        {b.kind: b.yaw for b in swerve_bounds(robot(d))} for d in ("CiA 402", "Thorvald script")
    ]
    track = 1.0 / yaw_per_metre(robot("CiA 402"), [robot("CiA 402").buses[0]])
    difference = (bounds[0][BUS_LOST] - bounds[1][BUS_LOST]) * track / 0.8
    assert difference == pytest.approx(0.1, abs=0.005)


def test_the_same_yaw_by_all_buses_cancels() -> None:
    model = robot("CiA 402")
    assert yaw_per_metre(model, model.buses) == 0.0


def test_a_robot_with_one_bus_has_no_bound() -> None:
    assert swerve_bounds(example_robot("4wd4ws_wide")) == ()


def test_a_drive_without_watchdog_runs_on() -> None:
    model = robot("CiA 402")
    nodes = tuple(replace(n, heartbeat_consumer_time=None) for n in model.buses[0].nodes)
    model = replace(model, buses=(replace(model.buses[0], nodes=nodes), model.buses[1]))
    assert all(math.isinf(bound.yaw) for bound in swerve_bounds(model))
