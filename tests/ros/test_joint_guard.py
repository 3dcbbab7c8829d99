"""The guard in virtual time, without ROS: when it stops the drives, and when it does not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import pytest

from tests.examples import example_robot
from tests.ros.virtual_topics import without_ros
from thorvaldc.model.model_json import to_json

PERIOD = 0.05  # s, between two looks of the guard
BEAT = 0.04  # s, of the heartbeats
SPEED = 3.0  # rad/s, of all drives while the driver lives


class Node:
    """A stand-in for ``rclpy.node.Node``, whose parameters are ``parameters``."""

    parameters: dict[str, Any]
    clock: Callable[[bool], float]
    """Returns the time (s) of ROS, of `/clock` or of the computer."""
    wheels: dict[str, float]

    def __init__(self, name: str) -> None:
        self.logged: list[str] = []

    def declare_parameter(self, name: str, default: Any, descriptor: Any) -> Any:
        return SimpleNamespace(value=self.parameters.get(name, default))

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=self.parameters[name])

    def set_parameters(self, parameters: list[Any]) -> None:
        for parameter in parameters:
            self.parameters[parameter.name] = parameter.value

    def get_clock(self) -> Any:
        nanoseconds = round(self.clock(self.parameters["use_sim_time"]) * 1e9)
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=nanoseconds))

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=self.logged.append)

    def create_publisher(self, kind: Any, topic: str, depth: int) -> Any:
        def publish(message: Any) -> None:
            self.wheels[topic] = message.data

        if topic.endswith("cmd_vel"):
            self.wheels[topic] = SPEED
        return SimpleNamespace(publish=publish)

    def create_subscription(self, kind: Any, topic: str, take: Any, qos: Any) -> None:
        self.take = take


class Rig:
    """A guard, the drives that it stops, and the heartbeats of a driver.

    - ``now``: real time (s), which begins long after the start of the computer;
    - ``simulated``: time (s) of `/clock`, which runs ``factor`` times as fast; ``None``: there is
      no simulation;
    - ``ahead``: stamps of the heartbeats minus the time of ROS, s;
    - ``beats``: whether the driver lives.
    """

    def __init__(self, folder: Path, simulated: float | None) -> None:
        robot = example_robot("4wd4ws_wide")
        (folder / "model.json").write_text(to_json(robot))
        self.now, self.simulated, self.factor = 1000.0, simulated, 1.0
        self.ahead, self.beats = 0.0, True
        self.heard_clock = 0.0
        values = {
            "model_file": str(folder / "model.json"),
            "joint_topics": "gazebo",
            "use_sim_time": simulated is not None,
        }
        members = {
            "parameters": values,
            "clock": lambda node, hears: self._clock(hears),
            "wheels": {},
        }
        parameter = lambda name, value: SimpleNamespace(name=name, value=value)  # noqa: E731
        with without_ros(
            Node=type("VirtualNode", (Node,), members),
            Parameter=parameter,
        ):
            from thorvaldc.ros.joint_guard import JointGuard

            self.guard: Any = JointGuard()
        self.wheels: dict[str, float] = self.guard.wheels
        self._next_beat = self.now

    def _clock(self, hears: bool) -> float:
        if not hears or self.simulated is None:
            return self.now + 5e8  # s, since 1970
        return self.heard_clock

    def run(self, seconds: float) -> None:
        """Lets real time pass; the drives turn with ``SPEED`` until the guard stops them."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.now += 0.01
            if self.simulated is not None:
                self.simulated += 0.01 * self.factor
            with mock.patch("time.monotonic", return_value=self.now):
                self._step()

    def _step(self) -> None:
        if self.simulated is not None and self.guard.parameters["use_sim_time"]:
            self.heard_clock = self.simulated  # a new subscription hears the next message
        if self.beats and self.now >= self._next_beat - 1e-9:
            self._next_beat += BEAT
            stamp = self.now + 5e8 if self.simulated is None else self.simulated
            seconds, nanoseconds = divmod(round((stamp + self.ahead) * 1e9), 1_000_000_000)
            self.guard.take(SimpleNamespace(sec=seconds, nanosec=nanoseconds))
            self.wheels.update(dict.fromkeys(self.wheels, SPEED))
        self.guard.run_due()

    @property
    def is_stopped(self) -> bool:
        speeds = list(self.wheels.values())
        assert len(speeds) == 4
        return not any(speeds)

    def stopped_after(self, longest: float) -> float:
        """Ends the driver, and returns the real time (s) until all drives are stopped."""
        self.beats, start = False, self.now
        while not self.is_stopped and self.now < start + longest:
            self.run(0.01)
        return self.now - start


@pytest.fixture(params=[None, 50.0], ids=["real", "simulated"])
def rig(request: pytest.FixtureRequest, tmp_path: Path) -> Rig:
    return Rig(tmp_path, request.param)


def test_a_driver_that_was_never_heard_is_stopped(rig: Rig) -> None:
    assert rig.stopped_after(1.0) < 0.2
    rig.beats = True
    rig.run(0.1)
    assert not rig.is_stopped


@pytest.mark.parametrize("ahead", [0.0, -100.0, 100.0, 1e9])
def test_a_silent_driver_is_stopped_whatever_its_stamps_are(rig: Rig, ahead: float) -> None:
    """The computer of the driver may have another clock, or the driver another `use_sim_time`."""
    rig.ahead = ahead
    for _ in range(200):
        rig.run(0.05)
        assert not rig.is_stopped
    assert 0.1 < rig.stopped_after(2.0) < 0.5
    rig.beats = True
    rig.run(0.3)
    assert not rig.is_stopped


def test_a_pause_is_no_silence(tmp_path: Path) -> None:
    rig = Rig(tmp_path, 50.0)
    rig.run(20.0)
    rig.beats, rig.factor = False, 0.0
    rig.run(30.0)
    assert not rig.is_stopped
    rig.factor = 1.0
    assert rig.stopped_after(1.0) < 0.4


@pytest.mark.parametrize("factor", [0.1, 0.5, 5.0])
def test_a_simulation_of_another_speed(factor: float, tmp_path: Path) -> None:
    """A slow one is stopped 0.2 s of its own time after the last heartbeat."""
    rig = Rig(tmp_path, 50.0)
    rig.factor = factor
    with mock.patch(f"{__name__}.BEAT", BEAT / factor):
        for _ in range(200):
            rig.run(0.05)
            assert not rig.is_stopped
    assert rig.stopped_after(5.0) < max(0.25 / factor, 0.25) + PERIOD


def test_a_reset_and_a_dead_driver(tmp_path: Path) -> None:
    rig = Rig(tmp_path, 50.0)
    rig.run(10.0)
    rig.beats = False
    rig.run(0.12)
    rig.simulated = 0.0
    assert rig.stopped_after(1.0) < 0.4


def test_a_heartbeat_that_is_late_after_a_calm_time(rig: Rig) -> None:
    """The guard hears `/clock` again, and the time that it heard last is old."""
    rig.stopped_after(1.0)
    rig.beats = True
    rig.run(20.0)
    rig.beats = False
    rig.run(0.18)
    assert not rig.is_stopped
    rig.beats = True
    rig.run(0.5)
    assert not rig.is_stopped
