"""`build --check` compares committed builds with the present files."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, Command


def content_of(folder: str) -> dict[str, tuple[bytes, int]]:
    return {
        str(path): (path.read_bytes(), path.stat().st_mtime_ns)
        for path in sorted(Path(folder).rglob("*"))
        if path.is_file()
    }


@pytest.fixture
def build(thorvaldc: Command) -> Path:
    assert thorvaldc("build", "good.yaml").status == 0
    return Path("build/good")


def test_a_fresh_build_is_fresh_and_nothing_is_written(thorvaldc: Command, build: Path) -> None:
    before = content_of(".")
    status, out, err = thorvaldc("build", "--check", "good.yaml")
    assert (status, err) == (0, "")
    assert out.startswith("build/good: fresh (")
    assert content_of(".") == before


def test_changed_missing_and_extra_files_are_named(thorvaldc: Command, build: Path) -> None:
    (build / "urdf/robot.urdf").unlink()
    (build / "mjcf/robot.xml").write_text("<mujoco/>")
    (build / "notes.txt").write_text("a file of the user")
    manifest = json.loads((build / "manifest.json").read_bytes())
    manifest["files"]["old/robot.xml"] = ""
    (build / "manifest.json").write_text(json.dumps(manifest))
    (build / "old").mkdir()
    (build / "old/robot.xml").write_text("")
    before = content_of(".")
    status, out, _ = thorvaldc("build", "--check", "good.yaml", "--format", "json")
    assert status == 1
    (checked,) = json.loads(out)["builds"]
    assert checked == {
        "file": "good.yaml",
        "folder": "build/good",
        "fresh": False,
        "missing": ["urdf/robot.urdf"],
        "changed": ["manifest.json", "mjcf/robot.xml"],
        "extra": ["old/robot.xml"],
    }
    assert content_of(".") == before
    text = thorvaldc("build", "--check", "good.yaml").err
    assert (
        "changed: manifest.json, mjcf/robot.xml; missing: urdf/robot.urdf; extra: old/robot.xml"
        in text
    )
    assert "hint: write it again and commit it: thorvaldc build good.yaml\n" in text
    thorvaldc("build", "good.yaml")
    assert thorvaldc("build", "--check", "good.yaml").status == 0


def test_a_change_of_the_robot_makes_the_build_stale(thorvaldc: Command, build: Path) -> None:
    Path("good.yaml").write_text(GOOD.replace("1.1 m", "1.2 m"))
    assert "changed: " in thorvaldc("build", "--check", "good.yaml").err


def test_no_build_and_another_version(thorvaldc: Command, build: Path) -> None:
    manifest = build / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"thorvaldc ', '"thorvaldc 0.0.'))
    assert "it was made by thorvaldc 0.0." in thorvaldc("build", "--check", "good.yaml").err
    shutil.rmtree("build")
    status, _, err = thorvaldc("build", "--check", "good.yaml")
    assert status == 1
    assert "there is no build in `build/good`" in err
    assert not Path("build").exists()


def test_line_endings_of_git(thorvaldc: Command, build: Path) -> None:
    for path in build.rglob("*.xml"):
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    err = thorvaldc("build", "--check", "good.yaml").err
    assert "only the line endings differ: write `build/good/** -text` into .gitattributes" in err


def test_fleets_several_robots_and_other_folders(thorvaldc: Command) -> None:
    Path("fleet.yaml").write_text(
        "thorvaldc: 1\nname: pair\nrobots:\n  a: {robot: good.yaml}\n"
        "  b: {robot: good.yaml, xyz: [3 m, 0, 0]}\n"
    )
    arguments = ("fleet.yaml", "good.yaml", "-o", "out", "-t", "urdf,can")
    assert thorvaldc("build", *arguments).status == 0
    status, out, err = thorvaldc("build", "--check", *arguments)
    assert (status, err) == (0, "")
    assert out.count("fresh") == 2
    Path("out/pair/model.json").write_text("{}")
    status, out, err = thorvaldc("build", "--check", *arguments)
    assert status == 1
    assert "out/good: fresh" in out
    assert "thorvaldc build fleet.yaml --target urdf,can -o out/pair" in err


def test_a_lock_file_that_a_build_would_write(thorvaldc: Command) -> None:
    Path("good.yaml").write_text(GOOD.replace(", can: 4", ""))
    err = thorvaldc("build", "--check", "good.yaml").err
    assert "the lock file `good.lock.yaml` is not that of the present robot" in err
    assert not list(Path().glob("*.lock.yaml"))
    thorvaldc("build", "good.yaml")
    assert thorvaldc("build", "--check", "good.yaml").status == 0


def test_unusual_files_in_the_place_of_a_build(thorvaldc: Command, build: Path) -> None:
    (build / "urdf/robot.urdf").unlink()
    (build / "urdf/robot.urdf").mkdir()
    (build / "mjcf/robot.xml").unlink()
    os.mkfifo(build / "mjcf/robot.xml")
    (build / "model.json").unlink()
    (build / "model.json").symlink_to("nowhere")
    err = thorvaldc("build", "--check", "good.yaml").err
    assert "TV985" in err
    assert "Traceback" not in err
    shutil.rmtree(build)
    build.write_text("a file")
    assert "TV985" in thorvaldc("build", "--check", "good.yaml").err


def test_a_robot_with_errors_is_not_compared(thorvaldc: Command) -> None:
    status, _, err = thorvaldc("build", "--check", "bad.yaml")
    assert status == 1
    assert "TV985" not in err
