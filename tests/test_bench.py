"""The bench runs only on request; these tests detect modules that cannot be imported any more."""

from __future__ import annotations

import importlib
import pkgutil

import pytest

import bench
from bench.figure import Figure, in_turns
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
        (2.0, True, MachineLoad(0.5, 2.0), "holds"),
        (1.0, True, MachineLoad(0.95, 1.1), "FAILS"),
        (1.0, True, MachineLoad(0.85, 1.0), "unclear"),
        (1.0, True, MachineLoad(1.0, 1.3), "unclear"),
        (1.0, False, MachineLoad(0.5, 2.0), "FAILS"),
    ],
)
def test_missed_times_are_not_judged_on_a_busy_machine(
    bound: float | None, timed: bool, load: MachineLoad, verdict: str
) -> None:
    figure = Figure("figure", 1.5, "s", bound, "lower", "how", timed)
    assert figure.verdict(load.is_busy) == verdict


@pytest.mark.parametrize(
    ("ratio", "lower", "higher"),
    [(1.0, "holds", "FAILS"), (1.5, "unclear", "unclear"), (2.4, "FAILS", "holds")],
)
def test_a_ratio_is_judged_by_its_pairs_whatever_the_load(
    ratio: float, lower: str, higher: str
) -> None:
    loads = [1.0 + turn % 3 for turn in range(21)]
    pairs = [(ratio * load * (0.4 + 0.06 * turn), load) for turn, load in enumerate(loads)]
    for better, verdict in (("lower", lower), ("higher", higher)):
        figure = Figure.ratio("figure", 1.5, pairs, "how", better)
        assert figure.verdict(is_busy=True) == verdict
        assert figure.value == pytest.approx(ratio)


def test_functions_are_measured_in_turns_without_their_first_calls() -> None:
    calls: list[str] = []
    times = in_turns(lambda: calls.append("a"), lambda: calls.append("b"), rounds=2)
    assert "".join(calls) == "ababab"
    assert [len(each) for each in times] == [2, 2]
