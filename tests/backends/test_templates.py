"""The templates of backends, and the Python files that they become."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jinja2
import pytest

from tests.examples import example_fleet, example_robot
from thorvaldc.backends import templates
from thorvaldc.backends.ros2 import fleet_package, package_of
from thorvaldc.backends.templates import Templates
from thorvaldc.model.settings import RosSettings


def test_a_value_that_looks_like_a_placeholder_stays_as_it_is() -> None:
    values: dict[str, Any] = {"package": "a", "depends": []}
    values["description"] = "{{ package }} <b>"
    values |= {"settings": RosSettings(), "maintainer": ("Ada", "ada@example.org")}
    text = Templates("ros2", {"quoted": str, "xml": str}).render("package.xml", **values)
    assert "<description>{{ package }} <b></description>" in text
    del values["description"]
    with pytest.raises(jinja2.UndefinedError, match="description"):
        Templates("ros2", {"quoted": str, "xml": str}).render("package.xml", **values)


def test_templates_are_compiled_once_and_again_after_a_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def text(value: str) -> str:
        return Templates("notes").render("note.txt", value=value)

    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(templates, "data_folder", lambda name: tmp_path)
    note = tmp_path / "notes" / "note.txt"
    note.parent.mkdir()
    note.write_text("one {{ value }}", encoding="utf-8")
    (note.parent / "__pycache__").write_text("no folder", encoding="utf-8")
    assert text("a") == "one a"
    (note.parent / "__pycache__").unlink()
    assert text("b") == "one b"
    with monkeypatch.context() as patch:
        patch.setattr(jinja2.Environment, "compile", None)
        assert text("c") == "one c"
    note.write_text("two {{ value }}", encoding="utf-8")
    assert text("d") == "two d"
    for file in (note.parent / "__pycache__").iterdir():
        file.write_bytes(file.read_bytes()[:-9])
    assert text("e") == "two e"
    monkeypatch.setattr(templates, "__file__", "/nowhere/thorvaldc.zip/templates.pyc")
    assert text("f") == "two f"


def test_the_python_files_of_packages_pass_the_linter(tmp_path: Path) -> None:
    """Robots with all parts, without any, and without a turn on the spot."""
    ruff = shutil.which("ruff", path=Path(sys.executable).parent)
    assert ruff is not None
    full = example_robot("4wd4ws_wide")
    files = fleet_package(example_fleet("fleet_of_four"))
    variants = {
        "full": full,
        "ekf": replace(full, ros=replace(full.ros, odom_tf="ekf")),
        "plain": replace(full, sensors=(), actuators=(), buses=()),
        "lidar": replace(full, sensors=tuple(s for s in full.sensors if s.type == "lidar_3d")),
        "car": example_robot("car"),
    }
    for name, robot in variants.items():
        files |= {f"{name}/{path}": data for path, data in package_of(robot).items()}
    for path, data in files.items():
        if path.endswith(".py"):
            file = tmp_path / path
            file.parent.mkdir(parents=True, exist_ok=True)
            compile(data, path, "exec")
            file.write_bytes(data)
    rules = ["--isolated", "--select", "E,F,W,I", "--line-length", "100"]
    result = subprocess.run([ruff, "check", *rules, tmp_path], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout
