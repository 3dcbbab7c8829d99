"""The tutorial works for somebody who follows it in an empty folder with the installed package."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.tutorial import (
    FOLDER,
    PAGES,
    Reader,
    blocks_of,
    mismatch,
    picture_difference,
    pictures_in,
    programs_in,
    ros_programs_in,
)
from tests.outside_tools import require
from tests.ros.environments import variables

ROOT = Path(__file__).resolve().parents[2]
pytestmark = [pytest.mark.xdist_group("tutorial"), pytest.mark.timeout(900)]


def page(name: str) -> str:
    return (FOLDER / f"{name}.md").read_text(encoding="utf-8")


def install_command() -> str:
    return re.findall(r"^\$ (pip install .*)$", page("tutorial/README"), re.M)[0]


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Reader:
    """A reader with the package of the wheel, and with no settings of this computer's user."""
    require("OpenGL")  # of the first page, on whose files the others go on
    home = tmp_path_factory.mktemp("home")
    for name in ("scout", "run"):
        (home / name).mkdir()
    (home / "thorvaldc").symlink_to(ROOT)  # where the pages say that the checkout is
    environment = {
        **{name: value for name, value in variables(home).items() if name.startswith("ROS_")},
        "HOME": str(home),
        "PATH": f"{programs_in(home / 'bin')}{os.pathsep}/usr/bin{os.pathsep}/bin",
        "PYTHONPATH": str(home / "site"),
        "XDG_RUNTIME_DIR": str(home / "run"),
        "LANG": "C.UTF-8",
        "BROWSER": "true",  # the program `true`: no browser opens
    }
    if "MUJOCO_GL" in os.environ:
        environment["MUJOCO_GL"] = os.environ["MUJOCO_GL"]
    options = {"TARGET": "site", "NO_DEPS": "1", "NO_INDEX": "1", "NO_BUILD_ISOLATION": "0"}
    done = subprocess.run(
        ["sh", "-c", install_command()],
        cwd=home,
        env={**environment, **{f"PIP_{name}": value for name, value in options.items()}},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    # On a busy computer, matplotlib prints that it looks for fonts; the pages do not show that.
    fonts = [sys.executable, "-c", "import matplotlib.font_manager"]
    subprocess.run(fonts, env=environment, check=True, capture_output=True)
    return Reader(home / "scout", environment)


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_every_command_of_the_page_prints_what_it_shows(name: str, reader: Reader) -> None:
    if name.endswith("ros2"):
        ros_programs_in(reader.folder.parent / "bin")
    differences = reader.follow_in_real_time(page(name))
    assert not differences, "\n\n".join(differences)
    for picture in pictures_in(page(name)):
        stored = FOLDER / "tutorial/pictures" / picture
        if (reader.folder / picture).exists():  # not the pictures of other pages
            assert picture_difference(stored, reader.folder / picture) < 0.02, picture


@pytest.mark.parametrize("name", PAGES)
def test_the_page_shows_pictures_that_its_commands_make(name: str) -> None:
    text = page(name)
    for picture in FOLDER.glob("tutorial/pictures/*.png"):
        assert picture.stat().st_size < 100_000, picture.name
        if f"pictures/{picture.name}" in text:
            blocks = [block for block in blocks_of(text) if block.language == "console"]
            sources = [f"{block.text} {block.value('screenshot')}" for block in blocks]
            assert any(picture.name in source for source in sources), picture.name


def test_another_picture_is_noticed() -> None:
    pictures = [FOLDER / f"tutorial/pictures/{name}.png" for name in ("first", "tank", "run")]
    assert picture_difference(pictures[0], pictures[0]) == 0.0
    assert picture_difference(pictures[0], pictures[1]) > 0.03  # without and with the tank
    assert picture_difference(pictures[0], pictures[2]) > 0.1


def test_a_difference_is_noticed() -> None:
    assert mismatch("a\nb", "a\nb") is None
    assert mismatch("a\n...\nd", "a\nb\nc\nd\n") is None
    assert mismatch("a\nc", "a\nb") == "c"
    assert mismatch("a\n...\ne", "a\nb") == "e"
    assert mismatch("a", "a\nb") == "nothing, but it printed: b"
    assert mismatch("1.0 m  50x", "1.1 m  20x", tolerance=0.2) is None
    assert mismatch("0.6 a1b2c3d4", "0.6649641873278237 12345678", tolerance=0.2) is None
    assert mismatch("a ...", "a b") is None
    assert mismatch("1.0 m", "1.5 m", tolerance=0.2) == "1.0 m"
    assert mismatch("1.0 m", "1.0 kg", tolerance=0.2) == "1.0 m"
    assert mismatch("1-2", "12", tolerance=0.2) == "1-2"


def test_a_command_that_does_not_end_is_a_difference_of_its_page_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.docs.tutorial.LONGEST_COMMAND_S", 0.2)
    (tmp_path / "scout").mkdir()
    reader = Reader(tmp_path / "scout", {"PATH": os.environ["PATH"]})
    [difference] = reader.follow_in_real_time("```console\n$ sleep 60\n```\n")
    assert difference == "sleep 60: exit status 1\n(did not end in 0.2 s)\n"
    assert [path.name for path in tmp_path.iterdir()] == ["scout"]
    assert not reader.follow_in_real_time("```console\n$ echo next\nnext\n```\n")
