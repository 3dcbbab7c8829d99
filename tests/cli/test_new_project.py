"""`new --project` makes a repository in which every command of its CI succeeds."""

from __future__ import annotations

import glob
import json
import os
import re
from pathlib import Path

import jsonschema
import pytest
import yaml

from tests.cli.conftest import Command
from thorvaldc import __version__ as VERSION
from thorvaldc.compiler.scaffolding import presets, project_files
from thorvaldc.diagnostics.installation import Origin


def test_every_command_of_its_ci_succeeds(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert thorvaldc("new", "farm", "--project").status == 0
    monkeypatch.chdir("farm")
    workflow = yaml.safe_load(Path(".gitlab-ci.yml").read_text())
    commands = [line for line in workflow["check"]["script"] if line.startswith("thorvaldc ")]
    assert len(commands) == 4
    for command in [*commands, "thorvaldc scenario scenarios/straight.yaml"]:
        words = [path for word in command.split()[1:] for path in glob.glob(word) or [word]]
        status, _, err = thorvaldc(*words)
        assert (status, err) == (0, ""), command
    text = Path(".github/workflows/robots.yml").read_text()
    assert yaml.safe_load(text)["jobs"]["check"]["steps"]
    for command in commands:
        assert command.removesuffix(" modules") in re.sub(" --format github", "", text)
    assert yaml.safe_load(Path(".pre-commit-config.yaml").read_text())["repos"]


@pytest.mark.parametrize("preset", presets())
def test_every_preset_passes_a_strict_check(thorvaldc: Command, preset: str) -> None:
    thorvaldc("new", "farm", "--project", "--preset", preset)
    status, out, _ = thorvaldc("check", "--strict", "farm/robots/farm.yaml")
    assert status == 0, out


def test_existing_files_are_kept(thorvaldc: Command) -> None:
    Path("farm").mkdir()
    Path("farm/README.md").write_text("mine")
    status, _, err = thorvaldc("new", "farm", "--project")
    assert status == 2
    assert f"farm{os.sep}README.md exists already" in err
    assert [path.name for path in Path("farm").iterdir()] == ["README.md"]
    assert Path("farm/README.md").read_text() == "mine"


def test_each_document_names_its_schema_for_editors(thorvaldc: Command) -> None:
    thorvaldc("new", "farm", "--project")
    documents = ("robots/farm.yaml", "scenarios/straight.yaml", "modules/top/plate/module.yaml")
    for document in map(Path("farm").joinpath, documents):
        modeline, _, text = document.read_text().partition("\n")
        name = modeline.removeprefix("# yaml-language-server: $schema=")
        schema = json.loads((document.parent / name).read_text())
        jsonschema.validate(yaml.safe_load(text), schema)
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({"thorvaldc": 1, "nmae": "x"}, schema)


def test_no_placeholder_is_left() -> None:
    assert "@NAME@" not in "".join(map(str, project_files("farm", "4wd4ws", VERSION).values()))


@pytest.mark.parametrize(
    ("came_from", "requirement"),
    [
        (Origin("thorvaldc"), "thorvaldc"),
        (Origin("thorvaldc", "https://example.org/t.whl"), "thorvaldc @ https://example.org/t.whl"),
        (Origin("thorvaldc", "/my checkout"), f"./wheels/thorvaldc-{VERSION}-py3-none-any.whl"),
        (
            Origin("thorvaldc", "thorvaldc-9-py3-none-any.whl"),
            "./wheels/thorvaldc-9-py3-none-any.whl",
        ),
    ],
    ids=["index", "url", "checkout", "wheel"],
)
def test_ci_installs_thorvaldc_from_where_this_one_came(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch, came_from: Origin, requirement: str
) -> None:
    monkeypatch.setattr("thorvaldc.compiler.scaffolding.origin", lambda: came_from)
    if came_from.place.endswith("any.whl") and came_from.is_local:
        Path(came_from.place).write_bytes(b"a wheel")
    status, out, _ = thorvaldc("new", "farm", "--project")
    assert status == 0
    assert Path("farm/requirements.txt").read_text().splitlines()[1:] == [requirement]
    wheels = [path.read_bytes() for path in Path("farm").glob("wheels/*")]
    assert wheels == ([b"a wheel"] if came_from.place.startswith("thorvaldc-9") else [])
    command = '  pip wheel --no-deps --wheel-dir wheels "/my checkout"'
    assert (command in out.splitlines()) == (came_from.place == "/my checkout")
    for file in (".gitlab-ci.yml", ".github/workflows/robots.yml"):
        assert "pip install --requirement requirements.txt" in Path("farm", file).read_text()
