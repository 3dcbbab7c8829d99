"""Compares the nodes on a bus with the robot file.

The verification reads values from the nodes.  The verification writes no values and resets no
nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from thorvaldc.can.canopen import HEARTBEAT
from thorvaldc.commissioning.bus_configuration import BusConfiguration, differing_values
from thorvaldc.commissioning.bus_master import BusMaster
from thorvaldc.commissioning.scan_result import OK, ScanResult
from thorvaldc.commissioning.scanner import Scanner
from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.model import Bus
from thorvaldc.model.bus import key_text
from thorvaldc.model.sums import float_sum

LONGEST_LISTENING = 3.0
"""Longest listening time (s)."""
PERIODS = 5
"""Listening time in periods of the slowest frame."""
PERIOD_TOLERANCE = 0.1
"""Largest accepted deviation of a mean period, as a share of the expected period."""
LEAST_TOLERANCE = 2e-3
"""Smallest tolerance (s) for the deviation of a mean period."""


@dataclass(frozen=True, slots=True)
class Check:
    """Comparison of an expected value with the value that was read from the CAN bus.

    - ``node``: name of the node, empty for a check of the whole bus;
    - ``what``: name of the checked quantity;
    - ``expected``: expected value as text;
    - ``actual``: value on the bus as text;
    - ``passed``: ``True`` if the value on the bus is accepted.
    """

    node: str
    what: str
    expected: str
    actual: str
    passed: bool

    def as_json(self) -> dict[str, Any]:
        return {
            "node": self.node,
            "what": self.what,
            "wanted": self.expected,
            "found": self.actual,
            "passed": self.passed,
        }


@dataclass(frozen=True, slots=True)
class Verification:
    """Result of the verification of a CAN bus.

    - ``scan``: result of the scan;
    - ``checks``: all comparisons;
    - ``not_seen``: names of periodic frames that were not received, such as PDOs of a drive before
      NMT start;
    - ``load``: bus load, 0 to 1.
    """

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
    configuration: BusConfiguration,
    bus: Bus,
    progress: Callable[[str, int, int], None] | None = None,
) -> Verification:
    """Compares the identities and object values of the nodes, the periods of the CAN frames and the
    bus load with the robot file.

    Raises the same ``DiagnosticError`` as ``Scanner.active``.
    """
    scan = Scanner(master, configuration, progress).active(values=True, texts=False)
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
    for node in configuration.nodes:
        read = scan.values.get(node.name)
        if read is None:
            continue
        differing = differing_values(node.values, read)
        for value in differing:
            actual = read.get(value.key)
            actual_text = "unreadable" if actual is None else str(actual)
            label = f"{value.label} {value.name}"
            checks.append(Check(node.name, label, str(value.value), actual_text, False))
        if not differing and node.values:
            count = str(len(node.values))
            checks.append(Check(node.name, "values", count, count, True))
    frame_checks, not_seen, load = _check_frames(master, configuration, bus)
    return Verification(scan, (*checks, *frame_checks), not_seen, load)


def _check_frames(
    master: BusMaster, configuration: BusConfiguration, bus: Bus
) -> tuple[list[Check], tuple[str, ...], float]:
    """Receives CAN frames, and checks the periods of the CAN frames and the bus load.

    Returns the checks, the names of the periodic frames that were not received, and the bus load
    (0 to 1).
    """
    slowest = max(
        (period for node in configuration.nodes for _, period in node.seen_by), default=0.1
    )
    seconds = min(max(PERIODS * slowest, 1.0), LONGEST_LISTENING)
    master.forget()
    master.bits = 0
    master.listen(seconds)
    load = master.bits / (bus.bitrate * seconds)
    checks: list[Check] = []
    not_seen: list[str] = []
    names = {frame.key: frame.name for frame in bus.frames}
    for node in configuration.nodes:
        for identifier, period in node.seen_by:
            times = master.received.get(identifier, [])
            name = names.get(identifier, key_text(identifier))
            heartbeat = identifier == HEARTBEAT + node.id and node.heartbeat is not None
            if not times and not heartbeat:
                not_seen.append(name)
                continue
            if len(times) < 2:
                actual = "no frame" if not times else "one frame"
                if period < seconds / 2:
                    checks.append(Check(node.name, f"period of {name}", _ms(period), actual, False))
                continue
            intervals = [later - earlier for earlier, later in pairwise(times)]
            mean = float_sum(intervals) / len(intervals)
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
    unknown = sorted(i for i in master.received if i not in names)
    if unknown:
        identifiers = ", ".join(map(key_text, unknown))
        checks.append(Check("", "frames that are not in the file", "none", identifiers, False))
    checks.append(
        Check(
            "", "load", f"at most {100 * bus.load:.1f} %", f"{100 * load:.1f} %", load <= bus.load
        )
    )
    return checks, tuple(not_seen), load


def _ms(seconds: float) -> str:
    return f"{1000 * seconds:.4g} ms"


def verification_table(verification: Verification, width: int | None = None) -> str:
    """Returns a text table with one row for each check of a verification.

    The columns of the verification table are the result, the node, the checked quantity, the
    expected value, and the value on the bus.
    ``width``: number of columns of the terminal, or ``None`` for one line per check.
    """
    rows = [("", "node", "what", "wanted", "found")]
    rows += [
        (
            "ok" if check.passed else "DIFFERS",
            check.node or "bus",
            check.what,
            check.expected,
            check.actual,
        )
        for check in verification.checks
    ]
    return text_table(rows, width)
