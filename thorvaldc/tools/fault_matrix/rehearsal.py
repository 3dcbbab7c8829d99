"""A robot with its base driver and one client, on simulated buses, in virtual time.

One control cycle of a rehearsal:

    client --twist--> control channel --> base driver --frames--> simulated devices --> motors
                                                                                          |
    the rehearsal measures the true speeds of the wheels after the cycle        <---------+

The client and the base driver use a real local socket, so that a command can wait in the channel.
Everything runs in one thread: the robot, the seed and the injected fault determine the result.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import random
import socket
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from thorvaldc.can.frame import CanFrame, to_ns
from thorvaldc.diagnostics.files import read_json
from thorvaldc.model import Robot
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.control_channel import ControlServer
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import DriverState
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.bus.fault_injection import FaultInjector
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

LONGEST_START = 60.0
"""Longest time (s) from power-on until the robot is ready."""
FOREIGN_PAUSE = to_ns(0.005)
"""Time (ns) between two messages of a foreign master."""
FRESH = 3.0
"""Control cycles after which the end of a commanded motion must have reached the motors."""


class RehearsalError(ValueError):
    """The robot cannot be rehearsed, because the robot does not drive even without faults."""


class ScriptedClient:
    """A program that commands a twist in every control cycle and never waits for an answer.

    - ``twist``: commanded twist, or ``None`` if the client sends nothing.
    - ``refusals``: error messages in the answers of the base driver.
    """

    def __init__(self, path: Path, source: str) -> None:
        self.source = source
        self.twist: Twist | None = None
        self.refusals: list[str] = []
        self._unread = b""
        self.stream: socket.socket | None = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.stream.connect(str(path))
        self.stream.setblocking(False)

    @property
    def connected(self) -> bool:
        return self.stream is not None

    def send_twist(self) -> None:
        """Sends the commanded twist, and reads the answers to earlier requests."""
        if self.twist is not None:
            self.request("twist", source=self.source, **self.twist._asdict())
        self._read_answers()

    def request(self, service: str, **arguments: Any) -> None:
        """Requests a service without waiting for the answer."""
        line = json.dumps({"call": service, "arguments": arguments}).encode() + b"\n"
        if self.stream is not None:
            with contextlib.suppress(OSError):  # the driver has ended, or does not read
                self.stream.send(line)

    def close(self) -> None:
        if self.stream is not None:
            self.stream.close()
            self.stream = None

    def _read_answers(self) -> None:
        if self.stream is None:
            return
        with contextlib.suppress(OSError):
            self._unread += self.stream.recv(1 << 16)
        *lines, self._unread = self._unread.split(b"\n")
        for line in lines:
            answer = read_json(line)
            if not answer.get("ok"):
                self.refusals.append(str(answer.get("error")))


class Weave(NamedTuple):
    """A drive in curves to both sides in turn, so that the steering joints turn.

    - ``left``: twist of the curve to the left.
    - ``start``: time (s) of the start.
    - ``seconds``: time (s) of a curve to one side.
    """

    left: Twist
    start: float
    seconds: float

    def twist(self, now: float) -> Twist:
        """Returns the commanded twist at the time ``now`` (s)."""
        side = 1.0 if int((now - self.start) / self.seconds + 1e-6) % 2 else -1.0
        return self.left._replace(wz=side * self.left.wz)


class Rehearsal:
    """A robot on simulated buses with its base driver and a client.

    - ``observe``: function that is called after each control cycle, and also in each period in
      which the base driver does not run.
    - ``frames``: data of the newest frame by name of the bus and COB-ID.
    - ``other_frames``: data of frames from another time, which forged frames repeat.
    """

    def __init__(self, robot: Robot, *, parameters: str | None = None, seed: int = 0) -> None:
        self.robot = robot
        self.simulated = SimulatedRobot(robot, seed=seed)
        interfaces = {
            bus.name: self.simulated.interface(bus.name, fifo=True) for bus in robot.buses
        }
        self.base = CanBase(robot, interfaces, threaded=False)
        self._interfaces = interfaces
        clock = interfaces[robot.buses[0].name]
        self.driven: DrivenRobot = DrivenRobot(robot, self.base, clock, parameters=parameters)
        self.client: ScriptedClient | None = None
        self.driver_killed = False
        self.weave: Weave | None = None
        self.observe: Callable[[], None] | None = None
        self.longest_gap = 0.0
        """Longest time (s) between two control cycles since the last call of ``forget``."""
        self.frames: dict[tuple[str, int], bytes] = {}
        self.other_frames: Mapping[tuple[str, int], bytes] = {}
        self._server: ControlServer | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._last_cycle = math.nan
        self._asked_until = -math.inf
        self.driven.before_cycle = lambda _: self._act()
        driven = [
            (i, self.simulated.motors[actuator.name], wheel.radius)
            for i, wheel in enumerate(robot.wheels)
            if (actuator := robot.actuator_of(wheel.spin_joint)) is not None
            and actuator.name in self.simulated.motors
        ]
        self.wheels = [(motor, radius) for _, motor, radius in driven]
        self._driven = [(i, radius) for i, _, radius in driven]
        for name, wire in self.simulated.wires.items():
            wire.observers.append(self._recorder(name))

    def _recorder(self, bus: str) -> Callable[[int, CanFrame, object], None]:
        def record(time: int, frame: CanFrame, senders: object) -> None:
            self.frames[bus, frame.key] = frame.data

        return record

    # -- state -------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """Virtual time (s)."""
        return self.simulated.timeline.seconds

    @property
    def state(self) -> BaseState:
        return self.base.state

    @property
    def reason(self) -> str:
        return self.base.state_machine.reason

    @property
    def asked(self) -> bool:
        """``True`` if a motion is commanded that has not timed out.

        A closed connection and a command of zero end the motion within ``FRESH`` control cycles.
        """
        return self.now <= self._asked_until + 1e-9

    def wheel_states(self) -> list[tuple[float, float]]:
        """Returns the true path (m) and the true speed (m/s) of each driven wheel at the ground."""
        now = self.now
        states = []
        for motor, radius in self.wheels:
            state = motor.read(now)
            states.append((state.position * radius, abs(state.velocity) * radius))
        return states

    def commanded_speeds(self) -> list[float]:
        """Returns the newest commanded speed (m/s) of each driven wheel at the ground."""
        command = self.driven.driver.state.command
        if command is None:
            return [0.0] * len(self._driven)
        return [abs(command.joints.speeds[i]) * radius for i, radius in self._driven]

    # -- time --------------------------------------------------------------------------------

    def run(self, seconds: float, stop: Callable[[], bool] | None = None) -> None:
        """Runs the robot for ``seconds``, or until ``stop()`` returns ``True``."""
        if self.driver_killed:
            self.stall(seconds, stop)
        else:
            self.driven.run(self.now + seconds, watch=self._after_cycle, stop=stop)

    def stall(self, seconds: float, stop: Callable[[], bool] | None = None) -> None:
        """Lets the time go on without control cycles.  The client and the devices go on."""
        until = self.now + seconds
        while self.now < until - 1e-9 and not (stop is not None and stop()):
            self.simulated.run(min(self.base.period, until - self.now))
            self._run_client()
            if self.observe is not None:
                self.observe()

    def _after_cycle(self, driven: DrivenRobot, state: DriverState) -> None:
        if not math.isnan(self._last_cycle):
            self.longest_gap = max(self.longest_gap, self.now - self._last_cycle)
        self._last_cycle = self.now
        if self.observe is not None:
            self.observe()

    def _act(self) -> None:
        """A person homes the steering as soon as the robot has started, and the client acts."""
        if self.state is BaseState.STANDBY:
            self.driven.home_steering()
        self._run_client()

    def _run_client(self) -> None:
        if self.client is None:
            return
        client = self.client
        if self.weave is not None:
            client.twist = self.weave.twist(self.now)
        client.send_twist()
        if client.connected and client.twist not in (None, ZERO_TWIST):
            self._asked_until = self.now + self.driven.driver.settings.command_timeout
        elif not client.connected or client.twist == ZERO_TWIST:
            self._asked_until = min(self._asked_until, self.now + FRESH * self.base.period)

    # -- parts of a rehearsal ------------------------------------------------------------------

    def power_on(self) -> None:
        self.simulated.power_on()

    def become_ready(self) -> None:
        """Runs the robot until it is ready.

        Raises ``RehearsalError`` if the robot does not become ready.
        """
        self.run(LONGEST_START, lambda: self.driven.ready or self.state is BaseState.FAULT)
        if not self.driven.ready:
            raise RehearsalError(
                f"the robot does not become ready: {self.state.value} {self.reason}".rstrip()
            )
        self.run(0.1)

    def connect(self, twist: Twist = ZERO_TWIST) -> None:
        """Starts a client, which commands ``twist`` in every control cycle.

        A second call changes only the commanded twist.
        """
        if self.client is not None:
            self.client.twist = twist
            return
        self._folder = tempfile.TemporaryDirectory(prefix="thorvaldc-faults-")
        channel = os.path.join(self._folder.name, "driver")
        self._server = self.driven.open_channel(channel)
        # However busy the computer is, all requests of a cycle are answered in the cycle.
        self._server.real_time = lambda: self.now
        self.client = ScriptedClient(Path(channel), self.robot.twist_sources[0].name)
        self.client.twist = twist

    def renew_connection(self) -> None:
        """Gives a copy of this process a connection of its own between client and driver.

        The original process and its copies share the sockets, so that one process could receive
        what another has sent.  The new sockets replace both ends of the connection.
        """
        client = self.client.stream if self.client is not None else None
        if client is None or self._server is None:
            return
        (server,) = self._server.streams
        near, far = socket.socketpair()
        # What is on its way remains in the old sockets for the other processes.
        far.sendall(_waiting(client))
        near.sendall(_waiting(server))
        for new, old in ((near, client), (far, server)):
            os.dup2(new.fileno(), old.fileno())
            os.set_blocking(old.fileno(), False)
            new.close()

    def arm(self) -> None:
        """Arms the robot, which stands.

        Raises ``RehearsalError`` if the robot cannot be armed.
        """
        self.run(0.1)
        client = self.client
        if client is not None and not self.driven.armed:
            client.request("arm")
            self.run(0.1)
        if not self.driven.armed:
            reasons = client.refusals if client is not None else []
            raise RehearsalError(f"the robot cannot be armed: {'; '.join(reasons)}")

    def forget(self) -> None:
        """Starts a new measurement of ``longest_gap``."""
        self.longest_gap = 0.0

    def inject(self, kind: str, bus: str, node: str | None = None, **values: Any) -> None:
        """Injects a fault now; it lasts until the end of the rehearsal."""
        fault = BusFault(kind, bus, node, 0.0, None, self.robot.span, **values)
        FaultInjector(self.simulated, BusFaults(())).inject(fault)

    def send_foreign(self, bus: str, cob_id: int, messages: Sequence[bytes]) -> None:
        """Lets a foreign master send messages, one in a few milliseconds."""
        for number, data in enumerate(messages):
            values = {"cob_id": cob_id, "data": data}
            send = partial(self.inject, "forged_frames", bus, None, **values)
            self.simulated.timeline.after(number * FOREIGN_PAUSE, send)

    def falsify_speed(self, node: str, channel: int, share: float, largest: float) -> None:
        """Lets the encoder of a channel measure a random speed (rad/s) in a share of the time."""
        encoder, _ = self.simulated.devices[node].channel_motor(channel)
        if encoder is None:
            raise ValueError(f"{node} has no encoder")
        draw = random.Random(node)
        encoder.noise = lambda: draw.uniform(-largest, largest) if draw.random() < share else None

    def hunt(self, node: str, channel: int, offset: float, angle: float, speed: float) -> None:
        """Lets a steering joint swing by ``angle`` (rad) to both sides, with ``speed`` (rad/s),
        about an angle that is wrong by ``offset`` (rad), whatever is commanded."""
        _, motor = self.simulated.devices[node].channel_motor(channel)
        if motor is None:
            raise ValueError(f"{node} has no motor")

        def swing(travel: float) -> None:
            motor.disturb(self.now, runaway=math.copysign(speed, travel))
            following = -2.0 * math.copysign(angle, travel)
            self.simulated.timeline.after(to_ns(abs(travel) / speed), lambda: swing(following))

        swing(offset + angle)

    def lose_bus(self, bus: str) -> None:
        """Puts the CAN controller of the base driver off the bus."""
        self._interfaces[bus].controller.go_bus_off()

    def silence_client(self) -> None:
        """Lets the client send nothing more; its connection stays open."""
        self.weave = None
        if self.client is not None:
            self.client.twist = None

    def close_client(self) -> None:
        if self.client is not None:
            self.client.close()

    def kill_driver(self) -> None:
        """Ends the base driver without a last frame, as the signal SIGKILL does."""
        self.driver_killed = True
        self.driven.close()

    def close(self) -> None:
        """Closes the client and the control channel."""
        self.close_client()
        if self._server is not None:
            self._server.close()
        if self._folder is not None:
            self._folder.cleanup()


def _waiting(stream: socket.socket) -> bytes:
    """Returns the received bytes that were not read yet, which remain in the socket."""
    try:
        return stream.recv(1 << 20, socket.MSG_PEEK)
    except BlockingIOError:
        return b""
