"""The Dockerfile and the release workflow: their steps run, and name what exists."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from tests.cli.conftest import GOOD
from tests.outside_tools import path_of

ROOT = Path(__file__).resolve().parents[2]
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


def test_the_release_workflow_runs_targets_of_make() -> None:
    workflow = yaml.safe_load((ROOT / ".github/workflows/release.yml").read_text(encoding="utf-8"))
    commands = [s["run"] for job in workflow["jobs"].values() for s in job["steps"] if "run" in s]
    assert commands == ["make dist", "make docs"]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for command in commands:
        target = command.removeprefix("make ")
        assert re.search(rf"^{target}: \$\(READY\)$", makefile, re.MULTILINE)
