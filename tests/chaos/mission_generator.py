"""Composes a mission with faults from a seed.

Each seed first draws which kinds of faults it may contain, so that many missions have few kinds and
their combinations vary (swarm testing).
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from typing import Any

from tests.chaos.chaos_robots import LOUD_SOURCE, ROBOTS, chaos_robot
from tests.chaos.focused_missions import FOCUSED, TWIST, call
from tests.chaos.invariants import PUSHED
from tests.chaos.schedule import DELIVERED, POWER_ON, READY, ChaosEvent, Schedule
from thorvaldc.model import Bus, Node, ObjectValue, Robot
from thorvaldc.model.bus_timing import required_objects

POWER_ON_SHARE = 0.05
"""Share of the missions that begin with the power-on; they take longer."""
DELIVERED_SHARE = 0.05
"""Share of the missions in which a technician commissions new drives; they take longer, too."""
START_UP = {
    "steered_cia402": (5.0, 6.0),
    "steered_script": (4.3, 5.3),
    "differential_cia402": (1.6, 2.6),
    "differential_script": (3.5, 4.5),
    "differential_automatic": (1.6, 2.6),
}
"""Shortest and longest time (s) from the power-on until a person arms the robot."""
FOCUSED_SHARE = 0.5
"""Share of the missions that aim at one rule."""
EXTRA_FAULT_SHARE = 0.25
"""Share of those with a random fault beside it."""
COMMISSIONED = ("steered_cia402", "differential_cia402")
"""Robots whose drives are set up by ``can flash``."""
EMCY_INHIBIT_TIME, HEARTBEAT_PRODUCER, DRIVE_PROFILE = 0x1015, 0x1017, 0x6000
DECELERATIONS = (0x84, 0x85)
"""Profile deceleration (0x6084) and quick stop deceleration (0x6085), within an axis."""
ON_EVENT = 255
"""Transmission type of a PDO; 254 means the same."""
HELD = 0.2
"""Share of the drives that begin with a motion, as with a stick that is held."""
STALLS = (0.005, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.45, 0.55, 0.62, 0.7, 1.0, 2.0, 5.0)
GARBAGE = (
    "\x00\xff\xfe\n",
    "{\n",
    "[[[[[[[[[[\n",
    "x" * 9000,
    "{}\n",
    '{"call": "twist", "arguments": {"source": "teleop_joy", "vx": NaN}}\n',
    '{"call": "twist", "arguments": {"source": "teleop_joy", "vx": 1e999, "wz": -Infinity}}\n',
    '{"call": "twist", "arguments": {"source": "auto_nav", "vx": 1e308, "vy": "fast"}}\n',
    '{"call": "set_drive_parameters", "arguments": {"max_linear_velocity": -1}}\n',
    '{"call": "set_drive_parameters", "arguments": {"max_linear_velocity": 1e300}}\n',
    '{"call": "setup_motor_controller", "arguments": {"node": "", "setting": "", "value": 1e30}}\n',
    '{"call": "send_to_device", "arguments": {"cob_id": 513, "data": "ffffffffffffff"}}\n',
    '{"call": "state", "arguments": {"x": 1}, "id": [[[]]]}\n',
)
DRIVERS = (
    *[("pilot", "teleop_joy")] * 6,
    *[("nav", "auto_nav")] * 2,
    ("nav", LOUD_SOURCE),
)
"""Client and twist source of the drives of a mission."""
Maker = Callable[["MissionGenerator", float], Iterator[ChaosEvent]]


class MissionGenerator:
    """Draws the events of one mission."""

    def __init__(self, seed: int, robot_name: str | None = None) -> None:
        self.draw = random.Random(f"chaos {seed}")
        self.seed = seed
        self.name = robot_name or list(ROBOTS)[seed % len(ROBOTS)]
        self.robot: Robot = chaos_robot(self.name)
        self.controllers: list[tuple[Bus, Node]] = [
            (bus, node) for bus in self.robot.buses for node in bus.nodes if _has_motor(node)
        ]
        self.batteries = [
            (bus, node)
            for bus in self.robot.buses
            for node in bus.nodes
            if node.protocol == "thorvald_kc_battery"
        ]

    def schedule(self) -> Schedule:
        draw = self.draw
        if draw.random() < FOCUSED_SHARE:
            return self._focused()
        if draw.random() < DELIVERED_SHARE and self.name in COMMISSIONED:
            return self._commissioning()
        kinds = draw.sample(list(FAULTS), k=draw.randint(1, 4))
        # A clone that is on the bus from the power-on sends no boot-up message later.
        share = 0.4 if "clone" in kinds else POWER_ON_SHARE
        start = POWER_ON if draw.random() < share else READY
        begin = draw.uniform(*START_UP[self.name]) if start == POWER_ON else 0.1
        duration = begin + draw.uniform(1.5, 6.0)
        events = list(self._mission(begin, duration))
        first = 0.0 if start == POWER_ON else 0.3
        for _ in range(draw.choice((0, 1, 1, 1, 2, 2, 3, 5))):
            at = draw.uniform(first, duration)
            events += FAULTS[draw.choice(kinds)](self, at)
        return self._schedule(start, duration, events)

    def _schedule(self, start: str, duration: float, events: list[ChaosEvent]) -> Schedule:
        events = [
            ChaosEvent(round(event.at, 3), event.act, event.values)
            for event in sorted(events, key=lambda event: event.at)
        ]
        return Schedule(self.name, self.seed, start, round(duration, 3), tuple(events))

    def _commissioning(self) -> Schedule:
        """Returns a mission in which new drives are flashed again and again, between failures."""
        draw = self.draw
        duration = draw.uniform(2.0, 12.0)
        events = []
        at = 0.2
        while at < duration:
            events.append(ChaosEvent(at, draw.choice(("flash", "flash", "flash", "start", "end"))))
            at += draw.uniform(0.2, 4.0)
        makers = (self.simple_device_fault, self.blackout, self.traffic, self.bus_off)
        for _ in range(draw.choice((0, 1, 2, 3, 5))):
            at = draw.uniform(0.3, duration)
            if draw.random() < 0.4:
                events.append(ChaosEvent(at, "kill"))
            else:
                events += draw.choice(makers)(at)
        return self._schedule(DELIVERED, duration, events)

    def _focused(self) -> Schedule:
        """Returns a mission that aims at one rule, at times with a random fault."""
        draw = self.draw
        events, duration = draw.choice(FOCUSED)(self)
        if draw.random() < EXTRA_FAULT_SHARE:
            maker = FAULTS[draw.choice(list(FAULTS))]
            events += maker(self, draw.uniform(0.3, duration))
        return self._schedule(READY, duration, events)

    # -- the mission -------------------------------------------------------------------------------

    def twist(self) -> list[float]:
        draw, settings = self.draw, self.robot.driver
        linear, angular = settings.max_linear_velocity, settings.max_angular_velocity
        kind = draw.random()
        if kind < 0.35:
            parts = [draw.choice((1, 1, -1)) * draw.uniform(0.2, 1.0) * linear, 0.0, 0.0]
        elif kind < 0.75:
            parts = [draw.uniform(-0.3, 0.9) * linear, 0.0, draw.uniform(-0.5, 0.5) * angular]
        elif kind < 0.9:
            parts = [draw.uniform(-0.5, 0.5) * speed for speed in (linear, linear, angular)]
        else:
            parts = [draw.uniform(-3.0, 3.0) * linear, 0.0, draw.uniform(-3.0, 3.0) * angular]
        return [round(part, 2) for part in parts]

    def fast_twist(self) -> list[float]:
        """Returns a twist at top speed, which no permission for a slower motion covers."""
        return [self.draw.choice((1, -1)) * self.robot.driver.max_linear_velocity, 0.0, 0.0]

    def _mission(self, begin: float, end: float) -> Iterator[ChaosEvent]:
        """Yields an ordinary mission: arm, drive, pause, stop, reset, and drive again."""
        draw = self.draw
        at = begin
        yield from self.arm(at, "pilot")
        at += draw.uniform(0.1, 0.3)
        while at < end:
            seconds = draw.uniform(0.3, 2.5)
            rate = draw.choice((10.0, 20.0, 50.0))
            client, source = draw.choice(DRIVERS)
            yield ChaosEvent(
                at,
                "drive",
                {
                    "client": client,
                    "source": source,
                    "twist": self.twist(),
                    "seconds": round(seconds, 2),
                    "rate": rate,
                    **({"held": True} if draw.random() < HELD else {}),
                },
            )
            at += seconds * draw.uniform(0.5, 1.2)
            if draw.random() < 0.25:
                yield from draw.choice(OPERATIONS)(self, at)
                at += draw.uniform(0.1, 0.8)

    def arm(self, at: float, client: str) -> Iterator[ChaosEvent]:
        yield call(at, client, "twist", source="teleop_joy")
        yield call(at + 0.03, client, "arm")

    def safety_stop(self, at: float) -> Iterator[ChaosEvent]:
        """Stop, release, reset and arm; the last steps may be left out."""
        draw = self.draw
        client = draw.choice(("pilot", "guard"))
        releaser = client if draw.random() < 0.8 else "stranger"
        yield call(at, client, "safety_stop")
        at += draw.uniform(0.05, 0.8)
        if draw.random() < 0.8:
            yield call(at, releaser, "release_safety_stop")
            yield from self.reset(at + draw.uniform(0.03, 0.5))

    def reset(self, at: float) -> Iterator[ChaosEvent]:
        yield call(at, "pilot", "reset_faults")
        if self.draw.random() < 0.7:
            yield from self.arm(at + self.draw.uniform(0.5, 3.0), "pilot")

    def stop_lock(self, at: float) -> Iterator[ChaosEvent]:
        draw = self.draw
        name = draw.choice([lock.name for lock in self.robot.twist_locks])
        yield call(at, "guard", "lock", name=name, locked=True)
        if draw.random() < 0.4:  # a source as loud as the stop drives
            values = {"source": LOUD_SOURCE, "twist": self.fast_twist(), "seconds": 1.0}
            yield ChaosEvent(at + 0.1, "drive", {"client": "nav", **values, "rate": 20.0})
        if draw.random() < 0.7:
            client = draw.choice(("guard", "guard", "stranger"))
            released = at + draw.uniform(0.05, 1.0)
            yield call(released, client, "lock", name=name, locked=False)
            if draw.random() < 0.7:  # a stop lock disarms; the pilot arms and goes on
                yield from self.arm(released + 0.1, "pilot")

    def parameters(self, at: float) -> Iterator[ChaosEvent]:
        limit = round(self.draw.uniform(0.2, 1.0) * self.robot.driver.max_linear_velocity, 2)
        yield call(at, "pilot", "set_drive_parameters", max_linear_velocity=limit)

    def disarm(self, at: float) -> Iterator[ChaosEvent]:
        yield call(at, "pilot", "disarm")
        if self.draw.random() < 0.6:
            yield from self.arm(at + self.draw.uniform(0.1, 0.6), "pilot")

    def home(self, at: float) -> Iterator[ChaosEvent]:
        yield call(at, "pilot", "home_steering")

    def odometry(self, at: float) -> Iterator[ChaosEvent]:
        yield call(at, "pilot", "reset_odometry")

    def restart(self, at: float) -> Iterator[ChaosEvent]:
        draw = self.draw
        yield ChaosEvent(at, draw.choice(("end", "kill")))
        if draw.random() < 0.8:
            yield ChaosEvent(at + draw.uniform(0.05, 2.5), "start")

    # -- faults ----------------------------------------------------------------------------------

    def stall(self, at: float) -> Iterator[ChaosEvent]:
        seconds = round(self.draw.choice(STALLS) * self.draw.uniform(0.9, 1.1), 3)
        yield ChaosEvent(at, "stall", {"seconds": seconds, "sending": self.draw.random() < 0.25})
        kind = self.draw.random()
        if kind < 0.3:  # the client may end while the driver stalls
            client = self.draw.choice(("pilot", "nav"))
            yield ChaosEvent(at + seconds * self.draw.random(), "close", {"client": client})
        elif kind < 0.7:  # zero and a new motion may wait in the control channel
            values = {"source": "teleop_joy", "twist": self.twist(), "seconds": 1.0, "rate": 20.0}
            yield call(at + 0.4 * seconds, "pilot", "twist", source="teleop_joy")
            yield ChaosEvent(at + 0.6 * seconds, "drive", {"client": "pilot", **values})

    def dead_client(self, at: float) -> Iterator[ChaosEvent]:
        client = self.draw.choice(("pilot", "pilot", "nav", "guard"))
        yield ChaosEvent(at, self.draw.choice(("close", "hang")), {"client": client})

    def hostile_client(self, at: float) -> Iterator[ChaosEvent]:
        draw = self.draw
        kind = draw.randrange(5)
        if kind == 0:
            text, times = draw.choice(GARBAGE), draw.choice((1, 5, 300))
            yield ChaosEvent(at, "raw", {"client": "hostile", "text": text, "times": times})
        elif kind == 1:
            source = draw.choice(("teleop_joy", "teleop_joy", "auto_nav", LOUD_SOURCE))
            if source == "teleop_joy":  # the pilot holds the source, and drives slowly
                slow = {"source": source, "twist": [draw.choice((0.0, 0.2)), 0.0, 0.0]}
                slow |= {"client": "pilot", "seconds": 2.5, "rate": 10.0}
                yield from self.arm(at, "pilot")
                yield ChaosEvent(at + 0.1, "drive", slow)
                at += 0.8
            values = {"source": source, "twist": self.fast_twist(), "seconds": 1.0, "rate": 50.0}
            yield ChaosEvent(at, "drive", {"client": "hostile", **values})
        elif kind == 2:
            yield call(at, "hostile", "release_safety_stop")
            for lock in self.robot.twist_locks:
                yield call(at, "hostile", "lock", name=lock.name, locked=False)
        elif kind == 3:
            service = draw.choice(("reset_faults", "reset_odometry", "home_steering", "disarm"))
            for step in range(draw.choice((1, 30))):
                yield call(at + 0.01 * step, "hostile", service)
        else:
            client, text = draw.choice((("hostile", '{"call": "state"}\n'), ("pilot", TWIST % 0.4)))
            if client == "pilot":
                yield from self.arm(at - 0.2, "pilot")
            yield ChaosEvent(at, "raw", {"client": client, "text": text, "times": 5000})
            if client == "pilot":
                yield ChaosEvent(at + 0.01, "hang", {"client": client})

    def inject(self, at: float, kind: str, seconds: bool = True, **more: Any) -> ChaosEvent:
        """Returns an injected fault of a motor controller."""
        bus, node = self.draw.choice(self.controllers)
        return _inject(at, kind, bus, node, self._duration() if seconds else None, **more)

    def _duration(self) -> float:
        return round(self.draw.choice((0.02, 0.1, 0.3, 1.0, 3.0)) * self.draw.uniform(0.8, 1.2), 3)

    def simple_device_fault(self, at: float) -> Iterator[ChaosEvent]:
        kind = self.draw.choice(("power_cut", "mute", "heartbeat_stop"))
        nodes = [(b, n) for b in self.robot.buses for n in b.nodes]
        bus, node = self.draw.choice(self.controllers if self.draw.random() < 0.8 else nodes)
        if kind == "heartbeat_stop" and not _has_motor(node):
            kind = "mute"
        yield _inject(at, kind, bus, node, self._duration())

    def blackout(self, at: float) -> Iterator[ChaosEvent]:
        bus = self.draw.choice(self.robot.buses)
        yield _inject(at, "power_cut", bus, None, self._duration())

    def bus_off(self, at: float) -> Iterator[ChaosEvent]:
        if self.draw.random() < 0.3:
            bus = self.draw.choice(self.robot.buses)
            yield ChaosEvent(at, "master_bus_off", {"bus": bus.name})
        elif self.draw.random() < 0.5:
            yield self.inject(at, "bus_off", seconds=False)
        else:
            yield self.inject(at, "wrong_bitrate", bitrate=self.draw.choice((125_000, 250_000)))

    def emergency(self, at: float) -> Iterator[ChaosEvent]:
        code = self.draw.choice((0x2310, 0x3210, 0x8130, 0x0000, 0xFF01))
        yield self.inject(at, "emcy", seconds=False, code=code, register=1)

    def traffic(self, at: float) -> Iterator[ChaosEvent]:
        """Lost, late and repeated frames, and noise."""
        draw = self.draw
        bus, node = draw.choice(self.controllers)
        kind = draw.choice(("lost_frames", "late_frames", "repeated_frames", "noise"))
        share = round(draw.choice((0.02, 0.1, 0.5, 1.0)) * draw.uniform(0.7, 1.0), 3)
        more: dict[str, Any] = {"share": min(share, 0.3) if kind == "noise" else share}
        target = None if kind == "noise" or draw.random() < 0.4 else node
        if kind == "late_frames":
            more["latency"] = round(draw.choice((0.002, 0.02, 0.1, 0.6)), 3)
        if kind != "noise" and draw.random() < 0.4:
            more["cob_id"] = draw.choice([f.cob_id for f in bus.frames])
        yield _inject(at, kind, bus, target, self._duration(), **more)

    def babble(self, at: float) -> Iterator[ChaosEvent]:
        cob_id = self.draw.choice((0x001, 0x181, 0x7FE))
        yield self.inject(at, "babble", cob_id=cob_id, period=self.draw.choice((0.0003, 0.002)))

    def forged(self, at: float) -> Iterator[ChaosEvent]:
        """A second master or false reports."""
        draw = self.draw
        # Two equal frames that begin at the same instant are one frame for everybody on the bus.
        cycle = min(bus.sync_period for bus in self.robot.buses)
        at = cycle * (at // cycle + draw.uniform(0.15, 0.85))
        bus, node = draw.choice(self.controllers)
        ids = [f.cob_id for f in bus.frames if f.kind in ("pdo", "sync", "nmt", "heartbeat")]
        cob_id = draw.choice(ids)
        period = draw.choice((0.0, 0.01, 0.02, 0.1))
        more: dict[str, Any] = {"cob_id": cob_id, "period": period}
        if draw.random() < 0.5:
            length = next(f.length for f in bus.frames if f.cob_id == cob_id)
            more["data"] = bytes(length).hex()
        if cob_id == 0:  # a random NMT command; one that stops the nodes is the most common
            more["data"] = bytes([draw.choice((1, 2, 0x80, 0x81, 0x82)), node.id]).hex()
        seconds = max(self._duration(), 0.1)
        yield _inject(at, "forged_frames", bus, None, seconds, **more)

    def clone(self, at: float) -> Iterator[ChaosEvent]:
        yield self.inject(0.0 if self.draw.random() < 0.5 else at, "clone", seconds=False)

    def moved_id(self, at: float) -> Iterator[ChaosEvent]:
        yield self.inject(at, "duplicate_id", id=self.draw.choice((1, 2, 3, 32)))

    def motor(self, at: float) -> Iterator[ChaosEvent]:
        """Encoders that freeze or jump, and blocked wheels."""
        draw = self.draw
        bus, node = draw.choice(self.controllers)
        channel = draw.choice([c.name for c in node.channels if c.actuator is not None])
        kind = draw.choice(("frozen_encoder", "blocked_motor", "encoder_jump"))
        if kind == "encoder_jump":
            angle = round(draw.choice((-1, 1)) * draw.choice((0.05, 0.5, 3.0)), 2)
            yield _inject(at, kind, bus, node, None, channel=channel, angle=angle)
        else:
            yield _inject(at, kind, bus, node, self._duration(), channel=channel)

    def objects(self, at: float) -> Iterator[ChaosEvent]:
        """A service tool overwrites an object; it does not by itself make a stop longer."""
        bus, node = self.draw.choice(self.controllers)
        written = [
            (entry, value)
            for entry in required_objects(bus, node)
            if (value := _other_value(entry)) is not None
        ]
        entry, value = self.draw.choice(written)
        seconds = self._duration() if self.draw.random() < 0.2 else None
        key = {"index": entry.index, "subindex": entry.subindex}
        yield _inject(0.5 * at, "object_written", bus, node, seconds, **key, value=value)

    def disobedience(self, at: float) -> Iterator[ChaosEvent]:
        """A drive that does not obey, whose reports freeze, or whose wheel something else turns."""
        draw = self.draw
        bus, node = draw.choice(self.controllers)
        wheels = [c.name for c in node.channels if c.role == "propulsion"]
        deceleration = [o for o in node.objects if o.name.endswith("_profile_deceleration")]
        seconds = draw.choice((0.5, 3.0, 10.0))
        kind = draw.choice(
            ("commands_ignored", "commands_ignored", "sync_ignored", "frozen_reports", PUSHED)
            + (("object_written",) if deceleration else ())
        )
        if kind == PUSHED:
            speed = draw.choice((-1, 1)) * draw.choice((0.5, 2.0))
            more: dict[str, Any] = {"channel": draw.choice(wheels), "speed": speed}
            yield _inject(at, kind, bus, node, seconds, **more)
        elif kind == "object_written":
            more = {"index": deceleration[0].index, "value": 1}
            yield _inject(at, kind, bus, node, seconds, **more)
        else:
            yield _inject(at, kind, bus, node, seconds)
            if kind == "commands_ignored" and draw.random() < 0.5:
                yield _inject(at, "nmt_ignored", bus, node, seconds)
        if draw.random() < 0.5:
            yield call(at + draw.uniform(0.1, 1.0), "pilot", "safety_stop")

    def inject_controller(
        self, at: float, kind: str, seconds: float, *, wheel: bool = False, **more: Any
    ) -> ChaosEvent:
        """Returns a fault of a drawn motor controller, with ``wheel`` of its first wheel motor."""
        bus, node = self.draw.choice(self.controllers)
        if wheel:
            more["channel"] = next(c.name for c in node.channels if c.role == "propulsion")
        return _inject(at, kind, bus, node, seconds, **more)

    def inject_together(
        self, at: float, kinds: tuple[str, ...], seconds: float
    ) -> Iterator[ChaosEvent]:
        """Yields faults of one drawn motor controller."""
        bus, node = self.draw.choice(self.controllers)
        for kind in kinds:
            yield _inject(at, kind, bus, node, seconds)

    def empty_battery(self, at: float) -> Iterator[ChaosEvent]:
        for bus, node in self.batteries:
            yield _inject(at, "battery_charge", bus, node, None, charge=0.0)

    def battery(self, at: float) -> Iterator[ChaosEvent]:
        if self.batteries:
            bus, node = self.draw.choice(self.batteries)
            kind = self.draw.choice(("battery_charge", "battery_charge", "mute"))
            more = {"charge": 0.0} if kind == "battery_charge" else {}
            yield _inject(at, kind, bus, node, None, **more)

    def clock(self, at: float) -> Iterator[ChaosEvent]:
        seconds = round(self.draw.choice((-1.0, -0.1, 0.02, 0.3, 1.0, 3600.0)), 2)
        yield ChaosEvent(at, "clock_jump", {"seconds": seconds})

    def driver_process(self, at: float) -> Iterator[ChaosEvent]:
        if self.draw.random() < 0.2:
            yield ChaosEvent(at, "end")
            yield ChaosEvent(at + 0.5, "start", {"wrong": True})
        else:
            yield from self.restart(at)


def _has_motor(node: Node) -> bool:
    return any(channel.actuator is not None for channel in node.channels)


def _other_value(entry: ObjectValue) -> int | None:
    """Returns a value that shows nowhere else at first, or ``None`` if there is none."""
    value = entry.value or 0
    if entry.index in (HEARTBEAT_PRODUCER, EMCY_INHIBIT_TIME):
        return 2 * value
    if entry.index >= DRIVE_PROFILE and entry.index & 0x7FF in DECELERATIONS:
        return 2 * value
    is_communication = entry.index & 0xFF00 in (0x1400, 0x1800)
    if is_communication and entry.subindex == 2 and value == ON_EVENT:
        return ON_EVENT - 1
    return None


def _inject(
    at: float, kind: str, bus: Bus, node: Node | None, seconds: float | None, **more: Any
) -> ChaosEvent:
    values: dict[str, Any] = {"kind": kind, "bus": bus.name}
    if node is not None:
        values["node"] = node.name
    if seconds is not None:
        values["seconds"] = seconds
    return ChaosEvent(at, "inject", {**values, **more})


OPERATIONS: tuple[Maker, ...] = (
    MissionGenerator.safety_stop,
    MissionGenerator.stop_lock,
    MissionGenerator.parameters,
    MissionGenerator.disarm,
    MissionGenerator.home,
    MissionGenerator.odometry,
    MissionGenerator.restart,
)
FAULTS: dict[str, Maker] = {
    "stall": MissionGenerator.stall,
    "dead_client": MissionGenerator.dead_client,
    "hostile_client": MissionGenerator.hostile_client,
    "simple_device_fault": MissionGenerator.simple_device_fault,
    "blackout": MissionGenerator.blackout,
    "bus_off": MissionGenerator.bus_off,
    "emergency": MissionGenerator.emergency,
    "traffic": MissionGenerator.traffic,
    "babble": MissionGenerator.babble,
    "forged": MissionGenerator.forged,
    "clone": MissionGenerator.clone,
    "moved_id": MissionGenerator.moved_id,
    "motor": MissionGenerator.motor,
    "objects": MissionGenerator.objects,
    "disobedience": MissionGenerator.disobedience,
    "battery": MissionGenerator.battery,
    "clock": MissionGenerator.clock,
    "driver_process": MissionGenerator.driver_process,
}
"""Makers of injected faults, by theme."""
