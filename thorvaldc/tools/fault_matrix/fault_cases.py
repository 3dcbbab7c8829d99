"""The faults of the fault matrix, for the nodes of a robot, with the promised reactions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from thorvaldc.can import lss
from thorvaldc.can.canopen import EMCY, LSS_REQUEST, NMT, SYNC, Emergency, NmtCommand
from thorvaldc.can.frame import CanFrame
from thorvaldc.can.frame_bits import frame_bits
from thorvaldc.model import Bus, FrameDefinition, Node, ObjectValue, Robot, scenario, stopping
from thorvaldc.model.bus import MASTER
from thorvaldc.model.bus_timing import required_objects
from thorvaldc.model.statics.slope import roll_out
from thorvaldc.runtime.can_base.motor_controller import controller_class
from thorvaldc.simulation.bus.promised_times import (
    CLIMB,
    CREEPING,
    FROZEN_STEERING,
    FROZEN_WHEEL,
    NOT_FOLLOWING,
    RANDOM_SPEEDS,
    SECOND_DEVICE,
    SLOW,
    SWINGING,
    PromisedTimes,
)
from thorvaldc.tools.fault_matrix.rehearsal import Rehearsal

START, IDLE, DRIVING, STOPPING = PHASES = ("start-up", "idle", "driving", "stopping")
MOVING_PHASES = (DRIVING, STOPPING)

CREEP, ROLL, FULL_SPEED = 0.5, 2.0, 12.0
"""Speeds (rad/s) of a wheel that creeps, that a slope turns, and that runs away."""
LONGEST_ROLL = 60.0
"""Longest time (s) for which a robot is observed whose drives have no power."""

Frames = Mapping[tuple[str, int], bytes]
"""Data of frames by name of the bus and COB-ID."""


@dataclass(frozen=True)
class Evidence:
    """Frames of the robot without faults, which forged frames repeat.

    - ``at_rest``: frames of the robot at rest.
    - ``moving``: frames of the robot while it drives.
    """

    at_rest: Frames = field(default_factory=dict)
    moving: Frames = field(default_factory=dict)


Injection = Callable[[Rehearsal], None]
"""Function that injects a fault into a rehearsal."""


@dataclass(frozen=True)
class FaultCase:
    """A fault and the promised reaction of the robot.

    - ``name``: description of the fault.
    - ``drives``: protocol of the motor controller that has the fault.
    - ``phases``: phases in which the fault is tried.
    - ``inject``: function that injects the fault.
    - ``detection``: longest time (s) until the base driver stops the robot, by phase.  Without an
      entry, the base driver need not stop the robot.
    - ``braking``: longest time (s) until all wheels brake; ``None``: when the driver reacts.
    - ``by_ramp``: ``True`` if the base driver stops the robot with its ramp, ``False`` if the
      drives stop it with their quick stop.
    - ``rolls_out``: ``True`` if all drives lose their power, so that only friction and brakes stop
      the robot.
    - ``must_stop``: ``True`` if the robot must stop although the base driver cannot react.
    - ``motion``: speed (m/s) with which the fault itself moves a wheel, whatever is commanded.
    - ``starts_at``: time (s) of the fault in the phase ``start-up``.
    - ``observed``: time (s) of the observation after the fault.
    """

    name: str
    drives: str
    phases: tuple[str, ...]
    inject: Injection
    detection: Mapping[str, float]
    braking: float | None = None
    by_ramp: bool = False
    rolls_out: bool = False
    must_stop: bool = False
    motion: float = 0.0
    starts_at: float = 0.0
    observed: float = 1.0


def fault_cases(robot: Robot) -> list[FaultCase]:
    """Returns the cases of a robot.

    One motor controller of each kind has the faults of a device.  The motor controllers with a
    steering motor come first.
    """
    targets: dict[str, _Target] = {}
    for steering in (True, False):
        for bus in robot.buses:
            for node in bus.nodes:
                steers = any(channel.role == "steering" for channel in node.channels)
                if steers is steering and any(c.actuator is not None for c in node.channels):
                    targets.setdefault(node.protocol, _Target(robot, bus, node))
    on_buses = {target.bus.name: target for target in reversed(targets.values())}
    first = list(targets.values())[:1]
    sources = (
        (_device_cases, targets.values()),
        (_object_cases, targets.values()),
        (_identity_cases, targets.values()),
        (_encoder_cases, targets.values()),
        (_disobedience_cases, targets.values()),
        (_forgery_cases, targets.values()),
        (_wrong_data_cases, targets.values()),
        (_bus_cases, on_buses.values()),
        (_stranger_cases, on_buses.values()),
        (_battery_cases, first),
        (_program_cases, first),
    )
    return [case for source, nodes in sources for target in nodes for case in source(target)]


class _Target(PromisedTimes):
    """The motor controller that has the fault, and its times."""

    def __init__(self, robot: Robot, bus: Bus, node: Node) -> None:
        super().__init__(robot, bus, node)
        self.robot, self.bus, self.node = robot, bus, node
        self.drives = node.protocol

    def sends(self, kind: str) -> bool:
        return bool(self.sent(kind))

    @property
    def report(self) -> FrameDefinition | None:
        """The most frequent report of the motor controller."""
        reports = [frame for frame in self.sent("pdo") if frame.period]
        return min(reports, key=lambda frame: frame.period or 0.0, default=None)

    @property
    def command(self) -> FrameDefinition | None:
        """The most frequent command to the motor controller with the speed of a wheel."""
        joints = {wheel.spin_joint for wheel in self.robot.wheels}
        commands = [
            frame
            for frame in self.bus.frames
            if frame.producer == MASTER
            and frame.consumers == (self.node.name,)
            and frame.period
            and any(signal.joint in joints for signal in frame.signals)
        ]
        return min(commands, key=lambda frame: frame.period or 0.0, default=None)

    def object(self, index: int, subindex: int = 0) -> ObjectValue | None:
        """Returns an object of the motor controller that must have a certain value, or ``None``."""
        required = required_objects(self.bus, self.node)
        return next((o for o in required if (o.index, o.subindex) == (index, subindex)), None)

    def sends_at_sync(self) -> bool:
        """Returns ``True`` if the motor controller sends a report after each SYNC."""
        return any(
            0x1800 <= entry.index < 0x1A00 and entry.subindex == 2 and (entry.value or 255) <= 240
            for entry in self.node.objects
        )

    def number(self, channel: str) -> int:
        return [c.name for c in self.node.channels].index(channel)

    def channel(self, role: str) -> str | None:
        names = (c.name for c in self.node.channels if c.role == role and c.actuator is not None)
        return next(names, None)

    def case(
        self,
        name: str,
        inject: Injection,
        detection: float | Mapping[str, float] | None,
        **more: Any,
    ) -> FaultCase:
        """Returns a case.  ``detection`` is a time (s) for all phases, or times by phase."""
        phases = more.pop("phases", PHASES)
        if not isinstance(detection, Mapping):
            detection = {} if detection is None else dict.fromkeys(phases[-3:], detection)
        return FaultCase(name, self.drives, phases, inject, detection, **more)

    def device(self, kind: str, **values: Any) -> Injection:
        """Returns the injection of a fault of the motor controller."""
        return self.on_node(self.node.name, kind, **values)

    def on_node(self, node: str | None, kind: str, **values: Any) -> Injection:
        return lambda rehearsal: rehearsal.inject(kind, self.bus.name, node, **values)

    def forged(
        self, cob_id: int, data: bytes, period: float = 0.0, form: str = scenario.FRAME_FORMATS[0]
    ) -> Injection:
        values = {"cob_id": cob_id, "data": data, "period": period, "format": form}
        return self.on_node(None, "forged_frames", **values)

    def repeated(self, frame: FrameDefinition, period: float) -> Injection:
        """Returns the injection of frames from another time.

        A robot at rest gets frames of the moving robot, and a moving robot gets frames of the robot
        at rest.
        """
        bus = self.bus.name

        def inject(rehearsal: Rehearsal) -> None:
            data = rehearsal.other_frames.get((bus, frame.key), bytes(frame.length))
            values = {**_address(frame), "data": data, "period": period}
            rehearsal.inject("forged_frames", bus, **values)

        return inject


def _address(frame: FrameDefinition) -> dict[str, Any]:
    """Returns the identifier and the format of a frame, as an injected fault has them."""
    return {"cob_id": frame.cob_id, "format": scenario.FRAME_FORMATS[frame.extended]}


def _device_cases(target: _Target) -> Iterator[FaultCase]:
    case, device = target.case, target.device
    reports, prompt, watchdog = target.silence, target.prompt, target.watchdog
    yield case("power of a drive cut", device("power_cut"), reports)
    yield case("a drive sends nothing", device("mute"), reports)
    if target.sends("heartbeat"):
        yield case("heartbeat of a drive stops", device("heartbeat_stop"), target.beats)
    if target.sends("emcy"):
        emcy = device("emcy", code=0x2310, register=1)
        yield case("EMCY message of a drive", emcy, prompt, starts_at=1.0)
    bitrate = 250_000 if target.bus.bitrate != 250_000 else 125_000
    yield case(
        "a drive uses another bitrate",
        device("wrong_bitrate", bitrate=bitrate),
        reports,
        braking=watchdog,
    )
    # After its recovery, only the EMCY message tells that a drive was bus-off.
    recovered = reports if target.sends("emcy") else None
    yield case("a drive is bus-off", device("bus_off"), recovered, starts_at=1.0)
    yield case(
        "a drive receives nothing",
        device("lost_frames", share=1.0),
        {DRIVING: NOT_FOLLOWING},
        observed=2.6,
        braking=max(NOT_FOLLOWING, watchdog),
    )
    supervises = target.node.heartbeat_consumer_time is not None
    detects = supervises or controller_class(target.node).checks_watchdog
    limit = target.reading if supervises else SLOW
    yield case(
        "a drive forgets its watchdog",
        device("watchdog_lost"),
        dict.fromkeys((IDLE, DRIVING), limit) if detects else {},
        starts_at=1.0,
        observed=limit,
    )
    yield case(
        "a drive floods the bus with top-priority frames",
        device("babble", cob_id=0x001, period=0.0001),
        reports,
        braking=watchdog,
    )


def _object_cases(target: _Target) -> Iterator[FaultCase]:
    """Yields the cases of objects that a service tool overwrites at another interface."""

    def written(*changes: tuple[str, ObjectValue, int]) -> Injection:
        bus = target.bus.name

        def inject(rehearsal: Rehearsal) -> None:
            for node, entry, value in changes:
                key = {"index": entry.index, "subindex": entry.subindex}
                rehearsal.inject("object_written", bus, node, **key, value=value)

        return inject

    limit = target.reading
    more: dict[str, Any] = {"starts_at": 1.0, "observed": target.reading}
    deceleration = target.object(0x6084)
    if deceleration is not None:
        tiny = written((target.node.name, deceleration, 1))
        yield target.case("a deceleration of a drive is overwritten (0x6084)", tiny, limit, **more)
    other = next(
        (
            _Target(target.robot, target.bus, node)
            for node in target.bus.nodes
            if node.protocol == target.drives and node is not target.node
        ),
        None,
    )
    if target.report is None or target.report.pdo is None or other is None:
        return
    index = 0x1800 + target.report.pdo - 1
    first, second = target.object(index, 1), other.object(index, 1)
    if first is not None and second is not None:
        swap = written(
            (target.node.name, first, second.value or 0),
            (other.node.name, second, first.value or 0),
        )
        yield target.case("two drives swap their reports (0x1800)", swap, limit, **more)


def _identity_cases(target: _Target) -> Iterator[FaultCase]:
    node, bus = target.node, target.bus
    if not node.id_space:
        return
    others = [n.id for n in bus.nodes if n.id_space == node.id_space and n is not node]
    drives = [n.id for n in bus.nodes if n.id in others and n.channels]
    for other in (drives or others)[:1]:
        taken = target.device("duplicate_id", id=other)
        # The drive does not hear its own commands any more; a watchdog may only take its torque.
        braking = math.inf if math.isinf(target.watchdog) else None
        name = "a drive takes the id of another one"
        yield target.case(name, taken, target.silence, braking=braking)
    clone = target.device("clone")
    yield target.case("a second drive with the id of another one", clone, SECOND_DEVICE)


def _encoder_cases(target: _Target) -> Iterator[FaultCase]:
    case, device = target.case, target.device
    wheel, steering = target.channel("propulsion"), target.channel("steering")
    armed = (IDLE, *MOVING_PHASES)
    if wheel is not None:
        more: dict[str, Any] = {"phases": armed, "observed": 2.0}
        for name, kind in (
            ("encoder of a wheel freezes", "frozen_encoder"),
            ("a wheel is blocked", "blocked_motor"),
        ):
            yield case(name, device(kind, channel=wheel), {DRIVING: FROZEN_WHEEL}, **more)
    if steering is not None:
        frozen = device("frozen_encoder", channel=steering)
        limit = {DRIVING: FROZEN_STEERING}
        yield case("encoder of a steering freezes", frozen, limit, phases=armed, observed=2.6)
        jump = device("encoder_jump", channel=steering, angle=0.5)
        yield case("encoder of a steering jumps by 0.5 rad", jump, target.prompt, phases=armed)


def _disobedience_cases(target: _Target) -> Iterator[FaultCase]:
    case, device, cycle = target.case, target.device, target.cycle
    wheel = target.channel("propulsion")
    if wheel is None:
        return
    climbed = NOT_FOLLOWING + CLIMB
    later: dict[str, Any] = {"braking": climbed, "observed": climbed + 0.5}
    moving = dict.fromkeys(MOVING_PHASES, NOT_FOLLOWING)
    if target.node.is_canopen:
        # A motor that its own command watchdog stops is not seen to disobey when it should stop.
        noticed = {DRIVING: NOT_FOLLOWING} if target.node.command_watchdog else moving
        yield case("a drive ignores its commands", device("commands_ignored"), noticed, **later)
        yield case("reports of a drive freeze", device("frozen_reports"), moving, **later)
    if target.sends_at_sync():
        silence = target.silence
        hangs = {**later, "braking": silence + CLIMB}
        yield case("a drive ignores SYNC", device("sync_ignored"), silence, **hangs)
    for entry in target.node.objects:
        if entry.name == f"{wheel}_profile_deceleration":
            tiny = device("object_written", index=entry.index, subindex=entry.subindex, value=1)
            promise = {STOPPING: NOT_FOLLOWING}
            yield case(
                "deceleration of a drive made tiny",
                tiny,
                promise,
                **{**later, "phases": (IDLE, STOPPING)},
            )
    radius = max(w.radius for w in target.robot.wheels if w.driven)
    for name, speed in (("a wheel creeps at rest", CREEP), ("a slope turns a wheel at rest", ROLL)):
        pushed = device("pushed_motor", channel=wheel, speed=speed)
        yield case(
            name,
            pushed,
            {IDLE: CREEPING},
            phases=(IDLE,),
            motion=1.1 * speed * radius,
            observed=CREEPING + 20.0 * cycle,
        )
    yield case(
        "a wheel runs away at full speed",
        device("runaway_motor", channel=wheel, speed=FULL_SPEED),
        {IDLE: CREEPING, DRIVING: NOT_FOLLOWING},
        phases=(IDLE, DRIVING),
        braking=math.inf,
        motion=math.inf,
        observed=climbed,
    )


def _forgery_cases(target: _Target) -> Iterator[FaultCase]:
    case, cycle = target.case, target.cycle
    if target.command is not None:
        other = target.repeated(target.command, target.command.period or cycle)
        yield case("another master sends commands to a drive", other, target.silence)
        for form in scenario.FRAME_FORMATS[1:] if not target.command.extended else ():
            frames = target.forged(target.command.cob_id, bytes(8), cycle, form)
            yield case(f"{form} frames with the id of a command", frames, None)
    if target.report is not None:
        old = target.repeated(target.report, target.report.period or cycle)
        yield case("false reports of a drive: of another time", old, SECOND_DEVICE)
        values = {**_address(target.report), "period": target.report.period}
        jumping = target.on_node(None, "forged_frames", **values)
        yield case("false reports of a drive: random", jumping, SECOND_DEVICE)


def _wrong_data_cases(target: _Target) -> Iterator[FaultCase]:
    """Yields the cases of a drive that gets its commands late or not, or measures nonsense."""
    case, device, node = target.case, target.device, target.node.name
    wheel, steering = target.channel("propulsion"), target.channel("steering")
    if target.command is not None:
        command = _address(target.command)
        for latency in (0.08, 0.2):
            late = device("late_frames", **command, share=1.0, latency=latency)
            name = f"commands of a drive arrive {latency:g} s late"
            yield case(name, late, None, by_ramp=True, braking=latency + target.cycle)
        lost = device("lost_frames", **command, share=0.4)
        yield case(
            "two in five commands of a drive are lost", lost, None, by_ramp=True, braking=0.1
        )
    if wheel is not None:
        number = target.number(wheel)
        wrong = partial(Rehearsal.falsify_speed, node=node, channel=number, share=0.3, largest=5.0)
        name = "three in ten speeds of a wheel are random"
        yield case(name, wrong, RANDOM_SPEEDS, phases=(IDLE, *MOVING_PHASES), observed=3.0)
    if steering is not None:
        number, angle = target.number(steering), math.radians(12.0)
        swing = partial(Rehearsal.hunt, node=node, channel=number, speed=1.0)
        hunts = partial(swing, offset=angle, angle=angle)
        later: dict[str, Any] = {"phases": (IDLE, *MOVING_PHASES), "braking": SWINGING}
        yield case("a steering hunts about a wrong angle", hunts, SWINGING, **later, observed=10.0)


def _bus_cases(target: _Target) -> Iterator[FaultCase]:
    case, cycle, prompt = target.case, target.cycle, target.prompt
    yield case(
        "power of all drives cut",
        target.on_node(None, "power_cut"),
        target.silence,
        rolls_out=True,
        observed=min(roll_out(target.robot).time + 1.0, LONGEST_ROLL),
    )
    if stopping.swerve_bounds(target.robot):
        name = target.bus.name
        # The wheels of the other buses stop together with those of the lost bus.
        more: dict[str, Any] = {"phases": (IDLE, *MOVING_PHASES), "braking": target.watchdog}
        lost = f"the driver loses the bus {name} of several"
        yield case(lost, lambda rehearsal: rehearsal.lose_bus(name), prompt, **more)
        silent = target.on_node(None, "lost_frames", share=1.0)
        yield case(f"the bus {name} of several is silent", silent, target.silence, **more)
    yield case("one frame in ten is destroyed", target.on_node(None, "noise", share=0.1), None)
    late_frames = target.on_node(None, "late_frames", share=1.0, latency=1.5 * target.cycle)
    delay = prompt + 1.5 * cycle
    yield case("all frames arrive 1.5 cycles late", late_frames, None, braking=delay)
    twice = target.on_node(None, "repeated_frames", share=1.0)
    # CANopen nodes send SDO responses and boot-up messages twice, others only too many reports.
    canopen = any(node.is_canopen for node in target.bus.nodes)
    delay = prompt if canopen else SECOND_DEVICE
    yield case("all frames arrive twice", twice, None, braking=delay)
    kinds = {frame.kind for frame in target.bus.frames if frame.producer == MASTER}
    if "sync" in kinds:
        yield case("another master sends SYNC", target.forged(SYNC, b"", cycle), prompt)
    for frame in target.bus.frames:
        if frame.producer == MASTER and frame.kind == "heartbeat":
            beat = target.forged(frame.cob_id, b"\x05", frame.period or 0.1)
            limit = prompt + (frame.period or 0.1)
            yield case("another master sends its heartbeat", beat, limit)
    if "nmt" in kinds:
        stop = target.forged(NMT, bytes([NmtCommand.STOP, 0]))
        yield case("another master stops all nodes (NMT)", stop, prompt, starts_at=1.0)


def _stranger_cases(target: _Target) -> Iterator[FaultCase]:
    """Yields the cases of frames that nobody on the bus should send."""
    case, bus, prompt = target.case, target.bus, target.prompt
    if any(node.is_canopen for node in bus.nodes):
        everyone = bytes([lss.SWITCH_STATE_GLOBAL, lss.CONFIGURATION])
        messages = (everyone, bytes([lss.CONFIGURE_NODE_ID, 9]), bytes([lss.STORE_CONFIGURATION]))
        padded = [message.ljust(8, b"\0") for message in messages]
        stored = partial(Rehearsal.send_foreign, bus=bus.name, cob_id=LSS_REQUEST, messages=padded)
        yield case("another master stores the id 9 in all drives (LSS)", stored, prompt)
        unknown = max(set(range(1, 127)) - {node.id for node in bus.nodes})
        emcy = target.forged(EMCY + unknown, Emergency(0x2310, 1).pack())
        yield case("EMCY message of an unknown node", emcy, None)
    half = 2.0 * frame_bits(CanFrame(0x001, bytes(8))) / bus.bitrate
    babble = target.device("babble", cob_id=0x001, period=half)
    yield case("a drive fills half of the bus with top-priority frames", babble, None)


def _battery_cases(target: _Target) -> Iterator[FaultCase]:
    robot, case = target.robot, target.case
    by_name = {node.name: bus.name for bus in robot.buses for node in bus.nodes}
    on_buses = [b.node for b in robot.batteries if b.node in by_name]
    if not on_buses:
        return
    # Batteries in parallel are low together, or the others supply the robot.
    several = len(robot.common_source) > 1
    supplying = on_buses if several else on_buses[:1]
    batteries = "all batteries" if several else "battery"

    def injection(nodes: Iterable[str], kind: str, **values: Any) -> Injection:
        def inject(rehearsal: Rehearsal) -> None:
            for node in nodes:
                rehearsal.inject(kind, by_name[node], node, **values)

        return inject

    low = injection(supplying, "battery_charge", charge=0.05)
    # It stops nothing: at rest the driver only warns, which the start-up shows.
    phases = (START, DRIVING)
    yield case(f"{batteries} at 5 %", low, None, phases=phases, observed=2.0 * SLOW)
    empty = injection(supplying, "battery_charge", charge=0.0)
    stopped: dict[str, Any] = {"by_ramp": True, "braking": SLOW, "observed": SLOW}
    yield case(f"{batteries} empty", empty, {DRIVING: SLOW}, **stopped)
    if several:
        first = injection(on_buses[:1], "battery_charge", charge=0.0)
        yield case("one of several batteries empty", first, None, phases=phases, observed=SLOW)

    def lose_voltage(rehearsal: Rehearsal) -> None:
        for node in supplying:
            rehearsal.simulated.devices[node].voltage = 0.0  # type: ignore[attr-defined]

    yield case(f"{batteries} at 0 V", lose_voltage, None, phases=phases, observed=SLOW)
    silence = robot.driver.battery.silence + SLOW
    yield case(
        "battery sends nothing",
        injection(on_buses[:1], "mute"),
        {DRIVING: silence},
        phases=phases,
        by_ramp=True,
        braking=silence,
        observed=silence,
    )


def _program_cases(target: _Target) -> Iterator[FaultCase]:
    case, prompt, watchdog = target.case, target.prompt, target.watchdog

    def stalls(seconds: float) -> Injection:
        return lambda rehearsal: rehearsal.stall(seconds)

    def client_ends(rehearsal: Rehearsal) -> None:
        rehearsal.stall(0.2)
        rehearsal.close_client()
        rehearsal.stall(0.5)

    for seconds in (0.05, 0.2, 0.55, 0.7, 1.0, 5.0):
        detected = seconds + target.cycle + prompt
        yield case(
            f"driver stalls for {seconds:g} s",
            stalls(seconds),
            {DRIVING: detected},
            starts_at=1.0,
            by_ramp=True,
            braking=min(detected, watchdog),
            observed=seconds + 1.0,
        )
    yield case(
        "driver stalls for 0.7 s, client ends meanwhile",
        client_ends,
        {DRIVING: 0.7 + target.cycle + prompt},
        phases=MOVING_PHASES,
        braking=watchdog,
        observed=1.7,
    )
    yield case(
        "driver process killed",
        Rehearsal.kill_driver,
        None,
        phases=PHASES[1:],
        braking=watchdog,
        must_stop=True,
        observed=1.5,
    )
    client: dict[str, Any] = {"phases": MOVING_PHASES, "by_ramp": True, "observed": 1.5}
    yield case("client hangs", Rehearsal.silence_client, {DRIVING: target.timeout}, **client)
    closed = "connection of the client closed"
    yield case(closed, Rehearsal.close_client, {DRIVING: target.timeout}, **client)
