"""Variations of a scenario: independent of the number of processes, and kept after Ctrl-C."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import Command
from thorvaldc.compiler.scenario.variations import Variations, plan_variations
from thorvaldc.diagnostics import Report
from thorvaldc.tools.batch.scenario_batch import Batch

ROOT = Path(__file__).resolve().parents[3]
ROBOT = ROOT / "examples/4wd4ws_slim/robot.yaml"
SCENARIO = f"""thorvaldc: 1
scenario: short
robots: {{cart: {{robot: {ROBOT}}}}}
duration: 1 s
world: {{friction: 0.5}}
noise: {{seed: 3, steering_angle: 0.2 deg}}
script: [{{at: 0, vx: 0.5 m/s, wz: 0.2}}]
faults: [{{type: steering_offset, wheel: fl_wheel, angle: 0.1 deg}}]
expect: {{path: {{max: 1 m}}, collisions: {{max: 0}}}}
variations:
  vary:
    world.friction: [0.2, 0.6]
    faults.0.angle: {{min: -1 deg, max: 1 deg}}
  draws: 2
  seed: 4
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "s.yaml"
    path.write_text(SCENARIO)
    return path


def planned(path: Path, *settings: str, **more: Any) -> Variations:
    report = Report()
    variations = plan_variations(path, settings, **more, report=report)
    assert not report.has_errors, [d.message for d in report]
    assert variations is not None
    return variations


def values(variations: Variations) -> list[dict[str, Any]]:
    return [{c.path: c.value.plain() for c in changes} for changes in variations.runs()]


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_combinations_and_draws(scenario: Path) -> None:
    variations = values(planned(scenario))
    assert [v["world.friction"] for v in variations] == [0.2, 0.2, 0.6, 0.6]
    # A draw has the same values in every combination, and its own noise seed.
    assert [v["noise.seed"] for v in variations] == [3, 4, 3, 4]
    angles = [v["faults.0.angle"] for v in variations]
    assert angles[:2] == angles[2:]
    assert angles[0] != angles[1]
    assert all(a.endswith(" deg") and abs(float(a.split()[0])) < 1.0 for a in angles)
    assert values(planned(scenario, seed=5)) != variations
    # The drawn values of a path do not depend on the other paths.
    other_values = values(planned(scenario, "world.friction=0.1", "duration=1 s,2 s"))
    assert {v["faults.0.angle"] for v in other_values} == set(angles)


def test_settings_replace_the_variations_of_the_document(scenario: Path) -> None:
    assert values(planned(scenario, "world.friction=0.3..0.9", draws=1, from_document=False)) != []
    faults = "faults=[],[{type: ice, wheel: fl_wheel, friction: 0.1}]"
    robots = "robots.cart.robot=a/b.yaml,../c.yaml"
    variations = values(planned(scenario, faults, robots, from_document=False))
    assert [v["robots.cart.robot"] for v in variations] == ["a/b.yaml", "../c.yaml"] * 2
    assert [v["faults"] for v in variations[::2]] == [
        [],
        [{"type": "ice", "wheel": "fl_wheel", "friction": 0.1}],
    ]
    seeds = values(planned(scenario, "noise.seed=1..1000", draws=40, from_document=False))
    assert len({v["noise.seed"] for v in seeds}) > 30
    assert all(isinstance(v["noise.seed"], int) and 1 <= v["noise.seed"] <= 1000 for v in seeds)


def test_the_result_does_not_depend_on_the_processes(thorvaldc: Command, scenario: Path) -> None:
    tables = []
    for jobs in ("1", "2"):
        out = scenario.with_name(f"{jobs}.csv")
        result = thorvaldc("batch", str(scenario), "--variations", "-j", jobs, "-o", str(out))
        assert (result.status, result.err) == (0, "")
        assert "4 runs, all as expected" in result.out
        tables.append((result.out, out.read_bytes()))
    assert tables[0] == tables[1]
    listed = rows(scenario.with_name("1.csv"))
    assert [row["run"] for row in listed] == ["1", "2", "3", "4"]
    assert len({row["hash"] for row in listed}) == 4
    # The result equals that of the same run outside a batch.
    third = listed[2]
    settings = [f"--set={path}={third[path]}" for path in
                ("world.friction", "faults.0.angle", "noise.seed")]  # fmt: skip
    alone = thorvaldc("scenario", str(scenario), *settings, "--json")
    assert json.loads(alone.out)["hash"] == third["hash"]


def test_failed_runs_are_named_and_decide_the_status(thorvaldc: Command, scenario: Path) -> None:
    out = scenario.with_name("out.json")
    result = thorvaldc("batch", str(scenario), "--set", "script.0.vx=0.5 m/s,1.6 m/s",
                     "--set", "faults=[]", "-j", "1", "-o", str(out))  # fmt: skip
    assert result.status == 0
    result = thorvaldc("batch", str(scenario), "--set", "expect.path.max=1 m,0.1 m", "-j", "1",
                     "-o", str(out))  # fmt: skip
    assert result.status == 1
    assert "2 runs, 1 not as expected" in result.out
    assert "run 2: error[TV820]: `path` of cart is" in result.err
    listed = json.loads(out.read_text())
    assert [run["passed"] for run in listed] == [True, False]
    assert listed[1]["values"] == {"expect.path.max": "0.1 m"}
    assert listed[0]["result"]["metrics"]["cart"]["path"] > 0.1
    assert "real_time_factor" not in listed[0]["result"]["run"]


def test_invalid_values_are_reported_before_the_first_run(
    thorvaldc: Command, scenario: Path
) -> None:
    for settings, stderr in (
        (["world.friction=0.3,-1"], "--set world.friction:1:1: error[TV206]"),
        (["world.friktion=0.3"], "error[TV201] unknown-key"),
        (["world.friction=0.9..0.3"], "error[TV847] variation-value"),
        (["world.friction=0.3 m..0.5"], "error[TV847] variation-value"),
        (["world.friction="], "error[TV847] variation-value"),
        (["faults.3.angle=1"], "error[TV846] variation-path"),
        (["duration=1 s,two"], "error[TV210]"),
        (["noise.seed=1..9", "--draws", "200000"], "at most 100000"),
    ):
        result = thorvaldc("batch", str(scenario), "-j", "1", "--set", *settings)
        assert result.status == 1, settings
        assert result.out == ""
        assert stderr in result.err
    text = SCENARIO.replace("[0.2, 0.6]", "[0.2, slippery]")
    scenario.write_text(text)
    result = thorvaldc("batch", str(scenario), "--variations")
    assert result.status == 1
    assert "s.yaml:12:27: error[TV" in result.err


def test_wrong_options_are_usage_errors(thorvaldc: Command, scenario: Path) -> None:
    several = ["--set", "world.friction=0.2,0.3"]
    for arguments in (
        [str(ROBOT), *several],
        [str(scenario), "--set", "world.friction"],
        [str(scenario), *several, "--plot", "x.png"],
        [str(scenario), *several, "--jobs", "none"],
        [str(scenario), *several, "-o", "x.txt"],
    ):
        assert thorvaldc("batch", *arguments).status == 2, arguments
    assert thorvaldc("batch", str(scenario), *several, "-o", "none/x.csv").status == 3


def test_ctrl_c_keeps_the_finished_runs(scenario: Path) -> None:
    """The signal goes to all processes, as from a terminal."""
    out = scenario.with_name("out.csv")
    scenario.write_text(SCENARIO.replace("draws: 2", "draws: 400"))
    command = [sys.executable, "-m", "thorvaldc", "batch", str(scenario), "--variations", "-j", "2"]
    process = ChildProcess(
        [*command, "-o", str(out)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": ":".join(p for p in sys.path if p)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        end = time.monotonic() + 300.0
        while (not out.exists() or len(out.read_bytes().splitlines()) < 4) and (
            time.monotonic() < end
        ):
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGINT)
        stdout, stderr = process.communicate(timeout=300)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 130
    assert stderr.splitlines()[-1] == "interrupted", stderr
    assert "Traceback" not in stderr
    result = rows(out)
    assert 3 <= len(result) < 800
    assert f"{len(result)} of 800 runs are done" in stderr
    numbers = [int(row["run"]) for row in result]
    assert numbers == sorted(numbers)
    assert all(len(row["hash"]) == 64 for row in result)
    assert stdout.count("\n") == len(result) + 2


def test_a_killed_process_is_reported(scenario: Path) -> None:
    """The operating system may kill a process, for instance when memory is short."""
    scenario.write_text(SCENARIO.replace("draws: 2", "draws: 400"))
    batch = Batch(scenario, planned(scenario))
    import multiprocessing
    from concurrent.futures.process import BrokenProcessPool

    runs = batch.runs(2)
    first = next(runs)
    assert first.passed or first.errors
    victim = multiprocessing.active_children()[0]
    victim.kill()
    with pytest.raises(BrokenProcessPool, match="was killed"):
        list(runs)
