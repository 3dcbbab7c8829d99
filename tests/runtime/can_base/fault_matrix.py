"""Injects each fault in each phase of a run, and measures how the driver reacts.

``python -m tests.runtime.can_base.fault_matrix`` writes the table into docs/faults.md.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from tests.robots import SPAN
from tests.runtime.can_base.simulated_rig import Rig
from tests.simulation.bus.robots import compiled
from thorvaldc.model import Robot
from thorvaldc.model.bus import ObjectValue
from thorvaldc.model.bus_faults import BusFault, BusFaults
from thorvaldc.runtime.can_base.base_state import BaseState
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.bus.fault_injection import FaultInjector

PAGE = Path(__file__).parents[3] / "docs" / "faults.md"
BEGIN, END = "<!-- made by tests/runtime/can_base/fault_matrix.py -->\n", "<!-- end -->\n"
PHASES = ("idle", "driving", "stopping")
OBSERVED = {"idle": 1.0, "driving": 2.6, "stopping": 1.0}
AFTERWARDS = 0.2
"""s of observation after the fault state was entered and all wheels have stopped."""
WEAVE = 0.6
"""s of a curve to one side while driving, so that the steerings turn."""

_CIA402 = "controller/cia402_propulsion_steering"
_ROBOT = """
thorvaldc: 1
name: two_drives
modules:
  frame: {{type: frame/tube_rectangular,
    params: {{length: 1.2 m, width: 800 mm, cross_members: [-100 mm]}}}}
  fl: {{type: assembly/steered_drive, mount: frame.front_left{controller}, can: 1}}
  fr: {{type: assembly/steered_drive, mount: frame.front_right{controller}, can: 2}}
  rl: {{type: caster/swivel, mount: frame.rear_left}}
  rr: {{type: caster/swivel, mount: frame.rear_right}}
  battery: {{type: battery/enclosure, mount: {{parent: frame, xyz: [0, 0, 0.07]}}, can: 1}}
"""


def cia402() -> Robot:
    """A robot with CiA 402 drives that home ten times faster than usual, to save time."""
    robot = compiled(_ROBOT.format(controller=", params: {controller: " + _CIA402 + "}"))
    nodes = tuple(
        replace(node, objects=tuple(_quicker(entry) for entry in node.objects))
        for node in robot.buses[0].nodes
    )
    return replace(robot, buses=(replace(robot.buses[0], nodes=nodes),))


def _quicker(entry: ObjectValue) -> ObjectValue:
    homes = entry.name.startswith("steering_homing_") and entry.index in (0x6899, 0x689A)
    return replace(entry, value=10 * (entry.value or 0)) if homes else entry


def roboteq() -> Robot:
    return compiled(_ROBOT.format(controller=""))


ROBOTS: dict[str, Callable[[], Robot]] = {"CiA 402": cia402, "Thorvald script": roboteq}


class Case(NamedTuple):
    """An injected fault and the promised reaction.

    ``reaction``: time (s) until the fault state by phase; ``None``: no fault state is required.
    ``rest``: time (s) until no wheel turns.
    """

    name: str
    fault: BusFault
    reaction: dict[str, float | None]
    rest: float


def _fault(kind: str, node: str | None = "fl_controller", **more: object) -> BusFault:
    return BusFault(kind, "main", node, 0.0, None, SPAN, **more)  # type: ignore[arg-type]


def _always(time: float | None) -> dict[str, float | None]:
    return dict.fromkeys(PHASES, time)


REPORTS = 0.1
"""s: two missed reports in a row (20 ms each), and the cycle that detects it."""
CASES = (
    Case("power of a drive cut", _fault("power_cut"), _always(REPORTS), 0.8),
    Case("power of all drives cut", _fault("power_cut", None), _always(REPORTS), 0.8),
    Case("a drive sends nothing", _fault("mute"), _always(REPORTS), 0.8),
    Case("heartbeat of a drive stops", _fault("heartbeat_stop"), _always(0.4), 1.1),
    Case(
        "a drive takes the id of another one", _fault("duplicate_id", id=2), _always(REPORTS), 0.8
    ),
    Case(
        "a drive floods the bus with top-priority frames",
        _fault("babble", cob_id=0x001, period=0.0001),
        _always(REPORTS),
        1.3,
    ),
    Case("EMCY message of a drive", _fault("emcy", code=0x2310, register=1), _always(REPORTS), 0.8),
    Case(
        "encoder of a wheel freezes",
        _fault("frozen_encoder", channel="propulsion"),
        {"idle": None, "driving": 0.7, "stopping": None},
        1.4,
    ),
    Case(
        "encoder of a steering freezes",
        _fault("frozen_encoder", channel="steering"),
        {"idle": None, "driving": 1.2, "stopping": None},
        1.4,
    ),
    Case(
        "a drive uses another bitrate",
        _fault("wrong_bitrate", bitrate=250_000),
        _always(REPORTS),
        1.3,
    ),
    Case("a drive is bus-off", _fault("bus_off"), _always(REPORTS), 0.8),
    Case(
        "a drive receives nothing",
        _fault("lost_frames", share=1.0),
        {"idle": None, "driving": 1.8, "stopping": None},
        2.0,
    ),
    Case("one frame in ten is destroyed", _fault("noise", None, share=0.1), _always(None), 9.9),
)


class Reaction(NamedTuple):
    """The measured reaction.

    ``state`` and ``after`` (s): fault state and the time until it was entered; ``None``: none.
    ``rest``: time (s) until all wheels stood; ``None``: they still turned.
    """

    state: BaseState | None
    after: float | None
    rest: float | None

    def __str__(self) -> str:
        if self.state is None:
            return "continues"
        return f"{self.state.value} in {_tenths(self.after)}"


def react(robot: Robot, phase: str, fault: BusFault) -> Reaction:
    """Drives a robot into the phase, injects the fault, and observes the reaction."""
    rig = Rig(robot)
    rig.ready()
    rig.arm()
    if phase != "idle":
        _drive(rig, 2 * WEAVE)
    if phase == "stopping":
        rig.twist = ZERO_TWIST
        rig.run(0.1)
    expected = {"idle": BaseState.READY, "driving": BaseState.ACTIVE, "stopping": BaseState.ACTIVE}
    assert rig.state is expected[phase], f"{rig.state} {rig.reason}"
    injected_at = rig.now
    FaultInjector(rig.simulated, BusFaults(())).inject(fault)
    state, after, rest = None, None, None
    while rig.now < injected_at + OBSERVED[phase]:
        if phase == "driving":
            _steer(rig)
        rig.run(rig.base.period)
        if state is None and rig.state in (BaseState.FAULT, BaseState.ESTOP):
            state, after = rig.state, rig.now - injected_at
        if rig.speed() > 0.0:
            rest = None
        elif rest is None:
            rest = rig.now - injected_at
        elif state is not None and rig.now - injected_at > max(rest, after or 0.0) + AFTERWARDS:
            break
    return Reaction(state, after, rest)


def _drive(rig: Rig, seconds: float) -> None:
    until = rig.now + seconds
    while rig.now < until - 1e-9:
        _steer(rig)
        rig.run(rig.base.period)


def _steer(rig: Rig) -> None:
    """Commands curves to the left and to the right in turns."""
    side = 1.0 if int(rig.now / WEAVE) % 2 else -1.0
    rig.twist = Twist(0.4, 0.0, 0.4 * side)


# -- the page --------------------------------------------------------------------------------


Reactions = dict[str, Reaction]
"""Measured reactions by phase."""


def row(case: Case, drives: str, reactions: Reactions) -> str:
    """Returns the table row of a case with one kind of drive."""
    cells = [str(reactions[phase]) for phase in PHASES]
    rest = reactions["driving"].rest
    cells.append("" if rest is None else _tenths(rest))
    longest = max((time for time in case.reaction.values() if time is not None), default=None)
    cells.append("" if longest is None else f"{_tenths(longest)}, {case.rest:.1f} s")
    return f"| {case.name} | {drives} | {' | '.join(cells)} |"


def _tenths(seconds: float | None) -> str:
    """Returns the time rounded up to 0.1 s, so that single cycles do not change the table."""
    return f"{math.ceil(10.0 * (seconds or 0.0) - 1e-6) / 10:.1f} s"


def table() -> Iterator[str]:
    yield "| injected fault | drives | idle | driving | stopping | at rest | promised |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for case in CASES:
        for drives, robot in ROBOTS.items():
            yield row(case, drives, {p: react(robot(), p, case.fault) for p in PHASES})


def main() -> int:
    head, _, tail = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    lines = "".join(f"{line}\n" for line in table())
    PAGE.write_text(head + BEGIN + lines + END + tail.partition(END)[2], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
