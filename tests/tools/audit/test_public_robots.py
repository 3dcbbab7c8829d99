"""Contradictions of public robots, in files of our own with their values and their structure.

Each folder of ``robots`` with a file expected.yaml contains the findings (code, file, line) and
the replacements that make the robot consistent.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import yaml

from thorvaldc.tools.audit.audit_run import audit

ROBOTS = Path(__file__).parent / "robots"
FOLDERS = sorted(path.parent for path in ROBOTS.glob("*/expected.yaml"))


@pytest.mark.usefixtures("quick_xacro")
@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_public_robot(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(folder, tmp_path / "robot")
    monkeypatch.chdir(tmp_path / "robot")
    expected = yaml.safe_load(Path("expected.yaml").read_text(encoding="utf-8"))
    report = audit(["."]).report
    found = [(d.code.name, d.span.file, d.span.line) for d in report if d.span is not None]
    assert sorted(found) == sorted(map(tuple, expected["findings"])), list(report)
    for name, old, new in expected["fixes"]:
        text = Path(name).read_text(encoding="utf-8")
        assert old in text, (name, old)
        Path(name).write_text(text.replace(old, new, 1), encoding="utf-8")
    assert list(audit(["."]).report) == []


def test_there_are_six_public_robots() -> None:
    assert len(FOLDERS) >= 6
