"""The compiler, the targets and the data of the 3D page where numpy is not installed.

The page of the browser runs this code in Python without numpy.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

from tests.cli.conftest import needs_tools
from tests.examples import FOLDER, robot_with_meshes

ROOT = Path(__file__).parents[2]
EXAMPLES = (
    FOLDER / "4wd2ws_tall/robot.yaml",  # with a xacro file
    FOLDER / "scenarios/field_edge.yaml",  # with a world
)
MISSING = ("numpy", "trimesh", "aiohttp", "watchfiles", "resource")
MODULES = (
    "thorvaldc.tools.preview.compiled_robot",
    "thorvaldc.runtime.driver",
    "thorvaldc.simulation.physics.mujoco_scene",
    "thorvaldc.simulation.physics.mujoco_base",
    "thorvaldc.simulation.physics.drive_servos",
)
SCRIPT = f"""
import importlib, json, sys
for name in {MISSING!r}:
    sys.modules[name] = None
for name in {MODULES!r}:
    importlib.import_module(name)
from tests.simulation.test_without_numpy import products
json.dump({{name: products(name) for name in sys.argv[1:]}}, sys.stdout)
"""


def products(file: str) -> dict[str, str]:
    """Returns hashes of the files of all targets, of the page data and of the facts."""
    from thorvaldc.backends import TARGETS
    from thorvaldc.compiler.pipeline import compile_file, emit
    from thorvaldc.model import Fleet
    from thorvaldc.model.facts.fact_tables import fact_tables
    from thorvaldc.model.facts.robot_facts import robot_facts
    from thorvaldc.simulation.web_viewer import page_data

    compilation = compile_file(file)
    model = compilation.model
    assert model is not None, [d.message for d in compilation.report]
    robots = [p.robot for p in model.placements] if isinstance(model, Fleet) else [model]
    tables = [asdict(table) for robot in robots for table in fact_tables(robot_facts(robot))]
    files = {
        **emit(model, tuple(TARGETS)),
        "page data": json.dumps(page_data(model, None, compilation.ports)).encode(),
        "facts": json.dumps(tables).encode(),
        "diagnostics": repr(compilation.report.sorted()).encode(),
    }
    return {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}


@pytest.mark.slow
@needs_tools
def test_all_products_are_the_same_without_numpy(tmp_path: Path) -> None:
    for name, data in robot_with_meshes().items():
        (tmp_path / name).write_bytes(data)
    files = [*map(str, EXAMPLES), str(tmp_path / "robot.yaml")]
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, *files],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout) == {name: products(name) for name in files}
