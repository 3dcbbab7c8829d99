"""Plays the scripts of partners to the node of the base driver, and says what the robot did.

``python -m tests.ros.partners_rig PACKAGES SCRIPTS.yaml DISTRO NAME...`` prints the answers to each
script as JSON.
Nothing depends on real time: the node, with the base `ideal`, runs a control cycle of 20 ms for
each step of the script; each step ends when the messages have arrived.  The clock with which the
node watches /clock is that of the script too.
"""

from __future__ import annotations

import itertools
import json
import math
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import rclpy
import yaml
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from tests.ros.partners.nav2 import OWN_PARAMETERS, SMOOTHED, Nav2
from thorvaldc.ros import guarded_node, lifecycle_node
from thorvaldc.ros.lifecycle_node import BaseDriverNode

TIMEOUT = 120.0  # s, real time
STEP = 0.02  # s
BEFORE = 1.0
"""Time (s) before a script in which the simulation runs and the robot is armed."""
REAL_TIME = 1.75e9
"""Clock (s) of a partner that does not use the simulated time."""
MOVES, STANDS = 0.02, 1e-3  # m/s
JOYSTICK, ANY_FIRST = "teleop_joy", "direct"
TOPICS = {"navigation": "auto_nav", "joystick": JOYSTICK}
"""Source of the generated package for each partner that has one; each other one plays its script
to the source of the joystick, and to one with ``first_command: any``."""
Script = dict[str, Any]


class Driver(BaseDriverNode):
    """The node, which counts what arrives."""

    locks = 0

    def _on_lock(self, name: str, message: Any) -> None:
        super()._on_lock(name, message)
        self.locks += 1


def times(item: Script) -> list[float]:
    """Returns when the message of an entry is sent (s)."""
    begin, count = float(item["from"]), item.get("at_once", 1)
    if "to" in item:
        count = math.ceil((item["to"] - begin) / item["every"] - 1e-9)
    return [begin + i * item.get("every", 0.0) for i in range(count)]


def clock_of(script: Script) -> Callable[[float], float]:
    """Returns the function from the time of a script to the simulated time (s)."""
    points = script.get("clock", [[0.0, 100.0], [1.0, 101.0]])

    def clock(at: float) -> float:
        if at < points[0][0]:
            return float(max(points[0][1] + at - points[0][0], 0.0))
        passed = [i for i, point in enumerate(points) if point[0] <= at + 1e-9]
        (t0, c0), (t1, c1) = points[passed[-1]], points[min(passed[-1] + 1, len(points) - 1)]
        if t1 == t0:
            (t0, c0), (t1, c1) = points[-2], points[-1]
        return float(c0 + (at - t0) * (c1 - c0) / (t1 - t0))

    return clock


class Message:
    """A message of a partner: its time in the script, and what it is (see the scripts)."""

    def __init__(self, at: float, kind: str, source: str, values: Any, stamp: Any = None) -> None:
        self.at, self.kind, self.source, self.values, self.stamp = at, kind, source, values, stamp


def messages_of(script: Script, source: str, nav2: Nav2, clock: Any) -> list[Message]:
    """Returns the messages of a script in the order of their times."""
    messages: list[Message] = []
    for item in script["messages"]:
        if "lock" in item:
            messages += [Message(t, "lock", "", item["lock"]) for t in times(item)]
        elif "enable" in item:
            messages.append(Message(item["from"], "enable", "", item["enable"]))
        elif "x" in item:
            speeds, sender = item["x"], item.get("source", source)
            for i, t in enumerate(times(item)):
                twist = speeds[min(i, len(speeds) - 1)], item.get("w", 0.0)
                messages.append(Message(t, "twist", sender, twist, item.get("stamp", 0.0)))
    messages += navigation(script, nav2, clock)
    return sorted(messages, key=lambda message: message.at)


def navigation(script: Script, nav2: Nav2, clock: Callable[[float], float]) -> list[Message]:
    """Returns what Nav2 sends for the goals of a script."""
    goals = [item for item in script["messages"] if "goal" in item]
    if not goals:
        return []
    stops = [item for item in script["messages"] if "blocked" in item]
    sent = []
    for i in range(round((goals[-1]["to"] + 3.0) / nav2.period)):
        at = i * nav2.period
        for goal in goals:
            stamp = goal.get("stamp", 0.0)
            stamp = 0.0 if stamp == "zero" else clock(at) + stamp
            if goal["from"] - 1e-9 <= at < goal["to"] - 1e-9:
                nav2.command(goal["goal"], stamp, at)
            elif abs(at - goal["to"]) < 1e-9 and not goal.get("killed"):
                nav2.command(0.0, stamp, at)
        smoothed = nav2.smooth(at + SMOOTHED)
        if smoothed is not None:
            free = not any(item["from"] <= at < item["to"] for item in stops)
            speed = nav2.monitor(smoothed[0], free, at + SMOOTHED)
            if speed is not None:
                values, stamp = (speed, 0.0), {"stamped": smoothed[1]}
                sent.append(Message(at + SMOOTHED, "twist", "navigation", values, stamp))
    return sent


class PartnersRig:
    """The node and the partners in one process.

    ``folder``: generated packages, `gate` with a lock of this name.  ``target``: source of the
    robot that partners use for which the package has none.
    """

    def __init__(self, folder: Path, script: Script, stamped: bool, target: str) -> None:
        self.script, self.target = script, target
        stamped = stamped or script.get("stamped", False)
        self.kind: Any = TwistStamped if stamped != script.get("other_type", False) else Twist
        self.clock = clock_of(script)
        self.at = -BEFORE
        times = SimpleNamespace(monotonic=lambda: self.at + 1000.0, time=lambda: 0.0)
        lifecycle_node.time = guarded_node.time = times  # type: ignore[assignment]
        config = folder / ("gate" if script.get("lock") == "gate" else "plain") / "config"
        rclpy.init(args=["--ros-args", "--params-file", str(config / "base_driver.yaml")])
        values: dict[str, Any] = {"model_file": str(config / "model.json"), "base": "ideal"}
        values |= {"use_sim_time": True, "real_time_factor": 0.0, "stamped": stamped}
        self.node = Driver(parameter_overrides=[Parameter(k, value=v) for k, v in values.items()])
        self.partner = rclpy.create_node("partner")
        # A program has no two types on a topic, and the driver is in this one.
        self._other = rclpy.Context()
        rclpy.init(context=self._other)
        sender = self.partner
        if "other_type" in script:
            sender = rclpy.create_node("other", context=self._other)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.executor.add_node(self.partner)
        self.odometry: list[Any] = []
        self.diagnostics: list[Any] = []
        self.speeds: list[tuple[float, float]] = []
        self.arming = ""
        self._clock = self.partner.create_publisher(Clock, "/clock", 1)
        hear = self.partner.create_subscription
        hear(Odometry, "odometry/base_raw", self.odometry.append, 10)
        hear(DiagnosticArray, "/diagnostics", self.diagnostics.append, 10)
        assert self.node.trigger_configure() == self.node.trigger_activate()
        self._twists = {
            source.name: sender.create_publisher(self.kind, source.topic, 10)
            for source in self.node.model.twist_sources
        }
        lock = next(k for k in self.node.model.twist_locks if k.name == script.get("lock", PAUSE))
        self._lock = self.partner.create_publisher(Bool, lock.topic, 10)
        self._enable = self.partner.create_client(SetBool, "enable")
        self._heard = "other_type" not in script
        publishers = self._twists.values() if self._heard else ()
        for publisher in (self._clock, self._lock, *publishers):
            self.spin_until(lambda p=publisher: p.get_subscription_count() > 0)
        for publisher in self._twists.values():
            self.spin_until(lambda p=publisher: self.node.count_publishers(p.topic_name) > 0)
        self.spin_until(lambda: self.partner.count_publishers("/diagnostics") > 0)
        self.spin_until(self._enable.service_is_ready)

    def spin_until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + TIMEOUT
        while not condition():
            assert time.monotonic() < end, f"the driver or a partner is silent at {self.at:.2f} s"
            self.executor.spin_once(timeout_sec=0.005)

    def source(self, partner: str) -> str:
        return TOPICS.get(partner, self.target)

    def send(self, message: Message) -> None:
        """Sends a message, and waits until the driver has it."""
        if message.kind == "lock":
            heard = self.node.locks
            self._lock.publish(Bool(data=message.values))
            self.spin_until(lambda: self.node.locks > heard)
        elif message.kind == "enable":
            future = self._enable.call_async(SetBool.Request(data=message.values))
            self.spin_until(future.done)
            self.arming = future.result().message
        else:
            source = self.source(message.source)
            received = self.node.inputs.received[source]
            self._twists[source].publish(self.twist(message))
            self.spin_until(lambda: self.node.inputs.received[source] > received or not self._heard)

    def twist(self, message: Message) -> Any:
        twist: Any = self.kind()
        part = twist if self.kind is Twist else twist.twist
        part.linear.x, part.angular.z = map(float, message.values)
        if self.kind is TwistStamped:
            stamp = self.stamp(message.stamp)
            twist.header.frame_id = self.script.get("frame", "")
            twist.header.stamp = ros_time(stamp)
        return twist

    def stamp(self, stamp: Any) -> float:
        now = self.clock(self.at)
        if isinstance(stamp, dict):
            return float(stamp["stamped"])
        if isinstance(stamp, str):
            named = {"zero": 0.0, "real": REAL_TIME + self.at, "whole_seconds": math.floor(now)}
            return float(named[stamp])
        return now + float(stamp)

    def step(self) -> None:
        """Sets the clock and runs a control cycle."""
        now = self.clock(self.at)
        self._clock.publish(Clock(clock=ros_time(now)))
        self.spin_until(lambda: abs(self.node.ros_time() - now) < 1e-6)
        heard = len(self.odometry)
        self.node.run_due()
        self.spin_until(lambda: len(self.odometry) > heard)
        self.speeds.append((self.at, self.odometry[-1].twist.twist.linear.x))

    def play(self) -> list[str]:
        """Plays the script, and returns an answer for each expectation."""
        parameters = OWN_PARAMETERS if "parameters" in self.script else NAV2
        nav2 = Nav2(parameters, self.clock)
        messages = messages_of(self.script, self.script["source"], nav2, self.clock)
        expected = self.script["expect"]
        ends = [e["at"] for e in expected[1:]]
        ends.append(max(messages[-1].at, expected[-1]["at"] + 1.0))
        asked = [min(e["at"] + 1.0, end) for e, end in zip(expected, ends, strict=True)]
        armed = any(message.kind == "enable" for message in messages)
        reasons = []
        for i in range(-round(BEFORE / STEP), math.ceil(ends[-1] / STEP - 1e-9)):
            self.at = i * STEP
            self.step()
            if i == -1 and not armed:
                self.send(Message(self.at, "enable", "", True))
            while messages and messages[0].at < self.at + STEP - 1e-9:
                self.send(messages.pop(0))
            if len(reasons) < len(ends) and asked[len(reasons)] < self.at + 1.5 * STEP:
                reasons.append(self.reason())
        reasons += [self.reason()] * (len(ends) - len(reasons))
        return [
            answer(self.decided(e), end, self.speeds, reason, self.odometry)
            for e, end, reason in zip(expected, ends, reasons, strict=True)
        ]

    def decided(self, expected: Script) -> Script:
        """Returns what holds: where a rule of safety overrules the partner's user, the rule.

        A source with ``first_command: any`` resumes as its user expects.
        """
        if "decided" not in expected or self.target == ANY_FIRST:
            return expected
        at = expected["at"] + expected["moves"]
        return {"at": at, "refuses": expected["decided"]}

    def reason(self) -> str:
        """Returns what /diagnostics says about the twists and the robot."""
        heard = len(self.diagnostics)
        self.node._report()
        self.spin_until(lambda: len(self.diagnostics) > heard)
        statuses = {s.name.rsplit(": ", 1)[-1]: s for s in self.diagnostics[-1].status}
        values = {v.key: v.value for v in statuses["commands"].values}
        source = self.source(self.script["source"])
        reasons = statuses["driver"].message, values[f"{source}.reason"], self.arming
        return " | ".join(reasons)

    def close(self) -> None:
        self.node.stop_robot()
        self.node.destroy_node()
        self.partner.destroy_node()
        self._other.shutdown()
        rclpy.shutdown()


def misfits(odometry: list[Any]) -> str:
    """Returns what filters and maps cannot use of the odometry, see listeners.yaml."""
    problems = set()
    stamps = [m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m in odometry]
    if stamps[0] <= 0.0 or any(b < a for a, b in itertools.pairwise(stamps)):
        problems.add("stamps")
    for message in odometry:
        pose, twist = message.pose.pose, message.twist.twist
        q = pose.orientation
        numbers = [pose.position.x, pose.position.y, twist.linear.x, twist.linear.y]
        covariances = [*message.pose.covariance, *message.twist.covariance]
        if (message.header.frame_id, message.child_frame_id) != ("odom", "base_link"):
            problems.add("frames")
        if not all(map(math.isfinite, [*numbers, twist.angular.z, *covariances])):
            problems.add("not finite")
        if abs(math.hypot(q.x, q.y, q.z, q.w) - 1.0) > 1e-6:
            problems.add("orientation")
        for i in (0, 7, 35):  # x, y, yaw
            if not 0.0 < message.twist.covariance[i] <= 1e3:
                problems.add(f"variance {i} of the twist is {message.twist.covariance[i]}")
    return "; ".join(sorted(problems))


def answer(
    expected: Script, end: float, speeds: list[tuple[float, float]], reason: str, odometry: Any
) -> str:
    """Returns an empty text if the robot did what is expected, else what it did."""
    begin = expected["at"]
    sign = -1.0 if expected.get("backwards") else 1.0
    if "refuses" in expected:
        moved = [t for t, v in speeds if begin + STEP < t < end and abs(v) > STANDS]
        if moved:
            return f"moves at {moved[0]:.2f} s"
        return "" if re.search(expected["refuses"], reason) else f"refuses: {reason}"
    if "moves" in expected:
        within = begin + expected["moves"]
        if any(sign * v > MOVES for t, v in speeds if begin < t <= within + STEP):
            return ""
        return f"refuses: {reason}"
    if "fits" in expected:
        return misfits(odometry)
    rest = begin + expected["stands"]
    moved = [t for t, v in speeds if rest + STEP < t < end and abs(v) > STANDS]
    return f"moves at {moved[0]:.2f} s" if moved else ""


def ros_time(seconds: float) -> Time:
    nanoseconds = round(seconds * 1e9)
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


PAUSE = "auto_nav_pause"
NAV2: dict[str, Any] = {}


def main(folder: str, file: str, distro: str, *names: str) -> None:
    partner = yaml.safe_load(Path(file).read_text())
    config = Path(folder) / "plain" / "config"
    nav2 = yaml.safe_load((config / "nav2.yaml").read_text())
    for node in ("/velocity_smoother", "/collision_monitor"):
        NAV2.update(nav2[node]["ros__parameters"])
    driver = yaml.safe_load((config / "base_driver.yaml").read_text())
    stamped = driver["/base_driver"]["ros__parameters"]["stamped"]
    answers: dict[str, dict[str, list[str]]] = {}
    for name in names:
        print(f"the script {name}", file=sys.stderr)  # a traceback is of the last one
        script = {**partner, **partner["scripts"][name]}
        if distro in script.get("distros", [distro]):
            answers[name] = answers_to(script, Path(folder), stamped)
    print(json.dumps(answers))


def answers_to(script: Script, folder: Path, stamped: bool) -> dict[str, list[str]]:
    """Returns the answers to the expectations of a script, for each source that it is played to."""
    topic = TOPICS.get(script["source"])
    answers = {}
    for source in [topic] if topic else [JOYSTICK, ANY_FIRST]:
        rig = PartnersRig(folder, script, stamped, source)
        answers[source] = rig.play()
        rig.close()
    return answers


if __name__ == "__main__":
    main(*sys.argv[1:])
