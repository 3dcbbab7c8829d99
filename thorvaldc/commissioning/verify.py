"""Whether a bus is what the robot's file says: reads only, writes nothing, resets nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from thorvaldc.commissioning.bus_configuration import BusConfiguration
from thorvaldc.commissioning.bus_master import HEARTBEAT, BusMaster
from thorvaldc.commissioning.scan_result import OK, ScanResult
from thorvaldc.commissioning.scanner import Scanner
from thorvaldc.model.bus import Bus

LONGEST_LISTENING = 3.0
PERIODS = 5
PERIOD_TOLERANCE = 0.1
"""Share of a period that its mean may be off."""
LEAST_TOLERANCE = 2e-3
"""s"""


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was looked at.  ``node`` empty: the bus as a whole."""

    node: str
    what: str
    wanted: str
    found: str
    passed: bool

    def as_json(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class Verification:
    """``not_seen``: periodic frames that nobody sends now; drives do once they are started."""

    scan: ScanResult
    checks: tuple[Check, ...]
    not_seen: tuple[str, ...]
    load: float

    @property
    def passed(self) -> bool:
        return all(check.passed for check in self.checks)

    def as_json(self) -> dict[str, Any]:
        return {
            "passed": self.passed,
            "checks": [check.as_json() for check in self.checks],
            "not_seen": list(self.not_seen),
            "load": round(self.load, 4),
            "scan": self.scan.as_json(),
        }


def verify(
    master: BusMaster,
    target: BusConfiguration,
    bus: Bus,
    progress: Callable[[str, int, int], None] | None = None,
) -> Verification:
    """Identities, values, periods and load.  Raises ``DiagnosticError`` as scans do."""
    scan = Scanner(master, target, progress).active(values=True, texts=False)
    checks = [
        Check(
            entry.node,
            "identity and address",
            "none" if not entry.node else "ok",
            entry.verdict + (f": {entry.detail}" if entry.verdict != OK else ""),
            entry.verdict == OK,
        )
        for entry in scan.entries
    ]
    for node in target.nodes:
        read = scan.values.get(node.name)
        if read is None:
            continue
        differing = [v for v in node.values if read.get(v.place) != v.value]
        for value in differing:
            found = read.get(value.place)
            shown = "unreadable" if found is None else str(found)
            what = f"{value.shown} {value.name}"
            checks.append(Check(node.name, what, str(value.value), shown, False))
        if not differing and node.values:
            many = str(len(node.values))
            checks.append(Check(node.name, "values", many, many, True))
    more, not_seen, load = _listen(master, target, bus)
    return Verification(scan, (*checks, *more), not_seen, load)


def _listen(
    master: BusMaster, target: BusConfiguration, bus: Bus
) -> tuple[list[Check], tuple[str, ...], float]:
    """Periods and load, from what the nodes send by themselves."""
    slowest = max((p for node in target.nodes for _, p in node.seen_by), default=0.1)
    seconds = min(max(PERIODS * slowest, 1.0), LONGEST_LISTENING)
    master.forget()
    master.bits = 0
    master.listen(seconds)
    load = master.bits / (bus.bitrate * seconds)
    checks: list[Check] = []
    not_seen: list[str] = []
    names = {frame.cob_id: frame.name for frame in bus.frames}
    for node in target.nodes:
        for identifier, period in node.seen_by:
            times = master.heard.get(identifier, [])
            name = names.get(identifier, f"{identifier:#05x}")
            heartbeat = identifier == HEARTBEAT + node.id and node.heartbeat is not None
            if not times and not heartbeat:
                not_seen.append(name)
                continue
            if len(times) < 2:
                found = "silence" if not times else "one frame"
                wrong = period < seconds / 2
                if wrong:
                    checks.append(Check(node.name, f"period of {name}", _ms(period), found, False))
                continue
            gaps = [b - a for a, b in pairwise(times)]
            mean = sum(gaps) / len(gaps)
            tolerance = max(PERIOD_TOLERANCE * period, LEAST_TOLERANCE)
            checks.append(
                Check(
                    node.name,
                    f"period of {name}",
                    _ms(period),
                    _ms(mean),
                    abs(mean - period) <= tolerance,
                )
            )
    unknown = sorted(i for i in master.heard if i not in names)
    if unknown:
        shown = ", ".join(f"{i:#05x}" for i in unknown)
        checks.append(Check("", "frames of nobody in the file", "none", shown, False))
    checks.append(
        Check(
            "", "load", f"at most {100 * bus.load:.1f} %", f"{100 * load:.1f} %", load <= bus.load
        )
    )
    return checks, tuple(not_seen), load


def _ms(seconds: float) -> str:
    return f"{1000 * seconds:.4g} ms"
