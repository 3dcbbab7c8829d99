"""The report of the first motion of a robot, which ``thorvaldc can commission`` writes.

The report is a JSON file beside the robot file.  docs/commissioning.md describes its fields.  A run
can demand it (``thorvaldc run --commissioned``): the report must be complete, without a finding,
and of the same model.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

from thorvaldc.commissioning.commission_page import page_of
from thorvaldc.diagnostics import DiagnosticError, Span
from thorvaldc.diagnostics.files import read_bounded, read_json, write_file
from thorvaldc.model import Robot
from thorvaldc.model.element import Element
from thorvaldc.model.model_json import is_model_file

FORMAT, VERSION = "thorvaldc-commission", 1
MAX_BYTES = 4_000_000
SUFFIX = ".commission.json"


def report_path(file: str, robot: Robot) -> Path:
    """Returns the path of the report of a robot.

    It is in the folder of a robot.yaml, and in the current folder for the model.json of a build,
    because the next build replaces the files of its folder.
    """
    path = Path(file)
    if is_model_file(path):
        return Path(f"{robot.name}{SUFFIX}")
    return path.with_name(f"{path.stem}{SUFFIX}")


def content_hash(*elements: Element) -> str:
    """Returns the hash of parts of a model, which does not depend on their lines in a file."""
    return hashlib.sha256(repr(_values(elements)).encode()).hexdigest()[:16]


def _values(value: Any) -> Any:
    """Returns the values of a part of a model, without spans and without the bytes of meshes."""
    if isinstance(value, Span | bytes):
        return None
    if isinstance(value, tuple):
        return [_values(item) for item in value]
    if dataclasses.is_dataclass(value):
        return [_values(getattr(value, field.name)) for field in dataclasses.fields(value)]
    return value


def read_report(path: Path) -> dict[str, Any]:
    """Returns the content of a report.

    Raises ``DiagnosticError`` (``not-commissioned``) if the file is missing or is no report.
    """
    try:
        report = read_json(read_bounded(path, MAX_BYTES))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise _not_commissioned(f"cannot read {path}: {reason}") from None
    if not isinstance(report, dict) or report.get("format") != FORMAT:
        raise _not_commissioned(f"{path} is no report of `can commission`")
    if report.get("version") != VERSION:
        raise _not_commissioned(f"{path} has the version {report.get('version')}, not {VERSION}")
    return report


def write_report(path: Path, robot: Robot, report: dict[str, Any]) -> None:
    """Writes a report, and its HTML page beside it.  Raises ``OSError``."""
    write_file(path, json.dumps(report, indent=1, ensure_ascii=False) + "\n")
    write_file(path.with_suffix(".html"), page_of(robot, report))


def require_commissioned(path: Path, robot: Robot) -> None:
    """Raises ``DiagnosticError`` (``not-commissioned``) unless the report says that the robot of
    this model passed all checks."""
    report = read_report(path)
    if report.get("model") != content_hash(robot):
        raise _not_commissioned(f"{path} is of another model: the file has changed since then")
    if report.get("passed") is not True:
        raise _not_commissioned(f"{path}: the robot did not pass all checks")


def _not_commissioned(reason: str) -> DiagnosticError:
    return DiagnosticError(
        "not-commissioned", reason, hint="check the first motion: thorvaldc can commission FILE"
    )
