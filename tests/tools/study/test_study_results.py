"""Sensitivities: closed forms, a variable without influence, and designs without a value."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pandas
import pytest

from tests.cli.conftest import GOOD
from tests.tools.study.test_search import write_study
from tests.tools.study.test_studies import Command, run
from thorvaldc.tools.study.study_results import sensitivities

__all__ = ["run"]

STUDY = """\
thorvaldc: 1
study: shares
robot: good.yaml
variables:
  track: {paths: [modules.frame.params.width], min: 0.8 m, max: 1.2 m}
  length: {paths: [modules.frame.params.length], min: 0.9 m, max: 1.6 m}
  words: {paths: [description], values: [red, green, blue]}
objectives:
  width: {fact: size.width, goal: minimise}
  mass: {fact: mass, goal: minimise}
samples: {method: saltelli, number: 16, seed: 2}
"""


def ishigami(x: float, y: float, z: float) -> float:
    return math.sin(x) + 7.0 * math.sin(y) ** 2 + 0.1 * z**4 * math.sin(x)


def table_of(number: int, missing: int) -> pandas.DataFrame:
    """Returns a table of the Ishigami function, whose indices are known in closed form."""
    from scipy.stats import qmc

    records, sample = [], 0
    points = qmc.Sobol(6, rng=1).random(number) * 2.0 * math.pi - math.pi
    for row in points.tolist():
        a, b = row[:3], row[3:]
        for point in [a, b, *([*a[:i], b[i], *a[i + 1 :]] for i in range(3))]:
            sample += 1
            status = "error" if sample <= 5 * missing and sample % 5 == 3 else "ok"
            records.append({"sample": sample, "status": status, "out": ishigami(*point)})
    table = pandas.DataFrame(records)
    table.attrs = {"method": "saltelli", "variables": ["x", "y", "z"], "objectives": {"out": ""}}
    return table


def test_indices_of_a_known_function() -> None:
    found = sensitivities(table_of(4096, missing=0))
    variance = 0.5 + 7.0**2 / 8.0 + 0.1 * math.pi**4 / 5.0 + 0.01 * math.pi**8 / 18.0
    own = [0.5 * (1.0 + 0.1 * math.pi**4 / 5.0) ** 2, 7.0**2 / 8.0, 0.0]
    both = 0.01 * math.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    totals = [own[0] + both, own[1], both]
    assert [index["variable"] for index in found] == ["x", "y", "z"]
    for index, first, total in zip(found, own, totals, strict=True):
        for name, share in (("alone", first / variance), ("with_others", total / variance)):
            low, high = index[f"{name}_interval"]
            assert abs(index[name] - share) < 0.02
            assert low <= share <= high
    assert sensitivities(table_of(4096, missing=0)) == found


def test_base_samples_without_a_value_are_left_out() -> None:
    found = sensitivities(table_of(64, missing=5))
    assert {(entry["samples"], entry["incomplete"]) for entry in found} == {(32, 5)}
    assert len(found) == 3
    (entry,) = sensitivities(table_of(16, missing=3))
    assert entry == {"objective": "out", "samples": 8, "incomplete": 3}
    rows = table_of(64, missing=0)  # a study that was stopped lacks rows
    attributes, rows = rows.attrs, rows.drop(index=[7])
    rows.attrs = attributes
    assert {entry["incomplete"] for entry in sensitivities(rows)} == {1}


@pytest.mark.slow
def test_a_study_states_what_matters(run: Command) -> None:
    Path("good.yaml").write_text(f"{GOOD}description: plain\n")
    write_study(STUDY)
    result = run("study", "run", "study.yaml", "-j", "1", "-o", "out")
    assert result.status == 0, result.err
    assert "80 ok" in result.out
    shown = json.loads(run("study", "show", "study.yaml", "--results", "out", "--json").out)[
        "sensitivity"
    ]
    shares = {(each["objective"], each["variable"]): each for each in shown}
    assert abs(shares["width", "track"]["with_others"] - 1.0) < 0.1
    assert shares["width", "length"]["with_others"] == 0.0
    assert shares["width", "words"]["with_others"] == 0.0
    # The mass of the frame is linear: the shares are those of the squares of the effects.
    alone = {name: shares["mass", name]["alone"] for name in ("track", "length", "words")}
    assert abs(alone["track"] + alone["length"] - 1.0) < 0.3
    assert alone["words"] == 0.0
    text = run("study", "show", "study.yaml", "--results", "out").out
    assert "shares of the variance" in text
    assert text == run("study", "show", "study.yaml", "--results", "out").out


@pytest.mark.slow
def test_an_objective_without_variance(run: Command) -> None:
    Path("good.yaml").write_text(f"{GOOD}description: plain\n")
    write_study(
        STUDY,
        ("size.width", "size.track"),
        ("  track: {paths: [modules.frame.params.width], min: 0.8 m, max: 1.2 m}\n", ""),
    )
    result = run("study", "run", "study.yaml", "-j", "1", "-o", "out")
    assert result.status == 0, result.err
    assert "width has no indices: its 16 complete base samples" in result.out
