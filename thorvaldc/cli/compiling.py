"""Compiles a robot or fleet file for a command and prints its diagnostics on stderr."""

from __future__ import annotations

from collections.abc import Sequence

from thorvaldc.cli.diagnostic_output import show_report
from thorvaldc.cli.options import library_folders
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.compiler.scenario.variations import Change


def compile_and_show(
    file: str,
    library: Sequence[str],
    robot: str | None = None,
    changes: Sequence[Change] = (),
    *,
    trust: bool,
) -> Compilation:
    """Compiles a robot or fleet file and prints its diagnostics on stderr.

    - ``robot``: path of a robot file that replaces the robot of a scenario.
    - ``changes``: values that replace values of a scenario.
    - ``trust``: whether xacro files are expanded without restrictions.
    """
    compilation = compile_file(
        file, library=library_folders(library), robot=robot, changes=changes, trust=trust
    )
    show_report(compilation.report, compilation.sources)
    return compilation
