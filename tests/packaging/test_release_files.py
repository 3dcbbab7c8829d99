"""The Dockerfile, the workflows and the files for contributors: they name what exists."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.cli.conftest import GOOD
from tests.outside_tools import TOOLS, path_of

ROOT = Path(__file__).resolve().parents[2]
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
TEMPLATES = sorted((ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml"))
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")


def steps(instruction: str) -> list[str]:
    return re.findall(rf"^{instruction} (.*)$", DOCKERFILE, re.MULTILINE)


@pytest.mark.slow
def test_the_steps_of_the_dockerfile_in_a_plain_folder(tmp_path: Path) -> None:
    """All but those of Debian, with the Python of this computer."""
    git = path_of("git")
    files = subprocess.run(
        [git, "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    source = tmp_path / "source"
    for name in filter(None, files.split("\0")):
        assert not any(Path(name).match(pattern) for pattern in ignored), name
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, source / name)
    robots = tmp_path / "robots"
    robots.mkdir()
    (robots / "robot.yaml").write_text(GOOD, encoding="utf-8")
    variables = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    variables["PIP_NO_COMPILE"] = "0"  # pip reads it as `compile`: no bytecode of all packages

    def run(*command: str) -> subprocess.CompletedProcess[str]:
        command = tuple(re.sub("/(opt|source)\\b", rf"{tmp_path}/\1", part) for part in command)
        return subprocess.run(
            command, cwd=robots, env=variables, capture_output=True, text=True, check=False
        )

    assert steps("COPY") == [". /source"]
    assert steps("WORKDIR") == ["/robots"]
    debian, *others = steps("RUN")
    assert debian.startswith("apt-get update && apt-get install")
    for step in others:
        done = run("sh", "-c", step)
        assert done.returncode == 0, done.stdout + done.stderr
    (entry,) = map(json.loads, steps("ENTRYPOINT"))
    done = run(*entry, "check", "robot.yaml")
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
    assert run(*entry, "build", "robot.yaml").returncode == 0
    assert (robots / "build" / "good" / "urdf" / "robot.urdf").is_file()


def test_the_image_has_git_and_opengl_and_no_root() -> None:
    packages = steps("RUN")[0].split()
    for tool in TOOLS:
        if tool.name in ("git", "venv", "EGL"):
            assert set(tool.packages.split()) <= set(packages), tool.name
    (user,) = steps("USER")
    assert re.fullmatch("[1-9][0-9]*:[1-9][0-9]*", user)
    assert DOCKERFILE.rindex("\nRUN ") < DOCKERFILE.index("\nUSER "), "root owns what is installed"


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_the_workflows_run_what_exists(path: Path) -> None:
    workflow = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert workflow["permissions"] == {"contents": "read"}, "jobs ask for more one by one"
    runs = [s["run"] for job in workflow["jobs"].values() for s in job["steps"] if "run" in s]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = re.findall(r"\bmake ([\w-]+)", "\n".join(runs))
    assert targets
    for target in targets:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
    for script in (run for run in runs if run.startswith(".")):
        assert os.access(ROOT / script, os.X_OK), script


def test_a_pull_request_runs_the_tests_of_everybody() -> None:
    """Without the variable ``CI``, with which a missing program is an error."""
    workflow = yaml.safe_load((ROOT / ".github/workflows/test.yml").read_text(encoding="utf-8"))
    (job,) = workflow["jobs"].values()
    assert [step["run"] for step in job["steps"] if "run" in step] == ["env --unset=CI make test"]


def test_actions_are_pinned_by_their_commit() -> None:
    """A tag can be moved to other code.  All files use the same version of an action."""
    files = [*(ROOT / ".github").rglob("*.yml"), ROOT / "action.yml"]
    files += [*(ROOT / "templates").rglob("*.yml"), *(ROOT / "docs").rglob("*.md")]
    versions: dict[str, set[tuple[str, str]]] = {}
    for file in files:
        for used in re.findall(r"^\s*(?:- )?uses: *(.*)$", file.read_text("utf-8"), re.MULTILINE):
            if used.startswith("OWNER/"):  # this repository, wherever it is
                continue
            pinned = re.fullmatch(r"([\w/-]+)@([0-9a-f]{40}) # (v\d+\.\d+\.\d+)", used)
            assert pinned, f"{file.relative_to(ROOT)}: {used}"
            versions.setdefault(pinned[1], set()).add((pinned[2], pinned[3]))
    assert "actions/checkout" in versions
    assert [action for action, used in versions.items() if len(used) > 1] == []


def test_the_hooks_of_developers_run_what_make_sets_up() -> None:
    config = ROOT / ".pre-commit-config.yaml"
    validation = subprocess.run(
        [sys.executable, "-m", "pre_commit", "validate-config", str(config)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert validation.returncode == 0, validation.stdout
    (repository,) = yaml.safe_load(config.read_text(encoding="utf-8"))["repos"]
    assert repository["repo"] == "local"
    for hook in repository["hooks"]:
        assert hook["entry"].startswith((".venv/bin/ruff ", "make ")), hook["id"]


@pytest.mark.parametrize("path", TEMPLATES, ids=lambda path: path.stem)
def test_the_issue_templates_are_forms_of_github(path: Path) -> None:
    form = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert {"name", "description", "body"} <= set(form) <= {"name", "description", "title", "body"}
    for field in form["body"]:
        assert field["type"] in ("markdown", "textarea", "input")
        assert field["attributes"].get("label" if field["type"] != "markdown" else "value")
    names = [field["id"] for field in form["body"] if field["type"] != "markdown"]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("name", ["CONTRIBUTING.md", "SECURITY.md"])
def test_the_links_of_the_pages_at_the_root_exist(name: str) -> None:
    links = re.findall(r"\]\(([^)#]+)", (ROOT / name).read_text(encoding="utf-8"))
    assert links
    for link in links:
        assert (ROOT / link).is_file(), link
