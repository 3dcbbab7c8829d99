"""Without optional libraries: errors in arguments and files come first, then the missing library,
before any work."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.cli.conftest import Command
from thorvaldc.simulation.pictures import render

PACKAGES = ("PIL", "aiohttp", "evdev", "imageio_ffmpeg", "matplotlib", "optuna", "plotly", "pygls")
MODULES = ("thorvaldc.tools.preview.preview_server", "thorvaldc.tools.language_server.server")
"""Modules that import such a package when they are imported."""
STUDY = """\
thorvaldc: 1
study: small
robot: good.yaml
variables: {height: {paths: [modules.frame.params.height], min: 0.6 m, max: 0.7 m}}
objectives: {light: {fact: mass, goal: minimise}}
samples: {method: random, number: 2, seed: 1}
"""


@pytest.fixture
def bare(thorvaldc: Command, monkeypatch: pytest.MonkeyPatch) -> Command:
    """The command without optional packages, OpenGL and programs."""
    parts = [name for name in sys.modules if name.partition(".")[0] in PACKAGES]
    for package in PACKAGES:
        monkeypatch.setitem(sys.modules, package, None)
    for module in (*MODULES, "mujoco", *(name for name in parts if "." in name)):
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(render, "_works", lambda name: False)
    return thorvaldc


@pytest.mark.parametrize(
    "words",
    [
        *(("sim", "no.yaml", *option) for option in (("--video", "v.gif"), ("--plot", "p.png"))),
        ("scenario", "no.yaml", "--video", "v.mp4"),
        ("render", "no.yaml"),
        ("view", "no.yaml"),
        ("preview", "no.yaml"),
        ("study", "run", "no.yaml"),
        ("study", "show", "no.yaml", "--html", "r.html"),
        ("teleop", "no.yaml", "--joystick", "auto"),
        ("usd", "no.yaml", "-o", "r.usda"),
    ],
    ids=" ".join,
)
def test_a_missing_file_is_reported_before_a_missing_library(
    bare: Command, words: tuple[str, ...]
) -> None:
    status, out, err = bare(*words)
    assert status == 1, err
    assert "does not exist" in out + err
    assert "not installed" not in err


@pytest.mark.parametrize(
    "words",
    [
        ("sim", "good.yaml", "--video", "v.avi"),
        ("render", "good.yaml", "--size", "big"),
        ("render", "good.yaml", "--view", "behind"),
        ("render", "good.yaml", "-o", "a.jpg"),
        ("preview", "good.yaml", "--library", "nowhere"),
        ("study", "show", "study.yaml", "--html", "r.txt"),
        ("teleop", "good.yaml", "--joystick", "auto", "--speed", "none"),
    ],
    ids=" ".join,
)
def test_wrong_arguments_are_reported_before_a_missing_library(
    bare: Command, words: tuple[str, ...]
) -> None:
    status, _, err = bare(*words)
    assert status == 2, err
    assert "not installed" not in err


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("sim", "good.yaml", "--video", "v.gif"), "a picture needs Pillow"),
        (("sim", "good.yaml", "--video", "v.mp4"), "an MP4 needs the encoder ffmpeg"),
        (("sim", "good.yaml", "--plot", "p.png"), "a plot needs matplotlib"),
        (("render", "good.yaml"), "a picture needs Pillow"),
        (("preview", "good.yaml"), "the preview needs aiohttp"),
        (("study", "run", "study.yaml"), "this study needs optuna"),
        (("study", "show", "study.yaml", "--html", "r.html"), "this study needs plotly"),
        (("teleop", "good.yaml", "--joystick", "auto"), "a joystick needs the package evdev"),
        (("lsp",), "the language server needs pygls"),
    ],
    ids=lambda part: " ".join(part) if isinstance(part, tuple) else "",
)
def test_a_missing_library_is_reported_before_the_work(
    bare: Command, words: tuple[str, ...], expected: str
) -> None:
    Path("study.yaml").write_text(STUDY)
    status, out, err = bare(*words)
    assert (status, out) == (3, "")
    assert err.startswith(f"error: {expected}")
    assert err.count("\n") == 1
    assert not [path for path in Path().iterdir() if path.suffix != ".yaml"]
