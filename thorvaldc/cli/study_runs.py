"""What the commands ``thorvaldc study`` have in common: the study and the folder of its results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import typer

from thorvaldc.cli.compiling import compile_and_show
from thorvaldc.cli.exits import OutsideError
from thorvaldc.cli.options import library_folders
from thorvaldc.tools.study.design_evaluation import StudyInputs
from thorvaldc.tools.study.sample_points import MissingPackageError
from thorvaldc.tools.study.study_execution import StudyRun

RESULTS = Path("study")


def results_folder(name: str, output: str) -> Path:
    """Returns the folder with the results of a study: ``output``, or ``study/NAME``."""
    return Path(output) if output else RESULTS / name


def plan_study(file: str, library: Sequence[str], trust: bool) -> StudyRun | None:
    """Compiles a study file and selects its designs.

    Prints the errors of the study file and returns ``None`` if it has any.  Raises
    ``typer.BadParameter`` if the file is no study.
    """
    compilation = compile_and_show(file, library, trust=trust)
    if compilation.model is None:
        return None
    if compilation.study is None:
        raise typer.BadParameter(f"{file} is no study", param_hint="'STUDY'")
    text = compilation.study.robot.read_text(encoding="utf-8")
    inputs = StudyInputs(compilation.study, text, tuple(library_folders(library)), trust)
    try:
        return StudyRun(inputs)
    except MissingPackageError as error:
        raise OutsideError(str(error)) from None
