"""Each fault of a bus in each phase of a flash: how it ends, how soon, and what a resume does.

``python -m tests.commissioning.fault_matrix`` writes the table into docs/commissioning.md.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from tests.commissioning.bench import NODES, SWAPPED, Bench, four_drives
from tests.runtime.can_base.fault_matrix import CASES, Case
from thorvaldc.commissioning.journal import Journal
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.bus_faults import BusFault, BusFaults
from thorvaldc.simulation.bus.fault_injection import FaultInjector

PAGE = Path(__file__).parents[2] / "docs" / "commissioning.md"
BEGIN, END = (
    "<!-- made by tests/runtime/commissioning/fault_matrix.py -->\n",
    "<!-- end -->\n",
)
PHASES = {"scanning": 160, "addresses": 390, "values": 450}
"""In the middle of which frame of the flash it happens."""
LONGEST = 7.0
"""s that it takes at most to stop: 5 s for a node to start, and what is asked after that."""


class Striking(FaultInjector):
    """FaultInjector that end when they are told to."""

    mend: Callable[[], None]
    struck = 0.0

    def strike(self, fault: BusFault) -> None:
        self.struck = self.simulated.timeline.seconds
        self.mend = self._begin(fault)


class Reaction(NamedTuple):
    """The name of the fault that the flash ends with, empty where it goes on; s until then.

    ``resumed``: with the cause gone and the power off and on, the bus came to what was planned.
    """

    fault: str
    after: float
    resumed: bool

    def __str__(self) -> str:
        return f"`{self.fault}`, {1000 * self.after:.0f} ms" if self.fault else "goes on"


def react(fault: BusFault, frame: int) -> Reaction:
    if fault.kind == "duplicate_id":
        fault = dataclasses.replace(fault, id=1 if frame == PHASES["scanning"] else 2)
    bench = Bench(four_drives(), SWAPPED)
    faults = Striking(bench.simulated, BusFaults(()))
    bench.wire.at_frame(bench.wire.frames + frame, lambda: faults.strike(fault))
    name = ""
    try:
        bench.apply()
    except DiagnosticError as stopped:
        name = stopped.diagnostic.code.name
    after = bench.simulated.timeline.seconds - faults.struck
    faults.mend()
    bench.simulated.power_off()
    bench.simulated.power_on()
    bench.simulated.run(0.2)
    journal = Journal(bench.store)
    if journal.unfinished:
        bench.resume()
    else:
        bench.apply()
    ids = [bench.devices()[node].node_id for node in NODES]
    doubles = bench.watch.doubles if fault.kind != "duplicate_id" else []
    whole = ids == [1, 2, 3, 4] and not bench.plan().steps and not doubles
    return Reaction(name, after, whole)


Found = dict[str, Reaction]
"""By phase."""


def found(case: Case) -> Found:
    return {phase: react(case.fault, frame) for phase, frame in PHASES.items()}


def row(case: Case, reactions: Found) -> str:
    cells = [str(reactions[phase]) for phase in PHASES]
    return f"| {case.name} | {' | '.join(cells)} |"


def table() -> Iterator[str]:
    yield f"| fault | {' | '.join(PHASES)} |"
    yield f"| --- |{' --- |' * len(PHASES)}"
    for case in CASES:
        yield row(case, found(case))


def main() -> int:
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    lines = "".join(f"{line}\n" for line in table())
    PAGE.write_text(before + BEGIN + lines + END + rest.partition(END)[2], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
