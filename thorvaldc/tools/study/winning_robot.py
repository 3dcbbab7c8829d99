"""Writes the robot file of the best design of a study, with its provenance."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc import __version__
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.diagnostics.atomic_file import write_file
from thorvaldc.tools.study.design_evaluation import robot_text
from thorvaldc.tools.study.replaced_values import value_text
from thorvaldc.tools.study.sample_points import Design
from thorvaldc.tools.study.study_definition import Objective
from thorvaldc.tools.study.study_execution import StudyRun
from thorvaldc.tools.study.study_table import objective_value

_HEADER = "# Design "


@dataclass(frozen=True, slots=True)
class Winner:
    """The best design of a study.

    - ``number``: number of the design, from 1 on.
    - ``result``: its result, as in the journal.
    """

    number: int
    design: Design
    result: dict[str, Any]


def find_winner(
    run: StudyRun, results: dict[str, dict[str, Any]], objective: Objective
) -> Winner | None:
    """Returns the best design for an objective, or ``None`` if no design has the status ``ok``.

    Of equal designs, the one with the smallest number is the best.
    """
    best: tuple[float, Winner] | None = None
    for number, (key, design) in enumerate(zip(run.keys, run.designs, strict=True), 1):
        result = results.get(key)
        value = None if result is None else objective_value(objective, result)
        if result is None or result["status"] != "ok" or value is None:
            continue
        rank = objective.rank(value)
        if best is None or rank < best[0]:
            best = rank, Winner(number, design, result)
    return None if best is None else best[1]


def winner_text(run: StudyRun, winner: Winner, by: Objective, study_file: str) -> str:
    """Returns the text of the robot file of a design.

    The text is that of the study's robot file with the values of the design.  A comment at the
    start states the study, the values, the numbers and the version.
    """
    study = run.inputs.study
    lines = [
        f"{_HEADER}{winner.number} of the study {study.name} ({study_file}), best by {by.name};"
        f" thorvaldc {__version__}"
    ]
    for variable, value in zip(study.variables, winner.design, strict=True):
        lines.append(f"#   {variable.name}: {value_text(value)}")
    facts = winner.result["facts"]
    lines += [f"#   {c.name}: {facts[c.fact]:.6g}" for c in study.constraints]
    for objective in study.objectives:
        value = objective_value(objective, winner.result)
        goal = "maximise" if objective.maximise else "minimise"
        lines.append(f"#   {objective.name}: {value:.6g} ({goal})")
    lines.append("# Constraints and objectives are in SI units, angles in rad.")
    return "\n".join(lines) + "\n" + robot_text(run.inputs, winner.design)


def write_winner(path: Path, text: str, run: StudyRun) -> Compilation:
    """Writes the robot file, and returns its compilation at its place.

    A file with errors, for example because a relative path of it does not exist there, is not
    written.  Raises ``FileExistsError`` if ``path`` is a file that no study has written.
    """
    if path.exists() and not path.read_text("utf-8", "replace").startswith(_HEADER):
        raise FileExistsError(f"will not overwrite {path}, which no study has written")
    with unsaved_texts({os.path.realpath(path): text.encode()}):
        compilation = compile_file(path, library=run.inputs.library, trust=run.inputs.trust)
    if not compilation.report.has_errors:
        write_file(path, text)
    return compilation
