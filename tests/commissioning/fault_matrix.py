"""Each injected fault in each phase of a flash: its result, its duration, and the resume.

``python -m tests.commissioning.fault_matrix`` writes the table into docs/commissioning.md.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from tests.commissioning.bench import NODES, SWAPPED, Bench, four_drives
from tests.robots import SPAN
from thorvaldc.commissioning.journal import Journal
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model.scenario import BusFault, BusFaults
from thorvaldc.simulation.bus.fault_injection import FaultInjector

PAGE = Path(__file__).parents[2] / "docs" / "commissioning.md"
BEGIN, END = (
    "<!-- made by tests/commissioning/fault_matrix.py -->\n",
    "<!-- end -->\n",
)


class Case(NamedTuple):
    """A fault that begins in the middle of a flash."""

    name: str
    fault: BusFault


def _fault(kind: str, node: str | None = "fl_controller", **more: Any) -> BusFault:
    return BusFault(kind, "main", node, 0.0, None, SPAN, **more)


CASES = (
    Case("power of a drive cut", _fault("power_cut")),
    Case("power of all drives cut", _fault("power_cut", None)),
    Case("a drive sends nothing", _fault("mute")),
    Case("heartbeat of a drive stops", _fault("heartbeat_stop")),
    Case("a drive takes the id of another one", _fault("duplicate_id", id=2)),
    Case(
        "a drive floods the bus with top-priority frames",
        _fault("babble", cob_id=0x001, period=0.0001),
    ),
    Case("EMCY message of a drive", _fault("emcy", code=0x2310, register=1)),
    Case("encoder of a wheel freezes", _fault("frozen_encoder", channel="propulsion")),
    Case("encoder of a steering freezes", _fault("frozen_encoder", channel="steering")),
    Case("a drive uses another bitrate", _fault("wrong_bitrate", bitrate=250_000)),
    Case("a drive is bus-off", _fault("bus_off")),
    Case("a drive receives nothing", _fault("lost_frames", share=1.0)),
    Case("one frame in ten is destroyed", _fault("noise", None, share=0.1)),
)
PHASES = {"scanning": 160, "addresses": 376, "values": 436}
"""Frame of the flash, counted from its start, in the middle of which the fault begins."""
LONGEST = 10.0
"""s: longest time until the flash stops (5 s for a node to start, and further requests)."""


class ManualFaultInjector(FaultInjector):
    """Starts a fault with ``inject``; the test ends it with ``remove``."""

    remove: Callable[[], None]
    struck_at = 0.0

    def inject(self, fault: BusFault) -> None:
        self.struck_at = self.simulated.timeline.seconds
        self.remove = self.start(fault)


class Reaction(NamedTuple):
    """Result of a flash with an injected fault.

    ``code``: name of the diagnostic that stops it, empty if it goes on.  ``after``: s from the
    fault to the stop.  ``resumed``: without the fault and after a power cycle, a resume reaches
    the planned configuration.
    """

    code: str
    after: float
    resumed: bool

    def __str__(self) -> str:
        return f"`{self.code}`, {1000 * self.after:.0f} ms" if self.code else "goes on"


def react(fault: BusFault, frame: int) -> Reaction:
    if fault.kind == "duplicate_id":
        fault = dataclasses.replace(fault, id=1 if frame == PHASES["scanning"] else 2)
    bench = Bench(four_drives(), SWAPPED)
    injector = ManualFaultInjector(bench.simulated, BusFaults(()))
    bench.wire.at_frame(bench.wire.frames + frame, lambda: injector.inject(fault))
    code = ""
    try:
        bench.apply()
    except DiagnosticError as error:
        code = error.diagnostic.code.name
    after = bench.simulated.timeline.seconds - injector.struck_at
    injector.remove()
    bench.simulated.power_off()
    bench.simulated.power_on()
    bench.simulated.run(0.2)
    journal = Journal(bench.storage)
    if journal.unfinished:
        bench.resume()
    else:
        bench.apply()
    ids = [bench.devices()[node].node_id for node in NODES]
    doubles = bench.watch.doubles if fault.kind != "duplicate_id" else []
    as_planned = ids == [1, 2, 3, 4] and not bench.plan().steps and not doubles
    return Reaction(code, after, as_planned)


Reactions = dict[str, Reaction]
"""By phase."""


def reactions(case: Case) -> Reactions:
    return {phase: react(case.fault, frame) for phase, frame in PHASES.items()}


def row(case: Case, by_phase: Reactions) -> str:
    cells = [str(by_phase[phase]) for phase in PHASES]
    return f"| {case.name} | {' | '.join(cells)} |"


def table() -> Iterator[str]:
    yield f"| fault | {' | '.join(PHASES)} |"
    yield f"| --- |{' --- |' * len(PHASES)}"
    for case in CASES:
        yield row(case, reactions(case))


def main() -> int:
    head, _, tail = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    lines = "".join(f"{line}\n" for line in table())
    PAGE.write_text(head + BEGIN + lines + END + tail.partition(END)[2], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
