"""Missions that aim at one rule of the driver each; random missions reach some of them rarely.

Each function draws the twists, times and clients, and returns the events with the time (s) of the
end.  A pilot publishes ``teleop_joy``, another program ``auto_nav``, and a guard sets stops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from tests.chaos.chaos_robots import LOUD_SOURCE
from tests.chaos.invariants import PUSHED
from tests.chaos.schedule import ChaosEvent

if TYPE_CHECKING:
    from tests.chaos.mission_generator import MissionGenerator

TWIST = '{"call": "twist", "arguments": {"source": "teleop_joy", "vx": %g}}\n'
Mission = tuple[list[ChaosEvent], float]
RATES = (10.0, 20.0, 50.0)
BEGIN = 0.3
"""s until the armed robot is driven."""


def drive(
    at: float, client: str, source: str, twist: list[float], seconds: float, **more: Any
) -> ChaosEvent:
    """Returns the event of a client that publishes a twist for some seconds."""
    values = {"client": client, "source": source, "twist": twist, "seconds": round(seconds, 2)}
    return ChaosEvent(at, "drive", {**values, "rate": 20.0, **more})


def call(at: float, client: str, service: str, **arguments: Any) -> ChaosEvent:
    values: dict[str, Any] = {"client": client, "service": service}
    return ChaosEvent(at, "call", {**values, "arguments": arguments} if arguments else values)


def flooded(make: MissionGenerator) -> Mission:
    """The pilot sends thousands of twists at once and then hangs."""
    draw = make.draw
    seconds, twist = draw.uniform(0.5, 1.5), make.fast_twist()
    at = BEGIN + seconds * draw.uniform(0.4, 1.0)
    flood = {"client": "pilot", "text": TWIST % twist[0], "times": 5000}
    events = [
        *make.arm(0.1, "pilot"),
        drive(BEGIN, "pilot", "teleop_joy", twist, seconds, rate=draw.choice(RATES)),
        ChaosEvent(at, "raw", flood),
        ChaosEvent(at + 0.01, "hang", {"client": "pilot"}),
    ]
    if draw.random() < 0.5:
        events += make.stall(at + draw.uniform(0.0, 0.5))
    return events, at + draw.uniform(0.5, 2.0)


def disobedient(make: MissionGenerator) -> Mission:
    """A drive does not obey while the robot drives and stops, or something else turns a wheel of a
    robot that should stand."""
    draw = make.draw
    driven = draw.uniform(1.0, 2.5)
    events = [
        *make.arm(0.1, "pilot"),
        drive(BEGIN, "pilot", "teleop_joy", make.fast_twist(), driven),
    ]
    kind = draw.randrange(4)
    if kind == 0:
        at = BEGIN + driven + draw.uniform(2.0, 3.0)
        speed = draw.choice((0.5, -0.5, 2.0))
        events.append(make.inject_controller(at, PUSHED, 4.0, wheel=True, speed=speed))
    else:
        at = BEGIN + driven * draw.uniform(0.5, 0.9)
        name = draw.choice(("commands_ignored", "commands_ignored", "sync_ignored"))
        names = (name, "nmt_ignored") if kind > 1 else (name,)
        events += make.inject_together(at, names, 10.0)
        if draw.random() < 0.5:
            events.append(call(BEGIN + driven, "pilot", "safety_stop"))
    return events, at + draw.uniform(5.0, 8.0)


def stalled(make: MissionGenerator) -> Mission:
    """The driver stalls once for long, or after every few cycles, while a stick is held."""
    draw = make.draw
    twist, seconds = make.fast_twist(), 8.0
    at = BEGIN + draw.uniform(0.8, 1.5)
    events = [
        *make.arm(0.1, "pilot"),
        drive(BEGIN, "pilot", "teleop_joy", twist, seconds, rate=draw.choice(RATES)),
    ]
    if draw.random() < 0.4:
        stall, cycles, stalls = draw.uniform(0.3, 2.3), 0, 1
    else:
        stall, cycles = draw.choice((0.06, 0.12, 0.17, 0.2, 0.22)), draw.choice((1, 2, 3))
        stalls = round(draw.uniform(1.0, 3.0) / stall)
    if draw.random() < 0.5:  # the pilot ends before or during the stalls
        events.append(ChaosEvent(at + draw.uniform(-0.1, 0.3), "close", {"client": "pilot"}))
    period = min(bus.sync_period for bus in make.robot.buses)
    for _ in range(stalls):
        events.append(ChaosEvent(at, "stall", {"seconds": round(stall, 3), "sending": False}))
        at += stall + cycles * period
    return events, at + draw.uniform(0.5, 1.5)


def taken_over(make: MissionGenerator) -> Mission:
    """A joystick at zero, of a higher priority, falls silent while a program holds a twist."""
    draw = make.draw
    rest, twist = [0.0, 0.0, 0.0], make.fast_twist()
    at = BEGIN + draw.uniform(0.7, 2.0)
    held = drive(0.2, "nav", "auto_nav", twist, 6.0, rate=draw.choice(RATES))
    events = [
        *make.arm(0.1, "pilot"),
        held,
        drive(0.2, "pilot", "teleop_joy", rest, 10.0, rate=draw.choice(RATES)),
        ChaosEvent(at, draw.choice(("close", "hang")), {"client": "pilot"}),
    ]
    return events, at + draw.uniform(1.0, 2.5)


def reconnected(make: MissionGenerator) -> Mission:
    """A program or its connection ends; after some seconds it is back, with its stick held."""
    draw = make.draw
    client, source = draw.choice((("pilot", "teleop_joy"), ("nav", "auto_nav")))
    twist, driven = make.fast_twist(), draw.uniform(0.8, 1.5)
    gone = BEGIN + driven * draw.uniform(0.6, 0.9)
    back = gone + draw.choice((0.1, 0.7, 3.0))
    events = [
        *make.arm(0.1, "pilot"),
        drive(BEGIN, client, source, twist, driven),
        ChaosEvent(gone, draw.choice(("close", "close", "hang")), {"client": client}),
        drive(back, client, source, twist, 1.5, held=True),
    ]
    return events, back + draw.uniform(0.5, 2.0)


def held_through_stop(make: MissionGenerator) -> Mission:
    """A stop lock comes and goes while a source holds its twist, one as loud as the stop too."""
    draw = make.draw
    client, source = draw.choice(
        (("pilot", "teleop_joy"), ("nav", "auto_nav"), ("nav", LOUD_SOURCE))
    )
    begin, locked = draw.uniform(0.1, 0.4), BEGIN + draw.uniform(0.5, 1.5)
    if draw.random() < 0.3:  # the source begins behind the lock
        locked = draw.uniform(0.0, 0.25)
    released = locked + draw.choice((0.1, 0.5, 1.5))
    name = draw.choice([lock.name for lock in make.robot.twist_locks])
    twist = make.fast_twist()
    held = draw.random() < 0.3
    events = [
        *make.arm(0.05, "pilot"),
        drive(begin, client, source, twist, 6.0, rate=draw.choice(RATES), held=held),
        call(locked, "guard", "lock", name=name, locked=True),
    ]
    if draw.random() < 0.8:
        events.append(call(released, "guard", "lock", name=name, locked=False))
    return events, released + draw.uniform(0.7, 1.5)


def released_by_others(make: MissionGenerator) -> Mission:
    """A stranger releases the stop of the guard, and the pilot arms and drives."""
    draw = make.draw
    at = 0.1
    if draw.random() < 0.7:
        name = draw.choice([lock.name for lock in make.robot.twist_locks])
        events = [
            call(at, "guard", "lock", name=name, locked=True),
            call(at + 0.15, "stranger", "lock", name=name, locked=False),
        ]
        at += 0.3
    else:
        events = [
            call(at, "guard", "safety_stop"),
            call(at + 0.3, "stranger", "release_safety_stop"),
            call(at + 0.5, "pilot", "reset_faults"),
        ]
        at += draw.uniform(2.5, 4.0)
    if draw.random() < 0.3:  # the guard has ended; its stop stays
        events.append(ChaosEvent(at - 0.02, "close", {"client": "guard"}))
    events += [*make.arm(at, "pilot"), drive(at + 0.2, "pilot", "teleop_joy", make.fast_twist(), 2)]
    return events, at + 2.0


def contested(make: MissionGenerator) -> Mission:
    """Another program publishes the source that the slow pilot holds."""
    draw = make.draw
    slow = [draw.choice((0.0, 0.2)), 0.0, 0.0]
    at = BEGIN + draw.uniform(0.2, 1.0)
    events = [
        *make.arm(0.1, "pilot"),
        drive(BEGIN, "pilot", "teleop_joy", slow, 4.0),
        drive(at, "hostile", "teleop_joy", make.fast_twist(), 1.5, rate=50.0),
    ]
    return events, at + draw.uniform(1.0, 2.0)


def disarmed(make: MissionGenerator) -> Mission:
    """Somebody drives a robot that nobody has armed, or that was disarmed."""
    draw = make.draw
    client, source = draw.choice((("pilot", "teleop_joy"), ("nav", "auto_nav")))
    drives = drive(BEGIN, client, source, make.fast_twist(), 5.0, rate=draw.choice(RATES))
    at = BEGIN + draw.uniform(0.5, 1.2)
    if draw.random() < 0.5:
        return [drives], at + 1.0
    return [*make.arm(0.1, "pilot"), drives, call(at, "guard", "disarm")], at + 1.5


def emptied(make: MissionGenerator) -> Mission:
    """The battery runs empty while the robot drives."""
    at = BEGIN + make.draw.uniform(0.2, 0.8)
    events = [
        *make.arm(0.1, "pilot"),
        drive(BEGIN, "pilot", "teleop_joy", make.fast_twist(), 6.0),
        *make.empty_battery(at),
    ]
    return events, at + 4.0


def overwritten(make: MissionGenerator) -> Mission:
    """A service tool overwrites an object of a drive while the robot stands or drives."""
    draw = make.draw
    events: list[ChaosEvent] = list(make.objects(draw.uniform(0.1, 1.0)))
    if draw.random() < 0.6:
        events += make.arm(0.1, "pilot")
        events.append(drive(BEGIN, "pilot", "teleop_joy", make.twist(), draw.uniform(0.5, 3.0)))
    return events, 5.0


def doubled(make: MissionGenerator) -> Mission:
    """A second device or a second master is on the bus while the robot drives."""
    draw = make.draw
    maker: Callable[[float], Iterator[ChaosEvent]] = draw.choice(
        (make.forged, make.forged, make.clone, make.moved_id)
    )
    at = BEGIN + draw.uniform(0.3, 1.0)
    drives = drive(BEGIN, "pilot", "teleop_joy", make.fast_twist(), 4.0)
    return [*make.arm(0.1, "pilot"), drives, *maker(at)], at + draw.uniform(1.5, 3.0)


FOCUSED: tuple[Callable[[MissionGenerator], Mission], ...] = (
    flooded,
    disobedient,
    stalled,
    taken_over,
    reconnected,
    held_through_stop,
    released_by_others,
    contested,
    disarmed,
    emptied,
    overwritten,
    doubled,
)
