"""``thorvaldc faults``: the table of reactions to faults, as Markdown and as JSON."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.conftest import Command
from thorvaldc.tools.fault_matrix import rehearsal
from thorvaldc.tools.fault_matrix.fault_matrix import FaultMatrix, FaultRow
from thorvaldc.tools.fault_matrix.fault_reaction import Reaction

ROBOT = """\
thorvaldc: 1
name: pair
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m}}
  l: {type: assembly/steered_drive, mount: frame.rear_left, can: 1}
  r: {type: assembly/steered_drive, mount: frame.rear_right, can: 2}
  a: {type: caster/swivel, mount: frame.front_left}
  b: {type: caster/swivel, mount: frame.front_right}
  battery: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0.397, 0.07]}, can: 1}
"""


@pytest.fixture(autouse=True)
def _robot(thorvaldc: Command) -> None:
    Path("pair.yaml").write_text(ROBOT, encoding="utf-8")


@pytest.mark.slow
def test_markdown(thorvaldc: Command) -> None:
    status, out, err = thorvaldc("faults", "pair.yaml", "--only", "EMCY", "-j", "1")
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "# Faults of the robot pair"
    assert "do not replace tests on the hardware" in lines[2]
    assert any(line.startswith("- SHA-256 of its model.json: `") for line in lines)
    table = [line for line in lines if line.startswith("|")]
    assert len({len(line) for line in table}) == 1, "the columns are aligned"
    cells = [cell.strip() for cell in table[2].split("|")[1:-1]]
    assert cells[:2] == ["EMCY message of a drive", "thorvald_roboteq"]
    assert cells[3] == "fault in 0.1 s; rest 0.0 s, 0.00 m"
    assert all(cell.startswith("fault in 0.1 s; rest ") for cell in cells[4:6])
    assert cells[-1] == "none"
    assert lines[-1] == "All promises are kept."


def test_json_names_the_model_of_the_build(thorvaldc: Command) -> None:
    status, out, _ = thorvaldc("faults", "pair.yaml", "--only", "SYNC", "--json", "-j", "1")
    result = json.loads(out)
    assert status == 0
    assert (result["robot"], result["simulated"], result["passed"]) == ("pair", True, True)
    (fault,) = result["faults"]
    driving = fault["phases"]["driving"]
    assert driving["reaction"] == "fault"
    assert "another master" in driving["reason"]
    assert driving["rest_time"] <= driving["promised"]["rest_time"]
    assert driving["rest_distance"] <= driving["promised"]["rest_distance"]
    assert thorvaldc("build", "pair.yaml", "--target", "urdf").status == 0
    manifest = json.loads(Path("build/pair/manifest.json").read_text(encoding="utf-8"))
    assert result["model_sha256"] in json.dumps(manifest)


def test_a_broken_promise_is_status_1(thorvaldc: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    late = Reaction("fault", 0.9, "no tpdo1", 1.3, 0.9, 0.4, 0.0)

    def rows(matrix: FaultMatrix, *arguments: object) -> list[FaultRow]:
        return [
            FaultRow(case, dict.fromkeys(case.phases, late), {"driving": ["too late"]})
            for case in matrix.cases
        ]

    monkeypatch.setattr(FaultMatrix, "rows", rows)
    status, out, _ = thorvaldc("faults", "pair.yaml", "--only", "EMCY", "-j", "1")
    assert status == 1
    assert "- EMCY message of a drive (thorvald_roboteq), driving: too late" in out


def test_a_robot_that_does_not_start_is_an_error(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rehearsal, "LONGEST_START", 0.5)
    status, out, err = thorvaldc("faults", "pair.yaml", "--only", "EMCY")
    assert (status, out) == (1, "")
    assert err.startswith("error: pair.yaml: the robot does not become ready")
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "status", "expected"),
    [
        (["pair.yaml", "--only", "explosion"], 2, "'explosion'; there are: power of"),
        (["pair.yaml", "-j", "x"], 2, "'x' is not a whole number"),
        (["pair.yaml", "--parameters", "nope"], 1, "nope"),
        (["bad.yaml"], 1, "cam"),
        (["nowhere.yaml"], 1, "nowhere.yaml"),
        (["bare.yaml"], 1, "bus-missing"),
    ],
)
def test_wrong_usage_and_wrong_files(
    thorvaldc: Command, arguments: list[str], status: int, expected: str
) -> None:
    without_battery = ROBOT[: ROBOT.index("  battery:")]
    bare = re.sub("can: [12]", "params: {controller: none}", without_battery)
    Path("bare.yaml").write_text(bare, encoding="utf-8")
    result = thorvaldc("faults", *arguments)
    assert result.status == status
    assert expected in result.out + result.err
