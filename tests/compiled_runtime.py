"""Tests of the compiled runtime alone; ``make compiled`` runs them in its copy of the checkout."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

from thorvaldc.cli.main import run_command
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from workshop.compiled_runtime import MODULES

ROOT = Path(__file__).resolve().parents[1]
SCENARIOS = ("scenarios/field_edge.yaml", "scenarios/rocker_bogie_steps.yaml")
INTERPRETED = f"""
import importlib.abc, importlib.util, json, sys
from pathlib import Path

class Source(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        file = Path({str(ROOT)!r}, *name.split("."))
        if name.startswith("thorvaldc.") and file.with_suffix(".py").is_file():
            return importlib.util.spec_from_file_location(name, file.with_suffix(".py"))
        return None

sys.meta_path.insert(0, Source())
from tests.compiled_runtime import results
import thorvaldc.runtime.driver
assert thorvaldc.runtime.driver.__file__.endswith(".py")
json.dump(results(), sys.stdout)
"""


def results() -> dict[str, list[object]]:
    """Returns the hash and the metrics of runs by the name of the scenario."""
    runs = {}
    for name in SCENARIOS:
        scenario = compile_file(ROOT / "examples" / name).scenario
        assert scenario is not None
        run = ScenarioSimulation(scenario, emit(scenario.fleet, ["mjcf"])).play(Report())
        runs[name] = [run.hash, repr(run.metrics)]
    return runs


@pytest.mark.parametrize("module", MODULES)
def test_a_module_of_a_tick_is_a_binary(module: str) -> None:
    imported = importlib.import_module(f"thorvaldc.{module.replace('/', '.')}")
    assert str(imported.__file__).endswith(tuple(EXTENSION_SUFFIXES))


def test_runs_have_the_hashes_of_the_interpreted_runtime() -> None:
    interpreted = subprocess.run(
        [sys.executable, "-c", INTERPRETED],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert interpreted.returncode == 0, interpreted.stderr
    assert json.loads(interpreted.stdout) == results()


def test_the_version_names_the_kind(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["thorvaldc", "--version"])
    assert run_command() == 0
    assert capsys.readouterr().out.endswith(" (compiled)\n")
