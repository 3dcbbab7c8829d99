"""The notebook of the documentation: it runs, and shows what it has recorded."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

import thorvaldc
from tests.cli.conftest import UNPOWERED
from thorvaldc.diagnostics import Report, Span
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from workshop.notebook import NOTEBOOK, cells_of

ROOT = Path(__file__).parents[2]


def without_numbers(cell: dict[str, Any]) -> str:
    """The outputs of a cell; physics of another MuJoCo may differ in the last digits."""
    return re.sub(r"-?\d[\d.]*", "#", json.dumps(cell.get("outputs", [])))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the packages of a study
def test_the_notebook_shows_what_it_has_recorded() -> None:
    recorded = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    present = cells_of(NOTEBOOK)
    for before, after in zip(recorded, present, strict=True):
        assert without_numbers(after) == without_numbers(before), "".join(before["source"])
    shown = [cell for cell in present if cell.get("outputs")]
    assert len(shown) == 5
    assert "<table" in json.dumps(shown[0]["outputs"])


def test_what_a_notebook_shows_of_results_and_errors() -> None:
    compilation = thorvaldc.compile(f"{UNPOWERED}nonsense: <b>\n")
    page = compilation._repr_html_()
    assert page.startswith("<pre>&lt;Compilation: no model, 1 error")
    assert "the robot document has no key `nonsense`" in page
    report = Report()
    report.add("unknown-key", "<script>", Span("a.yaml", 1))
    assert "&lt;script&gt;" in report._repr_html_()
    scenario = thorvaldc.compile(ROOT / "examples/odometry_experiment/ideal.yaml").scenario
    assert scenario is not None
    files = thorvaldc.emit(scenario.fleet, ["mjcf"])
    result = ScenarioSimulation(scenario, files).play(Report())
    assert result._repr_html_().startswith("<pre>")
    assert "true" in result.run._repr_html_()
