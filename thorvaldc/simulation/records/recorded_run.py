"""The recorded samples of one robot, and the diagnostic for a robot without samples."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.simulation.control_loop import Sample


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """The recorded samples of one robot, and the joint commands of each sample.

    ``groups`` has the names of the recorded groups of values.  All values of a group that was not
    recorded are nan or ``None``.
    """

    groups: tuple[str, ...]
    samples: list[Sample]
    commands: list[JointCommands | None]


def report_missing_robot(name: str, recorded: Iterable[str], display: str, report: Report) -> None:
    """Reports that a record has no robot with the name ``name``.

    ``recorded`` are the names of the recorded robots.  ``display`` is the name of the record for
    the diagnostic.
    """
    known = sorted(recorded)
    names = ", ".join(known[:6]) + (" .." if len(known) > 6 else "")
    report.add(
        "record-robot",
        f"`{display}` has no robot {name}",
        Span(display),
        hint=did_you_mean(name, known, f"it has {names}" if known else "it has no robots"),
    )
