"""The bench runs only on request; these tests detect modules that cannot be imported any more."""

from __future__ import annotations

import importlib
import pkgutil

import pytest

import bench
from bench.figure import Figure
from bench.machine_load import MachineLoad

MODULES = [m.name for m in pkgutil.iter_modules(bench.__path__) if m.name != "__main__"]


@pytest.mark.parametrize("name", MODULES)
def test_module_of_the_bench_can_be_imported(name: str) -> None:
    importlib.import_module(f"bench.{name}")


@pytest.mark.parametrize(
    ("bound", "timed", "load", "verdict"),
    [
        (None, True, MachineLoad(1.0, 1.0), "info"),
        (2.0, True, MachineLoad(0.95, 1.1), "holds"),
        (1.0, True, MachineLoad(0.95, 1.1), "FAILS"),
        (1.0, True, MachineLoad(0.85, 1.0), "busy"),
        (2.0, True, MachineLoad(1.0, 1.3), "busy"),
        (1.0, False, MachineLoad(0.5, 2.0), "FAILS"),
    ],
)
def test_times_are_not_judged_on_a_busy_machine(
    bound: float | None, timed: bool, load: MachineLoad, verdict: str
) -> None:
    figure = Figure("figure", 1.5, "s", bound, "lower", "how", timed)
    assert figure.verdict(load.is_busy) == verdict
