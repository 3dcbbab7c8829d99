"""The samples of one robot, read from a record, and the diagnostic for a robot that is missing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.simulation.control_loop import Sample


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """The samples of one robot, and the joint commands of each sample.

    Values of a group that is not in ``groups`` are nan, or ``None``.
    """

    groups: tuple[str, ...]
    samples: list[Sample]
    commands: list[JointCommands | None]


def report_missing_robot(name: str, recorded: Iterable[str], display: str, report: Report) -> None:
    """Reports that the record ``display``, with the robots ``recorded``, has no robot ``name``."""
    known = sorted(recorded)
    names = ", ".join(known[:6]) + (" .." if len(known) > 6 else "")
    report.add(
        "record-robot",
        f"`{display}` has no robot {name}",
        Span(display),
        hint=did_you_mean(name, known, f"it has {names}" if known else "it has no robots"),
    )
