"""Runs a part of the tests with other versions of Python and of the dependencies.

    make test-matrix                          every combination
    workshop/test_matrix.py --list               show the combinations
    workshop/test_matrix.py 3.13-lowest          run one of them

A combination is the oldest or the newest Python here with the lowest versions of the dependencies
that pyproject.toml allows, or the newest Python with the newest versions.  Pythons are looked for
in PATH and in pyenv's folder.  The environments are in .matrix/; uv, in the Python of this script,
makes them.

Where the newest versions fail and those of locks/dev.txt pass with the same Python, a new release
is the cause.  That is a warning with the names of the packages, and not an error.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / ".matrix"
LOCK = "locks/dev.txt"
OLDEST = (3, 11)
UV = [sys.executable, "-m", "uv", "--quiet"]
# Every output of the compiler, the table of commands, what reads files and buses by other packages,
# and a case of each diagnostic: the simulation, xacro, recordings and tools are run, too.
TESTS = [
    *("tests/golden", "tests/test_api.py", "tests/cli/test_command_table.py"),
    *("tests/can", "tests/model/test_sums.py", "tests/compiler/shapes", "tests/compiler/source"),
    *("tests/schema", "tests/diagnostics/test_cases.py::test_case"),
]
# Packages of the extra `dev` that these tests need beside the dependencies of the package.
TEST_PACKAGES = {
    *("pytest", "pytest-asyncio", "pytest-timeout", "pytest-xdist", "hypothesis"),
    *("canopen", "cantools", "msgpack", "pyserial", "rosbags"),
}

QUICK = "not slow and not exhaustive"


class Combination(NamedTuple):
    """A Python (version and path) and how the versions of its dependencies are chosen."""

    version: tuple[int, int]
    python: str
    dependencies: str  # lowest, newest, or locked

    @property
    def name(self) -> str:
        return f"{self.version[0]}.{self.version[1]}-{self.dependencies}"


def pythons() -> dict[tuple[int, int], str]:
    """Returns the paths of the Pythons of this machine that the package allows, by version."""
    candidates = [shutil.which(f"python3.{minor}") for minor in range(OLDEST[1], 30)]
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    candidates += sorted(str(path) for path in pyenv.glob("versions/*/bin/python3"))
    by_version: dict[tuple[int, int], str] = {}
    for path in [sys.executable, *filter(None, candidates)]:
        script = "import sys, ensurepip, venv; print(*sys.version_info[:2], sys.version_info[3])"
        command = [path, "-c", script]
        answer = subprocess.run(command, capture_output=True, text=True, check=False).stdout.split()
        if len(answer) == 3 and answer[2] == "final":  # also pyenv's shims of no version
            version = int(answer[0]), int(answer[1])
            if version >= OLDEST:
                by_version.setdefault(version, path)
    return by_version


def combinations() -> list[Combination]:
    """Returns the combinations of the Pythons here."""
    by_version = pythons()
    oldest, newest = min(by_version), max(by_version)
    lowest = [Combination(v, by_version[v], "lowest") for v in sorted({oldest, newest})]
    return [*lowest, Combination(newest, by_version[newest], "newest")]


def environment(combination: Combination) -> Path:
    """Makes the environment of a combination; returns its Python.

    It is made anew if pyproject.toml or the lock changed.  There may be a newer version every day,
    so that an environment with the newest is brought up to date each time.
    """
    home = FOLDER / combination.name
    python = home / "bin/python"
    sources = [(ROOT / name).read_bytes() for name in ("pyproject.toml", LOCK)]
    stamp = hashlib.sha256(b"".join(sources) + combination.python.encode()).hexdigest()
    ready = home / "ready"
    is_ready = ready.exists() and ready.read_text() == stamp
    if is_ready and combination.dependencies != "newest":
        return python
    if is_ready:
        ready.unlink()
    else:
        subprocess.run([*UV, "venv", "--clear", "--python", combination.python, home], check=True)
    # What the dependencies depend on is not newer than the lock, even where it has no lower bound.
    not_newer = home / "not_newer.txt"
    bounds = [f"{name}<={version}\n" for name, version in locked_versions().items()]
    not_newer.write_text("".join(bounds), encoding="utf-8")
    install = [*UV, "pip", "install", "--python", python]
    choice = {
        # --no-build: the lowest version with a wheel for this Python.
        "lowest": ["--resolution", "lowest-direct", "--no-build", "--constraints", not_newer],
        "newest": ["--upgrade"],
        "locked": ["--constraints", LOCK],
    }[combination.dependencies]
    subprocess.run([*install, *choice, *requirements()], cwd=ROOT, check=True)
    build = ["--build-constraints", LOCK] if combination.dependencies != "newest" else []
    subprocess.run([*install, *build, "--no-deps", "--editable", "."], cwd=ROOT, check=True)
    ready.write_text(stamp)
    return python


def requirements() -> list[str]:
    """Returns the dependencies of the package and of the tests, as in pyproject.toml."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    dev = project["optional-dependencies"]["dev"]
    return project["dependencies"] + [r for r in dev if Requirement(r).name in TEST_PACKAGES]


def run(combination: Combination) -> bool:
    """Runs the tests of a combination; returns whether they pass."""
    print(f"== {combination.name}: {combination.python}", flush=True)
    start = time.monotonic()
    try:
        python = environment(combination)
    except subprocess.CalledProcessError:
        print(f"== {combination.name}: FAILED, the packages cannot be installed", flush=True)
        return False
    command = [python, "-m", "pytest", "-n", os.environ.get("JOBS", "auto")]
    command += ["--dist", "loadgroup", "-p", "no:cacheprovider", "-m", QUICK, *TESTS]
    passed = subprocess.run(command, cwd=ROOT, check=False).returncode == 0
    result = "passed" if passed else "FAILED"
    print(f"== {combination.name}: {result} in {time.monotonic() - start:.0f} s", flush=True)
    return passed


def locked_versions() -> dict[str, Version]:
    """Returns the version of each package in the lock."""
    lines = (ROOT / LOCK).read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if line[:1].isalnum()]
    return {pin.name: Version(str(pin.specifier).removeprefix("==")) for pin in pins}


def newer_packages(combination: Combination) -> list[str]:
    """Returns the packages of an environment that are newer than in the lock, as text."""
    if not (FOLDER / combination.name / "ready").exists():
        return ["the newest versions cannot be installed together, see above"]
    command = [*UV, "pip", "list", "--format", "json", "--python"]
    answer = subprocess.run(
        [*command, FOLDER / combination.name / "bin/python"], capture_output=True, check=True
    )
    locked = locked_versions()
    return [
        f"{package['name']} {package['version']} (locked: {locked.get(package['name'], 'none')})"
        for package in json.loads(answer.stdout)
        if package["name"] != "thorvaldc"
        and not Version(package["version"]) <= locked.get(package["name"], Version("0"))
    ]


def is_cause_outside(combination: Combination) -> bool:
    """Whether a combination that failed does so because of releases that the lock does not have.

    Prints a warning with the names of these packages.
    """
    locked = combination._replace(dependencies="locked")
    if combination.dependencies != "newest":
        return False
    newer = newer_packages(combination)
    if not newer or not run(locked):
        return False
    bar = "!" * 80
    print(bar, f"WARNING: {combination.name} fails and {locked.name} passes.", sep="\n")
    print("The cause is one of the packages that are newer than in the lock:")
    print(*(f"  {package}" for package in newer), sep="\n")
    print("Make the code fit it, or limit it in pyproject.toml; then `make lock`.")
    print(bar, flush=True)
    return True


def main(names: list[str]) -> int:
    every = combinations()
    if names == ["--list"]:
        print(*(f"{c.name}: {c.python}" for c in every), sep="\n")
        return 0
    if unknown := [name for name in names if name not in [c.name for c in every]]:
        print(f"error: no combination {unknown[0]}; see --list", file=sys.stderr)
        return 2
    failed = [c for c in every if (not names or c.name in names) and not run(c)]
    explained = [c for c in failed if is_cause_outside(c)]
    return 0 if explained == failed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
