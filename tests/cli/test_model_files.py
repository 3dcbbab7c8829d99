"""The model of a build as the ROBOT of a command: known by its content, whatever its name is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import thorvaldc as api
from tests.cli.conftest import Command, run_in_this_process

FAST = ("--bus", "virtual", "--fast", "--twist", "0.1,0,0", "--duration", "0.2 s")


@pytest.fixture(scope="module")
def model_text(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    with pytest.MonkeyPatch.context() as monkeypatch:
        run = run_in_this_process(monkeypatch, tmp_path_factory.mktemp("build"))
        assert run("build", "good.yaml", "-o", "build", "--target", "urdf").status == 0
        return Path("build/model.json").read_bytes()


@pytest.fixture
def model(thorvaldc: Command, model_text: bytes) -> Path:
    Path("build").mkdir()
    Path("build/model.json").write_bytes(model_text)
    return Path("build/model.json")


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("robot_7.json", ("info", "ROBOT")),
        ("robot_7", ("diff", "ROBOT", "good.yaml")),
        ("model.yaml", ("run", "ROBOT", *FAST)),
        ("robot_7", ("run", "ROBOT", *FAST)),
        ("model.yaml", ("can", "plan", "ROBOT", "--bus", "virtual")),
    ],
)
def test_a_model_under_another_name_opens(
    thorvaldc: Command, model: Path, name: str, command: tuple[str, ...]
) -> None:
    Path(name).write_bytes(model.read_bytes())
    result = thorvaldc(*(name if word == "ROBOT" else word for word in command))
    assert (result.status, "error" in result.err) == (0, False)
    assert api.load(name).name == "good"


def test_a_model_that_was_formatted_again_opens(thorvaldc: Command, model: Path) -> None:
    Path("robot_7").write_text("\n" + json.dumps(json.loads(model.read_text()), indent=2))
    Path("copy").write_bytes(model.read_bytes())
    assert thorvaldc("info", "robot_7").out == thorvaldc("info", "copy").out


@pytest.mark.parametrize(
    ("command", "content"),
    [
        ("run", "[]"),
        *(("info", text) for text in ('{"format": "thorvaldc-manifest"}', "{", "", "{" * 5000)),
    ],
)
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
