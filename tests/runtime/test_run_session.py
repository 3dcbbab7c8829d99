"""A run session drives a robot from a Python program as the command ``run`` does."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.runtime.can_base.test_late_processes import LateBus
from tests.simulation.bus.robots import CIA402, compiled
from tests.slow import mostly_slow
from thorvaldc.can.frame import CanFrame, CanInterface
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import RequestRefused
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import DriverState
from thorvaldc.runtime.run_session import RunSession
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot


@pytest.fixture(scope="module")
def robot() -> Robot:
    return compiled(CIA402)


@pytest.fixture
def simulated(robot: Robot) -> SimulatedRobot:
    simulated = SimulatedRobot(robot)
    simulated.power_on()
    return simulated


@pytest.fixture
def interfaces(simulated: SimulatedRobot) -> dict[str, CanInterface]:
    return {bus.name: simulated.interface(bus.name) for bus in simulated.robot.buses}


@pytest.mark.slow
def test_a_twist_is_driven_for_the_duration(
    robot: Robot, interfaces: dict[str, CanInterface]
) -> None:
    twist = Twist(0.5, 0.0, 0.0)
    session = RunSession(robot, interfaces, twist=twist, duration=2.0, threaded=False)
    assert session.run() is None
    summary = session.summary()
    assert summary["was_ready"]
    assert 0.5 < summary["pose"]["x"] < 1.0
    # The duration begins when the robot is ready.
    assert session.ready_time + 2.0 < session.start_time + summary["seconds"]
    assert "m/s" in session.status_line()


def test_a_request_stops_the_robot(robot: Robot, interfaces: dict[str, CanInterface]) -> None:
    session = RunSession(robot, interfaces, twist=Twist(0.5, 0.0, 0.0), threaded=False)

    def stop_when_it_drives(runner: DrivenRobot, state: DriverState) -> None:
        if session.base.state is BaseState.ACTIVE:
            session.request_stop()

    assert session.run(stop_when_it_drives) is None
    assert "active" in [change["state"] for change in session.summary()["changes"]]


@pytest.mark.slow
def test_a_session_with_a_twist_arms_the_robot_once(
    robot: Robot, interfaces: dict[str, CanInterface]
) -> None:
    twist = Twist(0.5, 0.0, 0.0)
    session = RunSession(robot, interfaces, twist=twist, duration=3.0, threaded=False)
    disarmed: list[float] = []

    def disarm(runner: DrivenRobot, state: DriverState) -> None:
        if not disarmed and session.base.state is BaseState.ACTIVE and runner.armed:
            runner.disarm()
            disarmed.append(state.time)

    assert session.run(disarm) is None
    summary = session.summary()
    assert not summary["armed"]
    assert [event["text"] for event in summary["events"]] == [
        "homing the steering",
        "armed",
        "disarmed",
    ]


def test_a_session_without_a_twist_leaves_the_robot_disarmed(
    robot: Robot, interfaces: dict[str, CanInterface]
) -> None:
    session = RunSession(robot, interfaces, duration=1.0, threaded=False)
    lines: list[str] = []
    assert session.run(lambda runner, state: lines.append(session.status_line())) is None
    assert any(line.startswith("standby  not homed  battery") for line in lines)


def test_the_status_line_counts_what_was_late_and_what_was_not_relayed(
    robot: Robot, interfaces: dict[str, CanInterface]
) -> None:
    session = RunSession(robot, interfaces, duration=0.5, threaded=False)
    assert session.run() is None
    assert not re.search("overruns|relayed", session.status_line())
    session.driven.timing.overruns = 2
    for cob_id in (0x201, 0x601, 0x601):
        with pytest.raises(RequestRefused):
            session.base.nodes.send_to_device(CanFrame(cob_id, b""), 0.0)
    assert session.status_line().endswith("  2 overruns  3 frames not relayed")


def test_a_robot_that_cannot_be_armed_ends_with_every_reason(
    robot: Robot, interfaces: dict[str, CanInterface]
) -> None:
    session = RunSession(robot, interfaces, twist=Twist(0.5, 0.0, 0.0), threaded=False)
    session.driven.pre_arm_checks.append(lambda runner, now: ["the gate is open", "it rains"])
    diagnostic = session.run()
    assert diagnostic is not None
    assert diagnostic.code.name == "bus-start"
    assert "cannot be armed: the gate is open; it rains" in diagnostic.message
    assert session.summary()["pose"]["x"] == pytest.approx(0.0, abs=1e-3)


def stall(runner: DrivenRobot) -> None:
    runner.clock.sleep_until(runner.now + 0.1)


def lock(runner: DrivenRobot) -> None:
    runner.lock("auto_nav_pause", True)
    runner.run_due_cycle()
    runner.lock("auto_nav_pause", False)


def rearm(runner: DrivenRobot) -> None:
    """Other programs disarm the robot, and arm it again when the source is silent."""
    runner.disarm()
    runner.run(runner.now + 1.0)
    runner.arm()


@pytest.mark.parametrize(
    ("happens", "reason"),
    [
        (stall, r"no control cycle for 1\d\d ms"),
        (lock, "the lock `auto_nav_pause` was active"),
        (rearm, r"`run` was silent for more than [\d.]+ s"),
    ],
)
@pytest.mark.parametrize("channel", mostly_slow([False, True]))
def test_the_twist_of_a_session_ends_as_soon_as_it_was_ineffective(
    happens: Callable[[DrivenRobot], None],
    reason: str,
    channel: bool,
    robot: Robot,
    interfaces: dict[str, CanInterface],
    tmp_path: Path,
) -> None:
    """It once commanded zero itself, and drove off again when the robot had come to rest.

    Without a control channel, nobody can command another twist, so that the run ends.
    """
    name = str(tmp_path / "driver") if channel else ""
    twist, options = Twist(0.5, 0.0, 0.0), {"duration": 8.0, "channel": name, "threaded": False}
    session = RunSession(robot, interfaces, twist=twist, **options)  # type: ignore[arg-type]
    speeds: list[float] = []

    def watch(runner: DrivenRobot, state: DriverState) -> None:
        if not speeds and state.ramped == twist:
            speeds.append(state.ramped.vx)
            happens(runner)
        elif speeds:
            speeds.append(state.ramped.vx)

    diagnostic = session.run(watch)
    assert re.fullmatch(reason, session.twist_ended)
    assert speeds == sorted(speeds, reverse=True)
    assert session.driven.driver.state.ramped == ZERO_TWIST
    assert any(
        e.text == f"the twist has ended: {session.twist_ended}" for e in session.driven.events
    )
    if channel:
        assert diagnostic is None
        assert session.driven.now - session.ready_time > 7.9
    else:
        assert diagnostic is not None
        assert diagnostic.code.name == "bus-stopped"
        assert session.twist_ended in diagnostic.message


@pytest.mark.slow
def test_a_bus_that_stood_for_a_moment_ends_the_twist(
    robot: Robot, simulated: SimulatedRobot
) -> None:
    """No control cycle is late, but the motion of the robot is unknown meanwhile."""
    bus, twist = LateBus(simulated.wire(), fifo=True), Twist(0.5, 0.0, 0.0)
    session = RunSession(robot, {"main": bus}, twist=twist, duration=8.0, threaded=False)
    speeds: list[float] = []

    def watch(runner: DrivenRobot, state: DriverState) -> None:
        if not bus.stops_at and state.ramped == twist:
            bus.stop(0.2)
        if bus.stops_at:
            speeds.append(state.ramped.vx)

    diagnostic = session.run(watch)
    assert diagnostic is not None
    assert re.search(r"the twist has ended: no usable joint states \(.+\)", diagnostic.message)
    assert speeds == sorted(speeds, reverse=True)
    assert session.base.changes[-1].state is not BaseState.FAULT
    assert session.summary()["timing"]["gaps"] == 0


def test_a_channel_in_use_closes_the_interfaces(
    robot: Robot,
    simulated: SimulatedRobot,
    interfaces: dict[str, CanInterface],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("tv")))
    first = RunSession(robot, interfaces, channel="cart", threaded=False)
    closed: list[str] = []
    others = {bus.name: simulated.interface(bus.name) for bus in robot.buses}
    for name, interface in others.items():
        monkeypatch.setattr(interface, "close", lambda name=name: closed.append(name))
    with pytest.raises(OSError, match="already runs"):
        RunSession(robot, others, channel="cart", threaded=False)
    assert closed == list(others)
    first.request_stop()
    first.run()


@pytest.mark.parametrize("late", [0, 1], ids=["all drives", "one drive"])
def test_a_session_waits_for_drives_that_get_their_power_later(
    robot: Robot, simulated: SimulatedRobot, interfaces: dict[str, CanInterface], late: int
) -> None:
    """The run ended after 5.5 s.  It waits disarmed, and says for whom."""
    for device in list(simulated.devices.values())[: 1 if late else None]:
        device.power_off()
    session = RunSession(robot, interfaces, channel="", threaded=False)
    session.driven.feed = lambda driver, now: None
    seen: list[str] = []

    def watch(driven: DrivenRobot, state: DriverState) -> None:
        assert not driven.armed
        if session.elapsed > 12.0 and not seen:
            seen.append(session.status_line())
            for device in simulated.devices.values():
                device.power_on()
        if driven.ready or session.base.state is BaseState.STANDBY:
            session.request_stop()

    assert session.run(watch) is None
    assert seen[0].startswith("waits: no heartbeat of" if late else "waits: no controller responds")
    assert 12.0 < session.elapsed < 20.0
    assert session.waits_for == ""


@pytest.mark.slow
def test_a_waiting_session_begins_no_start_up_under_a_commanded_motion(
    robot: Robot, simulated: SimulatedRobot, interfaces: dict[str, CanInterface]
) -> None:
    for device in simulated.devices.values():
        device.power_off()
    session = RunSession(robot, interfaces, threaded=False)
    source = session.driven.multiplexer.sources[0]
    states = set()

    def watch(driven: DrivenRobot, state: DriverState) -> None:
        moves = session.elapsed < 15.0
        driven.multiplexer.publish(source, Twist(0.3 if moves else 0.0, 0.0, 0.0), driven.now)
        if 6.0 < session.elapsed < 15.0:
            states.add(session.base.state)
        if session.elapsed > 30.0:
            session.request_stop()

    session.run(watch)
    assert states == {BaseState.FAULT}
    changes = [change["state"] for change in session.summary()["changes"]]
    assert changes.count("fault") <= 2, "those that are repeated while it waits are left out"


def test_a_session_with_a_twist_does_not_wait_for_drives(
    robot: Robot, simulated: SimulatedRobot, interfaces: dict[str, CanInterface]
) -> None:
    """Nobody expects the motion when the power comes."""
    for device in simulated.devices.values():
        device.power_off()
    session = RunSession(robot, interfaces, twist=Twist(0.5, 0.0, 0.0), threaded=False)
    diagnostic = session.run()
    assert diagnostic is not None
    assert diagnostic.code.name == "bus-start"
    assert "no controller responds" in diagnostic.message
    assert not session.summary()["was_ready"]
    assert session.elapsed < 7.0
