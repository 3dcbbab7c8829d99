"""A bus is watched in virtual time, and nothing is sent for it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import pytest

from tests.examples import example_robot
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import cia402_robot
from thorvaldc.can.frame import CanFrame
from thorvaldc.model import Robot
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot
from thorvaldc.simulation.bus.virtual_time_interface import VirtualTimeInterface
from thorvaldc.tools.monitor.bus_monitor import MOST_UNKNOWN, BusMonitor, watch
from thorvaldc.tools.monitor.monitor_text import monitor_lines, page

ROBOT = example_robot("4wd4ws_wide")


class Watched:
    """A robot that runs on its bus, and a monitor beside it."""

    def __init__(self, robot: Robot = ROBOT) -> None:
        self.rig = Rig(robot)
        simulated = self.rig.simulated
        self.port = simulated.interface(name="monitor", listen_only=True, receive_limit=1_000_000)
        self.other = simulated.interface(name="other")
        self.monitor = BusMonitor(robot, robot.buses[0])

    def summary(self) -> dict[str, Any]:
        while (received := self.port.receive(0.0)) is not None:
            self.monitor.take(received)
        return self.monitor.summary(self.port.now)

    def frame(self, name: str) -> dict[str, Any]:
        return next(f for f in self.summary()["frames"] if f["name"] == name)

    def node(self, name: str) -> dict[str, Any]:
        return next(n for n in self.summary()["nodes"] if n["name"] == name)


@pytest.fixture
def driving() -> Watched:
    watched = Watched()
    watched.rig.drive(seconds=3.0)
    return watched


def test_frames_have_their_period_and_values(driving: Watched) -> None:
    found = driving.summary()
    assert not found["unknown"]
    cyclic = [f for f in found["frames"] if f["period_expected"] is not None]
    assert len(cyclic) > 25
    for frame in cyclic:
        assert frame["age"] <= 1.1 * frame["period_expected"]
        if frame["period_expected"] < 0.5:  # slower ones have just been set up
            assert frame["problem"] == "", frame
            assert frame["period"] == pytest.approx(frame["period_expected"], rel=0.1), frame
    report = driving.frame("fl_controller_tpdo1")
    assert report["values"]["propulsion_velocity"] == pytest.approx(0.5 / 0.2, rel=0.02)
    assert report["units"]["propulsion_velocity"] == "rad/s"
    assert driving.frame("fl_controller_rpdo3")["values"]["propulsion_mode"] == "drive"
    assert {n["nmt"] for n in found["nodes"] if n["name"].endswith("controller")} == {"operational"}


def test_the_load_is_what_the_wire_was_busy(driving: Watched) -> None:
    wire = driving.rig.simulated.wire()
    driving.summary()
    busy, now = wire.busy, driving.rig.simulated.timeline.now
    driving.rig.run(1.0)
    share = (wire.busy - busy) / (driving.rig.simulated.timeline.now - now)
    found = driving.summary()
    assert found["load"] == pytest.approx(share, rel=0.01)
    assert 0.5 * found["load_budget"] < found["load"] <= found["highest_load"]
    assert found["highest_load"] < found["load_budget"]


def test_a_node_that_falls_silent(driving: Watched) -> None:
    driving.summary()
    driving.rig.simulated.devices["fl_controller"].power_off()
    driving.rig.run(0.2)
    assert driving.frame("fl_controller_tpdo1")["problem"] == "late"
    assert not driving.node("fl_controller")["silent"]
    driving.rig.run(2.0)
    assert driving.node("fl_controller")["silent"]
    assert not driving.node("fr_controller")["silent"]
    assert any("fl_controller" in x and "SILENT" in x for x in monitor_lines(driving.summary()))


def test_two_nodes_with_one_id(driving: Watched) -> None:
    driving.rig.simulated.clone("fl_controller", "twin").power_on()
    driving.rig.run(5.0)
    assert driving.frame("fl_controller_heartbeat")["problem"] == "too often"
    assert driving.frame("fr_controller_heartbeat")["problem"] == ""


def test_emergencies_and_what_is_not_in_the_map(driving: Watched) -> None:
    driving.other.send(CanFrame(0x083, bytes.fromhex("3023110000000000")))
    driving.other.send(CanFrame(0x7AB, b"\x01\x02"))
    driving.other.send(CanFrame(0x183, b"\x01", extended=True))
    driving.other.send(CanFrame(0x3C1, b"\x01"))
    driving.rig.run(0.05)
    found = driving.summary()
    (emergency,) = found["emergencies"]
    assert (emergency["node"], emergency["code"], emergency["register"]) == (
        "fl_controller",
        0x2330,
        0x11,
    )
    assert [(u["id"], u["extended"], u["data"]) for u in found["unknown"]] == [
        (0x183, True, "01"),
        (0x7AB, False, "0102"),
    ]
    assert driving.frame("battery_left_status")["problem"].endswith("too short")
    assert driving.frame("battery_left_status")["values"]["voltage"] == pytest.approx(48.0)
    text = "\n".join(monitor_lines(found))
    assert "fl_controller: error 0x2330 register 0x11" in text
    assert "NOT IN THE MAP 7ab  1 frames" in text
    assert "NOT IN THE MAP 00000183" in text
    assert "TOO SHORT  charge_enabled" in text


def test_many_identifiers_that_are_not_in_the_map() -> None:
    """A babbling node, or the bus of another robot: bounded, and counted."""
    watched = Watched()
    for number in range(MOST_UNKNOWN + 20):
        watched.other.send(CanFrame(0x10000 + number, b"", extended=True), timeout=1.0)
    watched.rig.run(0.5)
    assert len(watched.summary()["unknown"]) == MOST_UNKNOWN
    assert watched.monitor.unknown_lost == 20


def test_drives_after_cia_402_have_their_states() -> None:
    watched = Watched(cia402_robot())
    watched.rig.run(0.6)
    name = next(n["name"] for n in watched.summary()["nodes"] if "controller" in n["name"])
    before = watched.node(name)["drive"]
    watched.rig.drive(seconds=1.0)
    drive = watched.node(name)["drive"]
    states = {key: state for key, state in drive.items() if state is not None}
    assert set(states.values()) == {"operation enabled"}, drive
    assert before != drive
    watched.rig.runner.safety_stop()
    watched.rig.run(2.0)
    stopped = {state for state in watched.node(name)["drive"].values() if state is not None}
    assert "operation enabled" not in stopped


# -- listening --------------------------------------------------------------------------------


class Silent(VirtualTimeInterface):
    """A port over which nothing may be sent."""

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        raise AssertionError("a monitor sends nothing")


def test_it_listens_in_intervals_and_sends_nothing() -> None:
    simulated = SimulatedRobot(ROBOT)
    simulated.power_on()
    port = Silent(simulated.wire(), listen_only=True)
    simulated.interface()  # somebody who acknowledges
    told: list[Mapping[str, Any]] = []
    watch(port, BusMonitor(ROBOT, ROBOT.buses[0]), 0.5, told.append, until=3.0)
    assert [found["time"] for found in told] == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
    assert told[-1]["controller"] == "error-active"
    assert told[-1]["overruns"] == 0
    states = {n["nmt"] for n in told[-1]["nodes"] if n["protocol"] == "thorvald_roboteq"}
    assert states == {"pre-operational"}
    never = [f["name"] for f in told[-1]["frames"] if f["problem"] == "never"]
    assert "sync" in never
    assert "fl_controller_heartbeat" not in never


def test_it_ends_when_it_is_told_to() -> None:
    simulated = SimulatedRobot(ROBOT)
    port = simulated.interface(listen_only=True)
    told: list[Mapping[str, Any]] = []
    watch(port, BusMonitor(ROBOT, ROBOT.buses[0]), 0.5, told.append, ended=lambda: port.now > 1.2)
    assert len(told) == 2
    assert told[-1]["load"] == 0.0
    assert port.now < 1.4
    lines = monitor_lines(told[-1])
    assert lines[0].startswith("thorvald_4wd4ws_wide main  500 kbit/s  load 0.0 %")
    assert any("fl_controller" in line and "never heard" in line for line in lines)


# -- text ----------------------------------------------------------------------------------------


def test_a_line_of_a_frame(driving: Watched) -> None:
    lines = monitor_lines(driving.summary())
    line = next(line for line in lines if "fl_controller_tpdo1" in line)
    assert line.split()[:4] == ["183", "fl_controller_tpdo1", "20", "ms"]
    assert re.search(r"propulsion_velocity (2\.49|2\.5)\d* rad/s  steering_velocity", line)
    flags = next(line for line in lines if "fl_controller_tpdo3" in line)
    assert "stall" not in flags  # flags that are not set are left out


def test_pages() -> None:
    lines = [str(i) for i in range(10)]
    assert page(lines, 10, 5) == lines
    assert page(lines, 5, 0) == ["0", "1", "2", "3", "-- 1 to 4 of 10 lines; arrow keys --"]
    assert page(lines, 5, 99)[:-1] == ["6", "7", "8", "9"]
