"""Sensitivities: closed forms, a variable without influence, and designs without a value."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import duckdb

from tests.cli.conftest import GOOD
from tests.tools.study.test_search import write_study
from tests.tools.study.test_studies import Command, run
from thorvaldc.tools.study.study_results import (
    DESCRIPTION,
    TABLE,
    StudyTable,
    sensitivities,
)

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


def table_of(folder: Path, number: int, missing: int) -> StudyTable:
    """Writes a table of the Ishigami function, whose indices are known in closed form."""
    from scipy.stats import qmc

    lines, sample = [], 0
    points = qmc.Sobol(6, rng=1).random(number) * 2.0 * math.pi - math.pi
    for row in points.tolist():
        a, b = row[:3], row[3:]
        for point in [a, b, *([*a[:i], b[i], *a[i + 1 :]] for i in range(3))]:
            sample += 1
            status = "error" if sample <= 5 * missing and sample % 5 == 3 else "ok"
            lines.append({"sample": sample, "status": status, "out": ishigami(*point)})
    folder.mkdir(exist_ok=True)
    (folder / "rows.json").write_text("\n".join(map(json.dumps, lines)))
    with duckdb.connect() as connection:
        connection.execute(f"COPY (FROM '{folder}/rows.json') TO '{folder / TABLE}'")
    description: dict[str, Any] = {"study": "ishigami", "method": "saltelli"}
    description |= {"variables": ["x", "y", "z"], "objectives": {"out": "minimise"}}
    description |= {"constraints": [], "scenarios": []}
    (folder / DESCRIPTION).write_text(json.dumps(description))
    return StudyTable.open(folder)


def test_indices_of_a_known_function(tmp_path: Path) -> None:
    (found,) = sensitivities(table_of(tmp_path, 4096, missing=0))
    variance = 0.5 + 7.0**2 / 8.0 + 0.1 * math.pi**4 / 5.0 + 0.01 * math.pi**8 / 18.0
    own = [0.5 * (1.0 + 0.1 * math.pi**4 / 5.0) ** 2, 7.0**2 / 8.0, 0.0]
    both = 0.01 * math.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    totals = [own[0] + both, own[1], both]
    assert [index.variable for index in found.indices] == ["x", "y", "z"]
    for index, first, total in zip(found.indices, own, totals, strict=True):
        assert abs(index.first_order - first / variance) < 0.02
        assert abs(index.total - total / variance) < 0.02
        assert index.first_order_interval[0] <= first / variance <= index.first_order_interval[1]
        assert index.total_interval[0] <= total / variance <= index.total_interval[1]
    assert sensitivities(table_of(tmp_path, 4096, missing=0)) == [found]


def test_base_samples_without_a_value_are_left_out(tmp_path: Path) -> None:
    (found,) = sensitivities(table_of(tmp_path, 64, missing=5))
    assert (found.samples, found.incomplete) == (32, 5)
    assert found.indices
    (found,) = sensitivities(table_of(tmp_path, 16, missing=3))
    assert (found.samples, found.incomplete, found.indices) == (8, 3, ())


def test_a_study_states_what_matters(run: Command) -> None:
    Path("good.yaml").write_text(f"{GOOD}description: plain\n")
    write_study(STUDY)
    result = run("study", "run", "study.yaml", "-j", "1", "-o", "out")
    assert result.status == 0, result.err
    assert "80 ok" in result.out
    shown = json.loads(run("study", "show", "out", "--json").out)["sensitivity"]
    width, mass = shown
    by_name = {index["variable"]: index for index in width["indices"]}
    assert abs(by_name["track"]["total"] - 1.0) < 0.1
    assert by_name["length"]["total"] == by_name["words"]["total"] == 0.0
    # The mass of the frame is linear: the shares are those of the squares of the effects.
    shares = {index["variable"]: index["first_order"] for index in mass["indices"]}
    assert abs(shares["track"] + shares["length"] - 1.0) < 0.3
    assert shares["words"] == 0.0
    text = run("study", "show", "out").out
    assert "shares of the variance" in text
    assert text == run("study", "show", "out").out


def test_an_objective_without_variance(run: Command) -> None:
    Path("good.yaml").write_text(f"{GOOD}description: plain\n")
    write_study(
        STUDY,
        ("size.width", "size.track"),
        ("  track: {paths: [modules.frame.params.width], min: 0.8 m, max: 1.2 m}\n", ""),
    )
    result = run("study", "run", "study.yaml", "-j", "1", "-o", "out")
    assert result.status == 0, result.err
    assert "width has the same value in all designs." in result.out
