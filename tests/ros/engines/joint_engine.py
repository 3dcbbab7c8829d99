"""What the stand-ins for programs with a robot's joints share: cycles, faults and statistics.

A stand-in ("engine") publishes joint states once a cycle and hears commands on topics.  It takes
faults from ``/engine/fault``, a std_msgs/String with JSON::

    {"mute": true}         no joint states; the clock goes on
    {"pause": true}        neither the clock nor joint states
    {"reset": true}        time 0 and the start of the robot
    {"nan": "joint"}       NaN for a joint; null ends it, also for "drop"
    {"drop": "joint"}      joint states without a joint
    {"freeze": true}       the same values with new stamps
    {"factor": 2.0}        speed relative to real time; 0: as fast as possible

With ``--lockstep``, a cycle waits for its commands, and for a client that says on
``/engine/continue``, a std_msgs/Float64, for which time (s) it has sent its twists.

At SIGTERM or SIGINT it prints its statistics as one line of JSON.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn, Protocol

import rclpy
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

LOCKSTEP_TIMEOUT = 1.0  # s, real time
Motions = dict[str, tuple[float, float]]
"""Position (rad or m) and velocity (rad/s or m/s) of each joint."""


def fail(message: str) -> NoReturn:
    """Ends the program with exit status 1 and one line."""
    print(f"error: {message}", file=sys.stderr, flush=True)
    raise SystemExit(1)


def common_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments that all engines have."""
    parser.add_argument("--namespace", default="", help="ROS namespace of the engine's nodes")
    parser.add_argument("--lockstep", action="store_true", help="wait for the commands of a cycle")
    parser.add_argument("--factor", type=float, default=1.0, help="speed; 0: any")


class World(Protocol):
    """Joints that move."""

    has_clock: bool
    """Whether the time of the joints is published on /clock."""

    @property
    def time_ns(self) -> int:
        """Time (ns) of the joints: from 0, or wall time."""

    def advance(self, time_ns: int) -> None:
        """Moves the joints to a time (ns) of the engine."""

    def reset(self) -> None:
        """Brings the joints to their start."""

    def motions(self) -> Motions:
        """Returns the motions of all joints."""

    def truth(self, message: Odometry) -> bool:
        """Fills in pose and body twist of the robot, or returns False where none are known."""


@dataclass
class Faults:
    """The faults that are active."""

    mute: bool = False
    pause: bool = False
    freeze: bool = False
    nan: str | None = None
    drop: str | None = None


class Statistics:
    """How soon the commands of each cycle come."""

    def __init__(self, channels: Sequence[str]) -> None:
        self.channels = list(channels)
        self.cycles = self.counted = self.complete = 0
        self.latencies: list[float] = []  # s
        self.has_begun = False
        self._sent = 0.0
        self._arrived: dict[str, float] = {}

    def begin_cycle(self) -> None:
        """A cycle begins with the publication of its joint states."""
        self.end_cycle()
        self.cycles += 1
        self._arrived.clear()
        self._sent = time.monotonic()

    def end_cycle(self) -> None:
        """Counts the cycle, if commands came before it or in it."""
        if self.cycles and self.has_begun:
            self.counted += 1
            if self.is_complete():
                self.complete += 1
                self.latencies.append(max(self._arrived.values()) - self._sent)

    def arrive(self, channel: str) -> None:
        """A message with commands came."""
        self.has_begun = True
        self._arrived[channel] = time.monotonic()

    def is_complete(self) -> bool:
        """Whether messages of all command channels came in this cycle."""
        return len(self._arrived) == len(self.channels) > 0

    def report(self, engine_s: float, real_s: float) -> str:
        """Returns one line of JSON; times in s, latencies in ms."""
        self.end_cycle()
        ordered = sorted(self.latencies)

        def percentile(share: float) -> float | None:
            if not ordered:
                return None
            return round(1e3 * ordered[min(len(ordered) - 1, int(share * len(ordered)))], 3)

        return json.dumps(
            {
                "cycles": self.cycles,
                "share": round(self.complete / self.counted, 4) if self.counted else None,
                "latency_p50_ms": percentile(0.5),
                "latency_p99_ms": percentile(0.99),
                "engine_time_s": round(engine_s, 3),
                "real_time_s": round(real_s, 3),
            }
        )


class JointEngine:
    """The cycles of an engine: it moves its world, publishes its state and hears commands.

    ``cycle_rate`` and ``clock_rate`` (Hz) are rates in engine time.  The owner adds command topics
    with :meth:`hear` and calls :meth:`run`.  A subclass may override :meth:`update`.
    """

    def __init__(
        self,
        name: str,
        world: World,
        options: argparse.Namespace,
        cycle_rate: float,
        clock_rate: float,
    ) -> None:
        self.stopped = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._stop)
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.world, self.cycle_rate, self.clock_rate = world, cycle_rate, clock_rate
        self.node = rclpy.create_node(name, namespace=options.namespace)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.factor, self.lockstep = options.factor, options.lockstep
        self.faults = Faults()
        self.statistics = Statistics([])
        self._reset_due = False
        self._frozen: Motions | None = None
        self._engine_ns = 0  # total, without the jumps of resets
        self._continued: float | None = None  # s, time up to which a client has sent its twists
        self.node.create_subscription(String, "/engine/fault", self._hear_fault, 10)
        self.node.create_subscription(Float64, "/engine/continue", self._hear_continue, 1)
        self._clock = self.node.create_publisher(Clock, "/clock", 10) if world.has_clock else None
        self._truth = self.node.create_publisher(Odometry, "odometry/true", 10)
        self._states: Any = None

    def publish_states_on(self, topic: str) -> None:
        self._states = self.node.create_publisher(JointState, topic, 10)

    def hear(
        self, kind: Any, topic: str, channels: Sequence[str], take: Callable[[Any], Sequence[str]]
    ) -> None:
        """Adds a command topic; ``take`` returns the channels that a message has commands for."""
        self.statistics.channels += [c for c in channels if c not in self.statistics.channels]

        def receive(message: Any) -> None:
            for channel in take(message):
                self.statistics.arrive(channel)

        self.node.create_subscription(kind, topic, receive, 10)

    def update(self) -> None:
        """Work after the joint states of a cycle; commands take effect here."""

    # -- faults --------------------------------------------------------------------------------

    def _stop(self, number: int, frame: Any) -> None:
        self.stopped = True

    def _hear_continue(self, message: Float64) -> None:
        self._continued = message.data

    def _hear_fault(self, message: String) -> None:
        try:
            self._take_fault(json.loads(message.data))
        except (ValueError, TypeError, AttributeError) as error:
            print(f"error: /engine/fault: {error}", file=sys.stderr, flush=True)

    def _take_fault(self, values: dict[str, Any]) -> None:
        for name, value in values.items():
            if name in ("mute", "pause", "freeze"):
                setattr(self.faults, name, bool(value))
            elif name in ("nan", "drop"):
                if value is not None and value not in self.world.motions():
                    raise ValueError(f"there is no joint {value!r}")
                setattr(self.faults, name, value)
            elif name == "factor":
                if not float(value) >= 0.0:
                    raise ValueError("a factor is not negative")
                self.factor = float(value)
            elif name == "reset":
                self._reset_due = self._reset_due or bool(value)
            else:
                raise ValueError(f"there is no fault {name!r}")

    def motions_of_message(self) -> Motions:
        """Returns the motions to publish, with the faults in them."""
        motions = self.world.motions()
        if self.faults.freeze:
            self._frozen = self._frozen or motions
            motions = dict(self._frozen)
        else:
            self._frozen = None
        if self.faults.nan is not None:
            motions[self.faults.nan] = (math.nan, math.nan)
        if self.faults.drop is not None:
            motions.pop(self.faults.drop, None)
        return motions

    # -- cycles --------------------------------------------------------------------------------

    def run(self) -> int:
        """Runs until a signal, prints the statistics, and returns the exit status."""
        start = deadline = time.monotonic()
        next_cycle = next_clock = 0  # numbers of the next messages since time 0
        engine_ns = 0
        while not self.stopped:
            if self._reset_due:
                self._reset_due = False
                self.world.reset()
                engine_ns = next_cycle = next_clock = 0
            if self.faults.pause:
                self._spin_until(time.monotonic() + 0.01)
                continue
            cycle_ns = round(next_cycle * 1e9 / self.cycle_rate)
            clock_ns = round(next_clock * 1e9 / self.clock_rate)
            event_ns = min(cycle_ns, clock_ns) if self._clock else cycle_ns
            # A late engine does not catch up; it is slower than its factor.
            deadline = max(deadline, time.monotonic() - 1e-3)
            if self.factor:
                deadline += (event_ns - engine_ns) * 1e-9 / self.factor
            self._spin_until(deadline)
            if self.faults.pause or self._reset_due or self.stopped:
                continue
            self.world.advance(event_ns)
            self._engine_ns += event_ns - engine_ns
            engine_ns = event_ns
            if self._clock and clock_ns == event_ns:
                next_clock += 1
                self._clock.publish(Clock(clock=stamp(self.world.time_ns)))
            if cycle_ns == event_ns:
                next_cycle += 1
                self._cycle()
        print(self.statistics.report(self._engine_ns * 1e-9, time.monotonic() - start), flush=True)
        self.node.destroy_node()
        rclpy.shutdown()
        return 0

    def _cycle(self) -> None:
        """Publishes joint states, works, and in lockstep waits for the next commands.

        Commands of this cycle take effect at the next :meth:`update`, as in the control loop of
        ros2_control, or in the next step of the simulation.
        """
        self._drain()
        now = stamp(self.world.time_ns)
        is_published = self._states is not None and not self.faults.mute
        if is_published:
            message = self.state_message(now, self.motions_of_message())
            self.statistics.begin_cycle()
            self._states.publish(message)
        self.update()
        truth = Odometry()
        truth.header.stamp = now
        if self.world.truth(truth):
            self._truth.publish(truth)
        if self.lockstep and is_published and self.statistics.has_begun:
            self._wait_for_commands()

    def state_message(self, now: Time, motions: Motions) -> JointState:
        message = JointState(name=list(motions))
        message.header.stamp = now
        message.position = [position for position, _ in motions.values()]
        message.velocity = [velocity for _, velocity in motions.values()]
        return message

    def _wait_for_commands(self) -> None:
        end = time.monotonic() + LOCKSTEP_TIMEOUT
        while not self._may_continue() and not self.stopped and not self.faults.pause:
            left = end - time.monotonic()
            if left <= 0.0:
                break
            self._take_message(min(left, 0.05))

    def _may_continue(self) -> bool:
        now = self.world.time_ns * 1e-9
        is_ahead = self._continued is not None and self._continued < now - 1e-6
        return self.statistics.is_complete() and not is_ahead

    def _drain(self) -> None:
        """Takes what came before this cycle, at most a queue of each topic."""
        for _ in range(10 * (1 + len(self.statistics.channels))):
            if not self._take_message(0.0):
                break

    def _take_message(self, longest: float) -> bool:
        """Waits for a message for at most ``longest`` s; returns whether one was taken."""
        try:
            handler, _, _ = self._executor.wait_for_ready_callbacks(longest)
        except TimeoutException:
            return False
        handler()
        handler.result()  # raises its error
        return True

    def _spin_until(self, deadline: float) -> None:
        while not self.stopped and (left := deadline - time.monotonic()) > 0.0:
            self._take_message(min(left, 0.05))


def stamp(time_ns: int) -> Time:
    return Time(sec=time_ns // 1_000_000_000, nanosec=time_ns % 1_000_000_000)
