"""Load, periods and problems of frames that reach the monitor at times that the tests choose."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.simulation.bus.robots import cia402_robot
from thorvaldc.can.frame import CanFrame, ReceivedFrame
from thorvaldc.can.frame_bits import frame_bits
from thorvaldc.tools.monitor.bus_monitor import BusMonitor

REPORT, HEARTBEAT, EMERGENCY = 0x181, 0x701, 0x081
"""Report every 20 ms; heartbeat every 100 ms."""
DATA = bytes([0x27, 0x06, 1, 0, 0, 0, 0, 0])


class Bus:
    """A monitor that gets frames from the test."""

    def __init__(self) -> None:
        robot = cia402_robot()
        self.bus = robot.buses[0]
        self.monitor = BusMonitor(robot, self.bus)
        self.length = next(f.length for f in self.bus.frames if f.cob_id == REPORT)

    def send(self, time: float, identifier: int = REPORT, data: bytes | None = None) -> CanFrame:
        payload = DATA[: self.length] if data is None else data
        frame = CanFrame(identifier, payload)
        self.monitor.take(ReceivedFrame(round(time * 1e9), frame, False))
        return frame

    def frame(self, now: float, identifier: int = REPORT) -> dict[str, Any]:
        frames: list[dict[str, Any]] = self.monitor.summary(now)["frames"]
        name = next(f.name for f in self.bus.frames if f.cob_id == identifier)
        return next(frame for frame in frames if frame["name"] == name)

    def node_of_summary(self, now: float) -> dict[str, Any]:
        nodes: list[dict[str, Any]] = self.monitor.summary(now)["nodes"]
        return next(node for node in nodes if node["id"] == 1)

    def node(self, now: float) -> dict[str, Any]:
        nodes: list[dict[str, Any]] = self.monitor.summary(now)["nodes"]
        return next(node for node in nodes if node["id"] == 1 and node["nmt"] is not None)


def test_load_of_the_last_second() -> None:
    bus = Bus()
    assert bus.monitor.summary(0.0)["load"] == 0.0
    bits = 0
    for tick in range(20):
        bits += frame_bits(bus.send(10.0 + 0.02 * tick))
    summary = bus.monitor.summary(10.5)
    assert summary["load"] == pytest.approx(bits / (bus.bus.bitrate * 0.5))
    assert summary["highest_load"] == summary["load"]
    assert summary["frames_per_second"] == pytest.approx(40.0)
    summary = bus.monitor.summary(11.0)
    assert summary["load"] == pytest.approx(bits / bus.bus.bitrate)
    summary = bus.monitor.summary(11.1)  # of 20 frames, those of the first 0.1 s count no more
    assert summary["load"] == pytest.approx(bits * 14 / 20 / bus.bus.bitrate, rel=0.08)
    assert summary["frames_per_second"] in (14.0, 15.0)
    summary = bus.monitor.summary(12.0)
    assert (summary["load"], summary["frames_total"]) == (0.0, 20)
    assert summary["highest_load"] == pytest.approx(bits / bus.bus.bitrate)


def test_a_missing_frame_is_no_problem_before_the_monitor_has_listened_for_a_second() -> None:
    bus = Bus()
    assert bus.frame(5.0)["problem"] == ""
    assert bus.frame(5.9)["problem"] == ""
    assert bus.frame(6.0)["problem"] == "never"
    assert bus.node_of_summary(5.4)["silent"] is False
    assert bus.node_of_summary(6.0)["silent"] is True


def test_a_node_sends_its_reports_only_while_it_is_operational() -> None:
    bus = Bus()
    for tick in range(100):
        bus.send(1.0 + 0.1 * tick, HEARTBEAT, b"\x7f")
    assert bus.frame(11.0)["problem"] == ""
    bus.send(11.0, HEARTBEAT, b"\x05")
    assert bus.frame(11.9)["problem"] == ""
    bus.send(12.0, HEARTBEAT, b"\x05")
    assert bus.frame(12.0)["problem"] == "never"
    bus.send(12.1, HEARTBEAT, b"\x7f")
    assert bus.frame(12.1)["problem"] == ""


def test_a_node_that_starts_may_send_its_reports_too_often() -> None:
    bus = Bus()
    bus.send(1.0, HEARTBEAT, b"\x05")
    for tick in range(90):
        bus.send(1.0 + 0.01 * tick)
    assert bus.frame(1.9)["problem"] == ""
    for tick in range(90, 200):
        bus.send(1.0 + 0.01 * tick)
    assert bus.frame(3.0)["problem"] == "too often"


def test_the_period_is_the_mean_of_the_last_eight_gaps() -> None:
    bus = Bus()
    bus.send(0.0)
    assert bus.frame(0.0)["period"] is None
    for tick in range(1, 9):
        bus.send(1.0 + 0.02 * tick)
    assert bus.frame(1.2)["period"] == pytest.approx(1.16 / 8)
    bus.send(1.18)
    frame = bus.frame(1.18 + 0.029)
    assert frame["period"] == pytest.approx(0.02)
    assert frame["age"] == pytest.approx(0.029)
    assert frame["count"] == 10
    assert frame["problem"] == ""
    assert bus.frame(1.18 + 0.031)["problem"] == "late"


@pytest.mark.parametrize(("share", "problem"), [(0.71, ""), (0.69, "too often")])
def test_frames_that_come_too_often(share: float, problem: str) -> None:
    bus = Bus()
    for tick in range(8):
        bus.send(share * 0.02 * tick)
    assert bus.frame(share * 0.14)["problem"] == ""
    bus.send(share * 0.16)
    assert bus.frame(share * 0.16)["problem"] == problem


@pytest.mark.parametrize(("period", "gaps"), [(0.49, 8), (0.5, 4)])
def test_slow_frames_need_fewer_gaps(period: float, gaps: int) -> None:
    bus = Bus()
    robot = cia402_robot()
    frames = tuple(replace(f, period=period) if f.cob_id == REPORT else f for f in bus.bus.frames)
    bus.bus = replace(bus.bus, frames=frames)
    bus.monitor = BusMonitor(robot, bus.bus)
    for tick in range(gaps):
        bus.send(0.01 * tick)
    assert bus.frame(0.1)["problem"] == ""
    bus.send(0.01 * gaps)
    assert bus.frame(0.1)["problem"] == "too often"


def test_frames_that_are_too_short_keep_the_last_values() -> None:
    bus = Bus()
    bus.send(0.0)
    values = bus.frame(0.0)["values"]
    bus.send(0.02, data=b"\1")
    frame = bus.frame(0.02)
    assert frame["problem"] == "1 of 2 too short"
    assert frame["values"] == values


def test_a_silent_node() -> None:
    bus = Bus()
    bus.send(1.0, HEARTBEAT, b"\x05")
    timeout = next(n.heartbeat_timeout for n in bus.bus.nodes if n.name == "fl_controller")
    assert timeout == 0.5
    node = bus.node(1.5)
    assert (node["nmt"], node["heard"], node["silent"]) == ("operational", 0.5, False)
    bus.send(1.6)
    node = bus.node(1.625)
    assert (node["heard"], node["silent"]) == (pytest.approx(0.025), True)


def test_emergencies_are_kept_in_their_order() -> None:
    bus = Bus()
    for k in range(103):
        bus.send(float(k), EMERGENCY, bytes([0x10 + k % 2, 0x43, 5, 1, 2, 3, 4, 5]))
    bus.send(200.0, EMERGENCY, bytes(8))
    bus.send(201.0, EMERGENCY, b"\1")
    emergencies = bus.monitor.summary(201.0)["emergencies"]
    assert len(emergencies) == 100
    assert emergencies[0]["time"] == 4.0
    assert emergencies[-2] == {
        "time": 102.0,
        "node": "fl_controller",
        "code": 0x4310,
        "register": 5,
        "data": "0102030405",
        "over": False,
    }
    assert (emergencies[-1]["code"], emergencies[-1]["over"]) == (0, True)


def test_unknown_frames() -> None:
    bus = Bus()
    for tick in range(3):
        bus.send(0.25 * tick, 0x7A0, b"\xab")
    (unknown,) = bus.monitor.summary(1.0)["unknown"]
    assert unknown == {
        "id": 0x7A0,
        "extended": False,
        "count": 3,
        "age": 0.5,
        "period": 0.25,
        "data": "ab",
    }
