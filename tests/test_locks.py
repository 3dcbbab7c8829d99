"""The locks: the exact versions in every environment of ``make`` and of ``.ci/run``."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from tests.outside_tools import path_of
from tests.packaging.runtime_environment import requirements_of

ROOT = Path(__file__).resolve().parents[1]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
GROUPS: dict[str, Any] = PROJECT["dependency-groups"]
READERS = ("dcfgen", "drake", "dart", "pinocchio", "usd", "usdcore", "warp")
ENVIRONMENTS = (*READERS, "jazzy", "kilted")


def pins(name: str) -> dict[str, Version]:
    """Returns the versions of a lock by the normalised name of the package."""
    lines = (ROOT / "locks" / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    requirements = [Requirement(line) for line in lines if line[:1].isalnum()]
    return {
        canonicalize_name(pin.name): Version(str(pin.specifier).removeprefix("=="))
        for pin in requirements
    }


def members(group: str) -> Iterator[str]:
    for member in GROUPS[group]:
        if isinstance(member, dict):
            yield from members(member["include-group"])
        else:
            yield member


def wanted(lock: str) -> list[Requirement]:
    """Returns what pyproject.toml asks of the environment of a lock."""
    if lock != "dev":
        return [Requirement(text) for text in members(lock)]
    extras = PROJECT["project"]["optional-dependencies"]
    lines = [*PROJECT["project"]["dependencies"], *extras["dev"], *extras["bench"]]
    lines += [*PROJECT["build-system"]["requires"], *members("tools")]
    return [Requirement(line) for line in lines]


@pytest.mark.parametrize("lock", ["dev", *ENVIRONMENTS])
def test_a_lock_fits_pyproject(lock: str) -> None:
    versions = pins(lock)
    unfit = [
        f"{requirement}, but locked: {versions.get(canonicalize_name(requirement.name))}"
        for requirement in wanted(lock)
        if not requirement.specifier.contains(
            versions.get(canonicalize_name(requirement.name), "0"), prereleases=True
        )
        or canonicalize_name(requirement.name) not in versions
    ]
    assert unfit == [], "run `make lock`"


def test_the_lock_names_what_the_dependencies_need() -> None:
    """pip would take the newest version of a package that the lock does not name."""
    needed = {canonicalize_name(name) for name in requirements_of("thorvaldc[dev]")}
    assert sorted(needed - {"thorvaldc"} - set(pins("dev"))) == []
    assert len(needed) > 100


@pytest.mark.parametrize("lock", ["dev", *ENVIRONMENTS])
def test_a_lock_is_what_plain_pip_reads_and_names_no_place(lock: str) -> None:
    pin = r"[a-z0-9-]+==[0-9][a-z0-9.+]*( ; [a-z_]+ [^/]+)?"
    lines = (ROOT / "locks" / f"{lock}.txt").read_text(encoding="utf-8").splitlines()
    odd = [line for line in lines if not re.fullmatch(rf" *#.*|{pin}", line)]
    assert odd == []
    assert not [line for line in lines if re.search(r"https?:|file:|/", line)]


def test_every_group_has_a_lock_that_make_and_ci_use() -> None:
    assert {path.stem for path in (ROOT / "locks").iterdir()} == {"dev", *ENVIRONMENTS}
    assert {*ENVIRONMENTS, "tools", "ros"} == set(GROUPS)
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    script = (ROOT / ".ci/run").read_text(encoding="utf-8")
    assert re.findall(r"--output-file locks/(\w+)\.txt", makefile) == ["dev", *ENVIRONMENTS]
    assert re.findall(r"^environment (\w+)$", script, re.M) == [*READERS]
    for text in (makefile, script):
        installs = [line for line in text.splitlines() if "pip install" in line]
        assert len(installs) == 1, "one command installs, with the lock"


@pytest.mark.parametrize("changed", ["pyproject.toml", "locks/dev.txt", "README.md"])
def test_the_environment_is_made_anew_when_the_lock_changes(tmp_path: Path, changed: str) -> None:
    names = ("Makefile", "pyproject.toml", "locks/dev.txt", "README.md")
    for number, name in enumerate((*names, ".venv/.plain", ".venv/.ready")):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.touch() if name.startswith(".venv") else shutil.copy(ROOT / name, path)
        os.utime(path, (number, number))

    def setup(target: str = "setup") -> str:
        command = [path_of("make"), "--dry-run", target]
        return subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout

    assert "-m venv" not in setup()
    (tmp_path / ".venv/.ready").unlink()
    assert ".[dev]" in setup()
    assert ".[dev]" not in setup("demo")  # which needs the plain package alone
    os.utime(tmp_path / changed, (9, 9))
    assert ("-m venv --clear .venv" in setup()) == (changed != "README.md")
