"""The progress of a study: a bar and the front so far, on a terminal only."""

from __future__ import annotations

import re
import signal
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, Command
from tests.cli.person import Person
from tests.cli.test_terminal import on_terminal
from tests.slow import mostly_slow

STUDY = """\
thorvaldc: 1
study: track
robot: good.yaml
variables:
  track: {paths: [modules.frame.params.width], min: 0.8 m, max: 1.2 m}
  length: {paths: [modules.frame.params.length], min: 0.9 m, max: 1.2 m}
objectives:
  light: {fact: mass, goal: minimise}
  stable: {fact: stability.angles.left, goal: maximise}
samples: {method: grid, number: 3}
"""
TITLE = "stable (rad) against light (kg)"
COLOR = re.compile(r"\x1b\[3\dm")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "good.yaml").write_text(GOOD)
    (tmp_path / "study.yaml").write_text(STUDY)
    return tmp_path


def run(folder: Path, **environment: str) -> str:
    size = {"COLUMNS": "80", "LINES": "24"}
    arguments = ("study", "run", "study.yaml", "-j", "1")
    status, output = on_terminal(folder, *arguments, **size | environment)
    assert status == 0
    assert "9 designs: 9 ok" in output
    return output


def test_the_front_is_plotted_on_a_terminal(folder: Path) -> None:
    output = run(folder)
    assert TITLE in output
    assert COLOR.search(output)
    frames = [line for line in output.splitlines() if "│" in line]
    assert any("*" in COLOR.sub("", line) for line in frames)
    # The plot is erased before the table.
    assert output.rindex("\x1b[2K") < output.index("9 designs: 9 ok")
    assert output.count("\x1b[?25l") == output.count("\x1b[?25h") == 1  # the cursor
    # Finished designs have a plot at once.
    assert TITLE in run(folder)


@pytest.mark.slow
def test_the_plot_has_no_colours_if_the_user_wants_none(folder: Path) -> None:
    output = run(folder, NO_COLOR="1")
    assert TITLE in output
    assert not COLOR.search(output)


def test_a_small_terminal_has_the_bar_alone(folder: Path) -> None:
    assert TITLE not in run(folder, LINES="12")
    (folder / "study.yaml").write_text(re.sub(r"  stable: .*\n", "", STUDY))
    output = run(folder)
    assert "of 9 designs" in output
    assert "│" not in output


def test_a_pipe_has_neither_bar_nor_plot(
    thorvaldc: Command, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = thorvaldc("study", "run", "study.yaml", "-j", "1")
    assert result.err == "wrote study/track/designs.parquet\n"
    assert "\x1b" not in result.out


@pytest.mark.parametrize(
    "module",
    mostly_slow(["raise ImportError", "def plot_to_string(*a, **k): raise OverflowError"]),
)
def test_without_a_plot_there_is_the_bar(
    folder: Path, monkeypatch: pytest.MonkeyPatch, module: str
) -> None:
    (folder / "uniplot.py").write_text(f"{module}\n")
    monkeypatch.setattr(sys, "path", [str(folder), *sys.path])
    output = run(folder)
    assert TITLE not in output
    assert "of 9 designs" in output


def test_the_terminal_is_as_before_after_an_interruption(folder: Path) -> None:
    (folder / "study.yaml").write_text(STUDY.replace("number: 3", "number: 40"))
    person = Person(folder, "study", "run", "study.yaml", "-j", "1")
    try:
        person.resize(80, 24)
        person.until("against light")
        person.process.send_signal(signal.SIGINT)
        assert person.end() == 130  # the cursor is visible again
        assert "│" not in person.shown.rpartition("\x1b[?25h")[2]
        assert "the same command continues" in person.shown
    finally:
        person.close()
