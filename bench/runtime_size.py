"""What a robot's computer installs and loads: megabytes on the disk, lines of Python in memory."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.figure import EXAMPLE, Figure
from tests.packaging import runtime_environment
from thorvaldc.compiler.pipeline import compile_file, emit

# Loads what `thorvaldc run model.json` loads, up to the missing bus, and counts lines of source.
COUNT = """
import pathlib, sys
from thorvaldc.cli.main import run
sys.argv = ["thorvaldc", "run", "model.json", "--bus", "sim:nobody"]
try:
    run()
except SystemExit:
    pass
files = [m.__file__ for n, m in list(sys.modules.items()) if n.split(".")[0] == "thorvaldc"]
print(sum(pathlib.Path(f).read_text().count("\\n") for f in files if f))
"""


def figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wheel = runtime_environment.build_wheel(folder)
        home = folder / "robot_computer"
        bin_folder = runtime_environment.create(home, wheel)
        (site,) = (home / "lib").glob("python*/site-packages")
        files = [f for f in site.rglob("*") if f.is_file() and f.suffix != ".pyc"]
        installed = sum(f.stat().st_size for f in files)
        own = sum(f.stat().st_size for f in files if f.is_relative_to(site / "thorvaldc"))
        model = compile_file(EXAMPLE).model
        assert model is not None
        (folder / "model.json").write_bytes(emit(model, ["can"])["model.json"])
        counted = subprocess.run(
            [str(bin_folder / "python"), "-c", COUNT],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": ""},
            capture_output=True,
            text=True,
            check=False,
        )
        lines = int(counted.stdout.split()[-1])
    yield Figure(
        "runtime installed",
        installed / 1e6,
        "MB",
        None,
        "lower",
        f"thorvaldc-runtime with python-can and typer, without bytecode; {own / 1e6:.1f} MB of it"
        " are ours",
    )
    yield Figure(
        "lines loaded by a run",
        lines,
        "",
        None,
        "lower",
        "Python lines of thorvaldc in memory after `thorvaldc run model.json` looked for its bus",
    )
