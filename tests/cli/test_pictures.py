"""Pictures on the command line: output files, and errors before the work."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.cli.conftest import Command


def test_plot(thorvaldc: Command) -> None:
    result = thorvaldc(
        "sim", "good.yaml", "--ideal", "--duration", "1", "--twist", "1,0,0", "--plot", "a.png"
    )
    assert (result.status, result.err) == (0, "a.png\n")
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("path", "status", "expected"),
    [
        ("a.jpg", 2, "'a.jpg' does not end in .png or .svg or .pdf"),
        ("nowhere/a.png", 3, "cannot write nowhere/a.png: No such file or directory"),
        ("folder.png", 3, "cannot write folder.png: it is a folder"),
    ],
)
def test_a_plot_that_cannot_be_written_is_reported_before_the_run(
    thorvaldc: Command, path: str, status: int, expected: str
) -> None:
    Path("folder.png").mkdir()
    result = thorvaldc("sim", "bad.yaml", "--plot", path)
    assert result.status == status
    assert expected in result.err
    assert "error[" not in result.err  # the robot was not even looked at


def test_without_matplotlib(thorvaldc: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = thorvaldc("sim", "good.yaml", "--plot", "a.png")
    assert result.status == 3
    assert result.err.startswith("error: a plot needs matplotlib, which is not installed")


@pytest.mark.parametrize(
    ("arguments", "status", "expected"),
    [
        (["render", "good.yaml", "--size", "big"], 2, "'big' is not a size such as 1000x700"),
        (["render", "good.yaml", "--view", "behind"], 2, "'behind' is not corner, front"),
        (["render", "good.yaml", "-o", "a.jpg"], 2, "does not end in .png"),
        (["render", "good.yaml", "-o", "nowhere/a.png"], 3, "cannot write nowhere/a.png"),
        (["render", "bad.yaml", "-o", "a.png"], 1, "unknown-key"),
        (["sim", "good.yaml", "--video", "a.avi"], 2, "does not end in .mp4 or .gif"),
        (["sim", "good.yaml", "--ideal", "--video", "a.gif"], 2, "leave out --ideal"),
    ],
)
def test_wrong_options(
    thorvaldc: Command, arguments: list[str], status: int, expected: str
) -> None:
    result = thorvaldc(*arguments)
    assert result.status == status
    assert expected in result.err
    assert not Path("a.png").exists()


def test_without_graphics(thorvaldc: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    from thorvaldc.simulation.pictures import render

    monkeypatch.delitem(sys.modules, "mujoco", raising=False)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(render, "_works", lambda name: False)
    for arguments in (["render", "good.yaml"], ["sim", "good.yaml", "--video", "a.gif"]):
        result = thorvaldc(*arguments)
        assert result.status == 3
        assert result.err.startswith("error: cannot draw without a display: neither EGL nor")


def test_view_without_a_display_writes_a_page(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    result = thorvaldc("view", "good.yaml")
    assert (result.status, result.out) == (0, "good.html\n")
    assert Path("good.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert thorvaldc("view", "bad.yaml").status == 1
    assert thorvaldc("view", "good.yaml", "-o", "a.txt").status == 2
    assert thorvaldc("view", "good.yaml", "-o", "nowhere/a.html").status == 3


def test_view_with_a_display_opens_the_viewer(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer = pytest.importorskip("mujoco.viewer")
    opened: list[int] = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(viewer, "launch", lambda model, data: opened.append(model.nmesh))
    assert thorvaldc("view", "good.yaml").status == 0
    assert len(opened) == 1
    assert opened[0] > 0  # with what is seen
    assert not Path("good.html").exists()
    assert thorvaldc("view", "good.yaml", "--html").out == "good.html\n"
    assert len(opened) == 1

    def fail(model: object, data: object) -> None:
        raise RuntimeError("could not create window")

    monkeypatch.setattr(viewer, "launch", fail)
    result = thorvaldc("view", "good.yaml")
    assert result.status == 3
    assert "could not create window; try --html" in result.err
