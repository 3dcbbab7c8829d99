"""Each fault of a bus in each phase of a robot's day: what the driver does, and how soon.

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
from thorvaldc.runtime.can_base.base_state_machine import State
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.bus.fault_injection import FaultInjector

PAGE = Path(__file__).parents[3] / "docs" / "faults.md"
BEGIN, END = "<!-- made by tests/runtime/fault_matrix.py -->\n", "<!-- end -->\n"
PHASES = ("idle", "driving", "stopping")
WATCHED = {"idle": 1.0, "driving": 2.6, "stopping": 1.0}
AFTERWARDS = 0.2
"""s for which a robot is watched after a fault that does not stop it, and after it has stopped."""
WEAVE = 0.6
"""s of a curve to one side while it drives: its steerings have to turn."""

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
    """Its drives home ten times as fast as is usual, not to wait for it."""
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
    """A fault, and what is promised: s until the driver is in its fault state (``None``: it need
    not be), and until all wheels have come to rest."""

    what: str
    fault: BusFault
    reaction: dict[str, float | None]
    rest: float


def _fault(kind: str, node: str | None = "fl_controller", **more: object) -> BusFault:
    return BusFault(kind, "main", node, 0.0, None, SPAN, **more)  # type: ignore[arg-type]


def _always(time: float | None) -> dict[str, float | None]:
    return dict.fromkeys(PHASES, time)


REPORTS = 0.1
"""s: two reports of 20 ms missed in a row, and a cycle in which it is seen."""
CASES = (
    Case("power of a drive cut", _fault("power_cut"), _always(REPORTS), 0.8),
    Case("power of all cut", _fault("power_cut", None), _always(REPORTS), 0.8),
    Case("drive is mute", _fault("mute"), _always(REPORTS), 0.8),
    Case("drive's heartbeat stops", _fault("heartbeat_stop"), _always(0.4), 1.1),
    Case("drive takes another's id", _fault("duplicate_id", id=2), _always(REPORTS), 0.8),
    Case(
        "drive babbles, most urgent frames",
        _fault("babble", cob_id=0x001, period=0.0001),
        _always(REPORTS),
        1.3,
    ),
    Case("emergency of a drive", _fault("emcy", code=0x2310, register=1), _always(REPORTS), 0.8),
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
        "drive at another bitrate", _fault("wrong_bitrate", bitrate=250_000), _always(REPORTS), 1.3
    ),
    Case("drive is off the bus (bus-off)", _fault("bus_off"), _always(REPORTS), 0.8),
    Case(
        "drive hears nothing any more",
        _fault("lost_frames", share=1.0),
        {"idle": None, "driving": 1.8, "stopping": None},
        2.0,
    ),
    Case("one frame in ten is destroyed", _fault("noise", None, share=0.1), _always(None), 9.9),
)


class Reaction(NamedTuple):
    """``state`` and ``after`` (s): the fault state and how soon, ``None`` where there was none.

    ``rest`` (s): until all wheels stood for good; ``None`` where they did not.
    """

    state: State | None
    after: float | None
    rest: float | None

    def __str__(self) -> str:
        if self.state is None:
            return "goes on"
        return f"{self.state.value} in {_tenths(self.after)}"


def react(robot: Robot, phase: str, fault: BusFault) -> Reaction:
    """Bring a robot into the phase, let the fault happen, and watch."""
    rig = Rig(robot)
    rig.ready()
    if phase != "idle":
        _drive(rig, 2 * WEAVE)
    if phase == "stopping":
        rig.twist = ZERO_TWIST
        rig.run(0.1)
    wanted = {"idle": State.READY, "driving": State.ACTIVE, "stopping": State.ACTIVE}
    assert rig.state is wanted[phase], f"{rig.state} {rig.reason}"
    struck = rig.now
    FaultInjector(rig.simulated, BusFaults(())).strike(fault)
    state, after, rest = None, None, None
    while rig.now < struck + WATCHED[phase]:
        if phase == "driving":
            _steer(rig)
        rig.run(rig.base.period)
        if state is None and rig.state in (State.FAULT, State.ESTOP):
            state, after = rig.state, rig.now - struck
        if rig.speed() > 0.0:
            rest = None
        elif rest is None:
            rest = rig.now - struck
        elif state is not None and rig.now - struck > max(rest, after or 0.0) + AFTERWARDS:
            break
    return Reaction(state, after, rest)


def _drive(rig: Rig, seconds: float) -> None:
    until = rig.now + seconds
    while rig.now < until - 1e-9:
        _steer(rig)
        rig.run(rig.base.period)


def _steer(rig: Rig) -> None:
    """To the left and to the right in turns."""
    side = 1.0 if int(rig.now / WEAVE) % 2 else -1.0
    rig.twist = Twist(0.4, 0.0, 0.4 * side)


# -- the page --------------------------------------------------------------------------------


Found = dict[str, Reaction]
"""By phase."""


def row(case: Case, drives: str, found: Found) -> str:
    """The line of a case with one kind of drive."""
    cells = [str(found[phase]) for phase in PHASES]
    rest = found["driving"].rest
    cells.append("" if rest is None else _tenths(rest))
    most = max((time for time in case.reaction.values() if time is not None), default=None)
    cells.append("" if most is None else f"{_tenths(most)}, {case.rest:.1f} s")
    return f"| {case.what} | {drives} | {' | '.join(cells)} |"


def _tenths(seconds: float | None) -> str:
    """Rounded up: the table does not change with every cycle more or less."""
    return f"{math.ceil(10.0 * (seconds or 0.0) - 1e-6) / 10:.1f} s"


def table() -> Iterator[str]:
    yield "| fault | drives | idle | driving | stopping | at rest | promised |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for case in CASES:
        for drives, robot in ROBOTS.items():
            yield row(case, drives, {p: react(robot(), p, case.fault) for p in PHASES})


def main() -> int:
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    lines = "".join(f"{line}\n" for line in table())
    PAGE.write_text(before + BEGIN + lines + END + rest.partition(END)[2], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
