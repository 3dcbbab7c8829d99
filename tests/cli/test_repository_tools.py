"""The hooks for pre-commit, the GitHub action and the badge, used as in a repository of robots."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.cli.conftest import BAD, GOOD, SHAKY, Command
from tests.outside_tools import path_of

ROOT = Path(__file__).resolve().parents[2]
HOOKS = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8"))
ACTION = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Variables with a ``thorvaldc`` of this checkout on the path, and a git without settings."""
    programs = tmp_path / "bin"
    programs.mkdir()
    program = programs / "thorvaldc"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m thorvaldc "$@"\n')
    program.chmod(0o755)
    identity = {
        f"GIT_{who}_{what}": "a@b" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")
    }
    return {
        **{k: v for k, v in os.environ.items() if not k.startswith("GIT_")},
        **identity,
        "PATH": f"{programs}:{os.environ['PATH']}",
        "PYTHONPATH": ":".join(p for p in sys.path if p),
        "HOME": str(tmp_path),
        "PRE_COMMIT_HOME": str(tmp_path / "cache"),
    }


def run(
    folder: Path, environment: dict[str, str], *command: str
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.mark.slow
def test_the_hooks_run_in_a_repository(tmp_path: Path, environment: dict[str, str]) -> None:
    """With the programs of this checkout in place of a new environment, which needs a network."""
    git, folder = path_of("git"), tmp_path / "robots"
    folder.mkdir()
    pre_commit = (sys.executable, "-m", "pre_commit")
    manifest = str(ROOT / ".pre-commit-hooks.yaml")
    assert run(folder, environment, *pre_commit, "validate-manifest", manifest).returncode == 0
    hooks = [{**hook, "language": "system"} for hook in HOOKS]
    config = {"repos": [{"repo": "local", "hooks": hooks}]}
    (folder / ".pre-commit-config.yaml").write_text(json.dumps(config))
    (folder / "robot.yaml").write_text(GOOD)
    (folder / "notes.yaml").write_text("no: robot\n")
    run(folder, environment, git, "init", "-q")
    run(folder, environment, git, "add", "-A")
    checked = run(folder, environment, *pre_commit, "run", "thorvaldc-check")
    assert checked.returncode == 0, checked.stdout + checked.stderr
    stale = run(folder, environment, *pre_commit, "run", "thorvaldc-build-check")
    assert stale.returncode == 1
    assert "there is no build in `build/good`" in stale.stdout
    (folder / "robot.yaml").write_text(SHAKY)  # a warning
    run(folder, environment, git, "add", "-A")
    failed = run(folder, environment, *pre_commit, "run", "thorvaldc-check")
    assert failed.returncode == 1
    assert "warning[TV408]" in failed.stdout


def test_the_action_uses_its_inputs_only_through_variables() -> None:
    assert ACTION["runs"]["using"] == "composite"
    for step in ACTION["runs"]["steps"]:
        assert "${{" not in step.get("run", "")
        if "run" in step:
            assert step["shell"] == "bash"
    used = re.findall(r"\$\{\{ inputs\.([\w-]+) \}\}", (ROOT / "action.yml").read_text())
    assert set(used) == set(ACTION["inputs"])


def run_step(folder: Path, environment: dict[str, str], **inputs: str) -> Any:
    """Runs the last step as the runner of GitHub does."""
    script = folder.parent / "step.sh"
    script.write_text(ACTION["runs"]["steps"][-1]["run"])
    command = (path_of("bash"), "--noprofile", "--norc", "-eo", "pipefail", str(script))
    return run(folder, {**environment, **inputs}, *command)


@pytest.mark.slow
def test_the_step_of_the_action_annotates(tmp_path: Path, environment: dict[str, str]) -> None:
    folder = tmp_path / "robots"
    (folder / "a/b").mkdir(parents=True)
    (folder / "a/b/good one.yaml").write_text(GOOD)
    (folder / "a/shaky.yaml").write_text(SHAKY)
    done = run_step(folder, environment, INPUT_FILES="a/**/*.yaml", INPUT_STRICT="false")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("::warning file=a/shaky.yaml,line=")
    assert run_step(folder, environment, INPUT_FILES="a/**/*.yaml", INPUT_STRICT="true").returncode
    (folder / "a/bad.yaml").write_text(BAD)
    done = run_step(folder, environment, INPUT_FILES="a/bad.yaml\na/b/*", INPUT_STRICT="false")
    assert done.returncode == 1
    assert "::error file=a/bad.yaml,line=" in done.stdout
    done = run_step(folder, environment, INPUT_FILES="none/*", INPUT_STRICT="false")
    assert (done.returncode, done.stdout) == (1, "::error::no file matches: none/*\n")
    done = run_step(folder, environment, INPUT_FILES="$(touch x) ;touch", INPUT_STRICT="false")
    assert done.returncode != 0
    assert not (folder / "x").exists()


def test_the_badge_has_the_numbers(thorvaldc: Command) -> None:
    for files, message, color in (
        (["good.yaml"], "no errors", "brightgreen"),
        (["good.yaml", "shaky.yaml"], "0 errors, 1 warning", "yellow"),
        (["bad.yaml"], "2 errors, 0 warnings", "red"),
    ):
        status, out, err = thorvaldc("check", "--format", "badge", *files)
        assert err == ""
        assert status == (1 if color == "red" else 0)
        badge = json.loads(out)
        assert (badge["schemaVersion"], badge["message"], badge["color"]) == (1, message, color)
