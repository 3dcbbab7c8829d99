"""The model of a build as the ROBOT of a command: known by its content, whatever its name is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import thorvaldc as api
from tests.cli.conftest import Command


@pytest.fixture
def model(thorvaldc: Command) -> Path:
    assert thorvaldc("build", "good.yaml", "-o", "build").status == 0
    return Path("build/model.json")


@pytest.mark.parametrize("name", ["robot_7.json", "robot_7", "model.yaml"])
@pytest.mark.parametrize(
    "command",
    [
        ("info", "ROBOT"),
        ("diff", "ROBOT", "good.yaml"),
        ("run", "ROBOT", "--bus", "virtual", "--fast", "--twist", "0.1,0,0", "--duration", "1 s"),
        ("can", "plan", "ROBOT", "--bus", "virtual"),
    ],
    ids=lambda words: words[0],
)
def test_a_model_under_another_name_opens(
    thorvaldc: Command, model: Path, command: tuple[str, ...], name: str
) -> None:
    Path(name).write_bytes(model.read_bytes())
    result = thorvaldc(*(name if word == "ROBOT" else word for word in command))
    assert (result.status, "error" in result.err) == (0, False)
    assert api.load(name).name == "good"


def test_a_model_that_was_formatted_again_opens(thorvaldc: Command, model: Path) -> None:
    Path("robot_7").write_text("\n" + json.dumps(json.loads(model.read_text()), indent=2))
    Path("copy").write_bytes(model.read_bytes())
    assert thorvaldc("info", "robot_7").out == thorvaldc("info", "copy").out


@pytest.mark.parametrize("command", ["info", "run"])
@pytest.mark.parametrize("content", ['{"format": "thorvaldc-manifest"}', "[]", "{", "", "{" * 5000])
def test_other_json_is_an_error_with_its_name(
    thorvaldc: Command, command: str, content: str
) -> None:
    Path("other.json").write_text(content)
    options = ("--bus", "virtual") if command == "run" else ()
    result = thorvaldc(command, "other.json", *options)
    assert result.status == 1
    assert "other.json: not a thorvaldc-model file" in result.err


@pytest.mark.parametrize("command", ["check", "build", "sim", "view", "render"])
def test_a_command_that_needs_the_robot_file_says_so(
    thorvaldc: Command, model: Path, command: str
) -> None:
    result = thorvaldc(command, str(model))
    assert result.status == 1
    assert "this is the model of a build; expected a robot" in result.out + result.err
    assert "1 error in 1 file" in result.out + result.err


def test_a_build_has_no_sources(thorvaldc: Command, model: Path) -> None:
    Path("robot_7").write_bytes(model.read_bytes())
    result = thorvaldc("why", "robot_7", "mass")
    assert result.status == 2
    assert "robot_7 is a build" in " ".join(result.err.split())
