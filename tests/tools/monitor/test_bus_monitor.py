"""The bus monitor in virtual time: its summary, its text, and that it sends nothing."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import pytest

from tests.examples import example_robot
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import cia402_robot
from thorvaldc.can.frame import CanFrame, ReceivedFrame
from thorvaldc.model import Robot
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot, VirtualTimeInterface
from thorvaldc.tools.monitor.bus_monitor import MOST_UNKNOWN, BusMonitor, watch
from thorvaldc.tools.monitor.monitor_view import monitor_lines, page

ROBOT = example_robot("4wd4ws_wide")


class MonitoredRobot:
    """A robot that drives on its bus, and a monitor."""

    def __init__(self, robot: Robot = ROBOT) -> None:
        self.rig = Rig(robot)
        simulated = self.rig.simulated
        self.interface = simulated.interface(
            name="monitor", listen_only=True, receive_limit=1_000_000
        )
        self.other = simulated.interface(name="other")
        self.monitor = BusMonitor(robot, robot.buses[0])

    def summary(self) -> dict[str, Any]:
        while (received := self.interface.receive(0.0)) is not None:
            self.monitor.take(received)
        return self.monitor.summary(self.interface.now)

    def frame(self, name: str) -> dict[str, Any]:
        return next(f for f in self.summary()["frames"] if f["name"] == name)

    def node(self, name: str) -> dict[str, Any]:
        return next(n for n in self.summary()["nodes"] if n["name"] == name)


@pytest.fixture
def driving() -> MonitoredRobot:
    monitored = MonitoredRobot()
    monitored.rig.drive(seconds=3.0)
    return monitored


def test_frames_have_their_period_and_values(driving: MonitoredRobot) -> None:
    summary = driving.summary()
    assert not summary["unknown"]
    cyclic = [f for f in summary["frames"] if f["period_expected"] is not None]
    assert len(cyclic) > 25
    for frame in cyclic:
        assert frame["age"] <= 1.1 * frame["period_expected"]
        if frame["period_expected"] < 0.5:  # frames with longer periods have only started
            assert frame["problem"] == "", frame
            assert frame["period"] == pytest.approx(frame["period_expected"], rel=0.1), frame
    report = driving.frame("fl_controller_tpdo1")
    assert report["values"]["propulsion_velocity"] == pytest.approx(0.5 / 0.2, rel=0.02)
    assert report["units"]["propulsion_velocity"] == "rad/s"
    assert driving.frame("fl_controller_rpdo3")["values"]["propulsion_mode"] == "drive"
    assert {n["nmt"] for n in summary["nodes"] if n["name"].endswith("controller")} == {
        "operational"
    }


def test_the_highest_load_of_a_short_time_is_the_load(driving: MonitoredRobot) -> None:
    monitor = BusMonitor(driving.rig.robot, driving.rig.robot.buses[0])
    monitor.take(ReceivedFrame(0, CanFrame(0x80)))
    summary = monitor.summary(0.5)
    assert summary["highest_load"] == summary["load"] > 0.0


def test_the_load_is_the_busy_time_of_the_wire(driving: MonitoredRobot) -> None:
    wire = driving.rig.simulated.wire()
    driving.summary()
    busy, now = wire.busy, driving.rig.simulated.timeline.now
    driving.rig.run(1.0)
    share = (wire.busy - busy) / (driving.rig.simulated.timeline.now - now)
    summary = driving.summary()
    assert summary["load"] == pytest.approx(share, rel=0.01)
    assert 0.5 * summary["load_budget"] < summary["load"] <= summary["highest_load"]
    assert summary["highest_load"] < summary["load_budget"]


def test_a_node_that_stops_sending(driving: MonitoredRobot) -> None:
    driving.summary()
    driving.rig.simulated.devices["fl_controller"].power_off()
    driving.rig.run(0.2)
    assert driving.frame("fl_controller_tpdo1")["problem"] == "late"
    assert not driving.node("fl_controller")["silent"]
    driving.rig.run(2.0)
    assert driving.node("fl_controller")["silent"]
    assert not driving.node("fr_controller")["silent"]
    assert any("fl_controller" in x and "SILENT" in x for x in monitor_lines(driving.summary()))


@pytest.mark.slow
def test_two_nodes_with_one_id(driving: MonitoredRobot) -> None:
    driving.rig.simulated.clone("fl_controller", "twin").power_on()
    driving.rig.run(5.0)
    assert driving.frame("fl_controller_heartbeat")["problem"] == "too often"
    assert driving.frame("fr_controller_heartbeat")["problem"] == ""


def test_emergencies_and_frames_outside_the_map(driving: MonitoredRobot) -> None:
    driving.other.send(CanFrame(0x083, bytes.fromhex("3023110000000000")))
    driving.other.send(CanFrame(0x7AB, b"\x01\x02"))
    driving.other.send(CanFrame(0x183, b"\x01", extended=True))
    driving.other.send(CanFrame(0x3C1, b"\x01"))
    driving.rig.run(0.05)
    summary = driving.summary()
    (emergency,) = summary["emergencies"]
    assert (emergency["node"], emergency["code"], emergency["register"]) == (
        "fl_controller",
        0x2330,
        0x11,
    )
    assert [(u["id"], u["extended"], u["data"]) for u in summary["unknown"]] == [
        (0x183, True, "01"),
        (0x7AB, False, "0102"),
    ]
    assert driving.frame("battery_left_status")["problem"].endswith("too short")
    assert driving.frame("battery_left_status")["values"]["voltage"] == pytest.approx(48.0)
    text = "\n".join(monitor_lines(summary))
    assert "fl_controller: error 0x2330 register 0x11" in text
    assert "NOT IN THE MAP 7ab  1 frames" in text
    assert "NOT IN THE MAP 00000183" in text
    assert "TOO SHORT  charge_enabled" in text


def test_many_identifiers_outside_the_map() -> None:
    """A babbling node, or the bus of another robot: the list is bounded."""
    monitored = MonitoredRobot()
    for number in range(MOST_UNKNOWN + 20):
        monitored.other.send(CanFrame(0x10000 + number, b"", extended=True), timeout=1.0)
    monitored.rig.run(0.5)
    assert len(monitored.summary()["unknown"]) == MOST_UNKNOWN
    assert monitored.monitor.unknown_lost == 20


@pytest.mark.slow
def test_states_of_cia_402_drives() -> None:
    monitored = MonitoredRobot(cia402_robot())
    monitored.rig.run(0.6)
    name = next(n["name"] for n in monitored.summary()["nodes"] if "controller" in n["name"])
    before = monitored.node(name)["drive"]
    monitored.rig.drive(seconds=1.0)
    drive = monitored.node(name)["drive"]
    states = {key: state for key, state in drive.items() if state is not None}
    assert set(states.values()) == {"operation enabled"}, drive
    assert before != drive
    monitored.rig.driven.safety_stop()
    monitored.rig.run(2.0)
    stopped = {state for state in monitored.node(name)["drive"].values() if state is not None}
    assert "operation enabled" not in stopped


# -- listening --------------------------------------------------------------------------------


class ListeningInterface(VirtualTimeInterface):
    """A CAN interface over which nothing may be sent."""

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        raise AssertionError("a monitor sends nothing")


def test_watch_listens_in_intervals_and_sends_nothing() -> None:
    simulated = SimulatedRobot(ROBOT)
    simulated.power_on()
    interface = ListeningInterface(simulated.wire(), listen_only=True)
    simulated.interface()  # a node that acknowledges frames
    summaries: list[Mapping[str, Any]] = []
    watch(interface, BusMonitor(ROBOT, ROBOT.buses[0]), 0.5, summaries.append, until=3.0)
    assert [summary["time"] for summary in summaries] == pytest.approx(
        [0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    )
    assert summaries[-1]["controller"] == "error-active"
    assert summaries[-1]["overruns"] == 0
    states = {n["nmt"] for n in summaries[-1]["nodes"] if n["protocol"] == "thorvald_roboteq"}
    assert states == {"pre-operational"}
    never = [f["name"] for f in summaries[-1]["frames"] if f["problem"] == "never"]
    assert "sync" in never
    assert "fl_controller_heartbeat" not in never


def test_watch_ends_on_request() -> None:
    simulated = SimulatedRobot(ROBOT)
    interface = simulated.interface(listen_only=True)
    summaries: list[Mapping[str, Any]] = []
    watch(
        interface,
        BusMonitor(ROBOT, ROBOT.buses[0]),
        0.5,
        summaries.append,
        ended=lambda: interface.now > 1.2,
    )
    assert len(summaries) == 2
    assert summaries[-1]["load"] == 0.0
    assert interface.now < 1.4
    lines = monitor_lines(summaries[-1])
    assert lines[0].startswith("thorvald_4wd4ws_wide main  500 kbit/s  load 0.0 %")
    assert any("fl_controller" in line and "no frame yet" in line for line in lines)


# -- text ----------------------------------------------------------------------------------------


def test_the_line_of_a_frame(driving: MonitoredRobot) -> None:
    lines = monitor_lines(driving.summary())
    narrow = monitor_lines(driving.summary(), 80)
    assert all(len(line) <= 80 for line in narrow), max(narrow, key=len)
    assert " ".join(" ".join(narrow).split()) == " ".join(
        " ".join(lines).replace("  values", "").split()
    )
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
