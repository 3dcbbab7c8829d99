"""Loads a robot or a fleet from a file, or raises all errors of the file as one exception.

`compile_file` returns the errors of a file as data.  The functions of this module are for programs
that need the model and cannot continue without it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.diagnostics import Diagnostic, Report, Severity, Span
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.diagnostics.renderers import render_text
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.model_json import is_model_file, load_model

MODEL_FILE_NAME = "model.json"


class CompileError(Exception):
    """Raised if a robot, fleet or scenario file has errors.

    The text of the exception is the report that ``thorvaldc check`` prints: every error and
    warning with its file, line, column, excerpt and hint.

    Attributes
    ----------
    diagnostics : the errors and warnings as data, in the order of file and line.
    """

    def __init__(self, text: str, diagnostics: Sequence[Diagnostic] = ()) -> None:
        super().__init__(text, tuple(diagnostics))  # all arguments: the exception can be pickled
        self.diagnostics: tuple[Diagnostic, ...] = tuple(diagnostics)

    def __str__(self) -> str:
        return str(self.args[0])

    @property
    def errors(self) -> tuple[Diagnostic, ...]:
        """The diagnostics that are errors."""
        return tuple(d for d in self.diagnostics if d.severity is Severity.ERROR)


def load(path: Path | str, *, library: Sequence[Path | str] = (), trust: bool = False) -> Robot:
    """Returns the robot of a robot.yaml, or of the ``model.json`` of a build.

    All values of the robot are in SI units, and poses are in the frames that the class names; a
    robot is immutable.  The returned robot has no errors; ``compile(path).report`` has its
    warnings.

    Parameters
    ----------
    path : path of the file.
    library : folders with module types, beside the project's library and the folders that the
        file names.
    trust : whether xacro files are expanded without restrictions, as programs that the caller
        trusts.

    Raises ``CompileError`` with all errors of the file.  A file with a fleet or a scenario is an
    error too: ``load_fleet`` reads it.

    >>> import thorvaldc
    >>> robot = thorvaldc.load("examples/4wd4ws_wide/robot.yaml")
    >>> robot
    <Robot thorvald_4wd4ws_wide: 4 wheels, 190.6 kg>
    >>> robot.wheels[0].radius
    0.2
    """
    model = _load(path, library, trust)
    if not isinstance(model, Robot):
        raise _other_model(path, "a fleet", "a robot", "thorvaldc.load_fleet")
    return model


def load_fleet(
    path: Path | str, *, library: Sequence[Path | str] = (), trust: bool = False
) -> Fleet:
    """Returns the fleet of a fleet or scenario file, or of the ``model.json`` of a build.

    The placements of the fleet have the robots with their poses in the scene (m, rad).

    Parameters
    ----------
    path : path of the file.
    library : folders with module types, beside the project's library and the folders that the
        files name.
    trust : whether xacro files are expanded without restrictions.

    Raises ``CompileError`` with all errors of the file and of its robots.  A file with a single
    robot is an error too: ``load`` reads it.

    >>> import thorvaldc
    >>> fleet = thorvaldc.load_fleet("examples/fleet_of_four/fleet.yaml")
    >>> fleet
    <Fleet fleet_of_four: 4 robots>
    >>> [placement.name for placement in fleet.placements]
    ['tall', 'slim', 'wide', 'six']
    """
    model = _load(path, library, trust)
    if not isinstance(model, Fleet):
        raise _other_model(path, "a robot", "a fleet", "thorvaldc.load")
    return model


def _load(path: Path | str, library: Sequence[Path | str], trust: bool) -> Robot | Fleet:
    path = Path(path)
    if is_model_file(path) or path.name == MODEL_FILE_NAME:
        try:
            return load_model(path)
        except DiagnosticError as error:
            raise _compile_error([error.diagnostic], {}) from error
    compilation = compile_file(path, library=library, trust=trust)
    if compilation.model is None:
        raise _compile_error(compilation.report, compilation.sources)
    return compilation.model


def _compile_error(
    diagnostics: Sequence[Diagnostic] | Report, sources: Mapping[str, Path]
) -> CompileError:
    report = Report()
    report.extend(diagnostics)
    count = len(report.errors)
    text = render_text(report, sources).rstrip()
    return CompileError(f"{count} error{'' if count == 1 else 's'}\n{text}", report.sorted())


def _other_model(path: Path | str, content: str, expected: str, function: str) -> CompileError:
    report = Report()
    report.add(
        "other-document",
        f"expected {expected}, got {content}",
        Span(os.fspath(path)),
        hint=f"{function}() reads this file",
    )
    return _compile_error(report, {})
