"""Runs a part of the tests with other versions of Python and of the dependencies.

    make test-matrix                          each combination that `make test` does not run
    tools/test_matrix.py --list               show the combinations
    tools/test_matrix.py 3.13-lowest          run one of them

A combination is the oldest or the newest Python here, with the lowest versions of the dependencies
that pyproject.toml allows, or the newest.  Pythons are looked for in PATH and in pyenv's folder.
The environments are in .matrix/; uv, in the Python of this script, makes them.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / ".matrix"
OLDEST = (3, 11)
UV = [sys.executable, "-m", "uv", "--quiet"]
# Every output of the compiler, the table of commands, and what reads files and buses by other
# packages.
TESTS = [
    *("tests/golden", "tests/test_api.py", "tests/cli/test_command_table.py"),
    *("tests/can", "tests/model", "tests/compiler/geometry", "tests/compiler/source"),
    *("tests/diagnostics", "tests/tools/calibration"),
]


class Combination(NamedTuple):
    """A Python (version and path) and how the versions of its dependencies are chosen."""

    version: tuple[int, int]
    python: str
    dependencies: str  # lowest or newest

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
    """Returns the combinations, without the one of ``make test``: this Python, the newest."""
    here = sys.version_info[:2]
    by_version = pythons()
    return [
        Combination(version, by_version[version], dependencies)
        for version in sorted({min(by_version), max(by_version)})
        for dependencies in ("lowest", "newest")
        if (version, dependencies) != (here, "newest")
    ]


def environment(combination: Combination) -> Path:
    """Makes the environment of a combination if pyproject.toml changed; returns its Python."""
    home = FOLDER / combination.name
    python = home / "bin/python"
    project = (ROOT / "pyproject.toml").read_bytes()
    stamp = hashlib.sha256(project + combination.python.encode()).hexdigest()
    ready = home / "ready"
    if ready.exists() and ready.read_text() == stamp:
        return python
    subprocess.run([*UV, "venv", "--clear", "--python", combination.python, home], check=True)
    install = [*UV, "pip", "install", "--python", python]
    # --no-build: the lowest version with a wheel for this Python.
    lowest = ["--resolution", "lowest-direct", "--no-build"]
    choice = lowest if combination.dependencies == "lowest" else []
    requirements = ["-r", "pyproject.toml", "--extra", "dev"]
    subprocess.run([*install, *choice, *requirements], cwd=ROOT, check=True)
    subprocess.run([*install, "--no-deps", "--editable", "."], cwd=ROOT, check=True)
    ready.write_text(stamp)
    return python


def run(combination: Combination) -> bool:
    """Runs the tests of a combination; returns whether they pass."""
    print(f"== {combination.name}: {combination.python}", flush=True)
    start = time.monotonic()
    command = [environment(combination), "-m", "pytest", "-n", os.environ.get("JOBS", "auto")]
    command += ["--dist", "loadgroup", "-p", "no:cacheprovider", *TESTS]
    passed = subprocess.run(command, cwd=ROOT, check=False).returncode == 0
    result = "passed" if passed else "FAILED"
    print(f"== {combination.name}: {result} in {time.monotonic() - start:.0f} s", flush=True)
    return passed


def main(names: list[str]) -> int:
    every = combinations()
    if names == ["--list"]:
        print(*(f"{c.name}: {c.python}" for c in every), sep="\n")
        return 0
    if unknown := [name for name in names if name not in [c.name for c in every]]:
        print(f"error: no combination {unknown[0]}; see --list", file=sys.stderr)
        return 2
    if len({c.version for c in every} | {sys.version_info[:2]}) == 1:
        print("skipped: no newer Python found", flush=True)
    results = [run(c) for c in every if not names or c.name in names]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
