"""The commands of docs/calibration.md, run as the page shows them, print what the page shows."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from thorvaldc.cli.main import run_command

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/calibration.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```\n(.*?)^```", PAGE, re.M | re.S)
NUMBER = re.compile(r"[-+]?\d+\.\d+")


def run(block: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> str:
    """Runs the commands of a block, and returns what the last one prints."""
    output = ""
    for line in block.splitlines():
        monkeypatch.setattr("sys.argv", shlex.split(line))
        assert run_command() == 0, line
        output = capsys.readouterr().out
    return output


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    pytest.importorskip("mujoco")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_the_example_gives_the_table_of_the_page(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    commands, table = BLOCKS[:2]
    printed = run(commands, capsys, monkeypatch).splitlines()
    assert len(printed) == len(table.splitlines())
    for line, expected in zip(printed, table.splitlines(), strict=True):
        # The last digits depend on the machine.
        assert line.split()[0] == expected.split()[0]
        numbers = [float(text) for text in NUMBER.findall(line)]
        assert numbers == pytest.approx([float(t) for t in NUMBER.findall(expected)], abs=0.02)
    assert "steering_offset: 0.99" in (folder / "calibration.yaml").read_text(encoding="utf-8")


def test_the_measured_distance_gives_the_scale(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    block = next(block for block in BLOCKS if "--distance" in block)
    radii = [float(text) for text in re.findall(r"([\d.]+) mm", run(block, capsys, monkeypatch))]
    # The mean of the true radii; a straight drive alone does not determine the ratios.
    assert radii == [pytest.approx(200.02, abs=0.1)] * 6
