"""Sweeps: independent of the number of processes, and kept after Ctrl-C."""

from __future__ import annotations

import csv
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from tests.child_process import ChildProcess
from tests.cli.conftest import Command, run_in_this_process
from thorvaldc.compiler.source.overrides import parse_choices
from thorvaldc.simulation.scenario_sweep import Sweep

ROOT = Path(__file__).resolve().parents[2]
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
"""
FRICTIONS = "world.friction=0.2,0.6"
MANY = "noise.seed=" + ",".join(map(str, range(800)))


@pytest.fixture
def thorvaldc(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Command:
    return run_in_this_process(monkeypatch, tmp_path)


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "s.yaml"
    path.write_text(SCENARIO)
    return path


def sweep(path: Path, *settings: str) -> Sweep:
    return Sweep(path, dict(map(parse_choices, settings)))


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_all_combinations_of_the_values(scenario: Path) -> None:
    faults = "faults=[],[{type: ice, wheel: fl_wheel, friction: 0.1}]"
    combinations = sweep(scenario, faults, "robots.cart.robot=a/b.yaml,../c.yaml")
    values = [{path: node.plain() for path, node in run.items()} for run in combinations]
    assert len(combinations) == 4
    assert [v["robots.cart.robot"] for v in values] == ["a/b.yaml", "../c.yaml"] * 2
    ice = [{"type": "ice", "wheel": "fl_wheel", "friction": 0.1}]
    assert [v["faults"] for v in values] == [[], [], ice, ice]


@pytest.mark.slow
def test_the_result_does_not_depend_on_the_processes(thorvaldc: Command, scenario: Path) -> None:
    tables = []
    angles = "faults.0.angle=-0.5 deg,0.5 deg"
    for jobs in ("1", "2"):
        out = scenario.with_name(f"{jobs}.csv")
        settings = ("--set", FRICTIONS, "--set", angles, "-j", jobs, "-o", str(out))
        result = thorvaldc("scenario", str(scenario), *settings)
        assert (result.status, result.err) == (0, "")
        assert "4 runs, all as expected" in result.out
        tables.append((result.out, out.read_bytes()))
    assert tables[0] == tables[1]
    listed = rows(scenario.with_name("1.csv"))
    assert [row["run"] for row in listed] == ["1", "2", "3", "4"]
    assert len({row["hash"] for row in listed}) == 4
    # The result equals that of the same run alone.
    settings = [f"--set={path}={listed[2][path]}" for path in ("world.friction", "faults.0.angle")]
    alone = thorvaldc("scenario", str(scenario), *settings, "--json")
    assert json.loads(alone.out)["hash"] == listed[2]["hash"]


def test_failed_runs_are_named_and_decide_the_status(thorvaldc: Command, scenario: Path) -> None:
    result = thorvaldc("scenario", str(scenario), "--set", "script.0.vx=0.5 m/s,1.6 m/s",
                       "--set", "faults=[]", "-j", "1")  # fmt: skip
    assert result.status == 0
    expected = ("--set", "expect.path.max=1 m,0.1 m", "-j", "1")
    result = thorvaldc("scenario", str(scenario), *expected)
    assert result.status == 1
    assert "2 runs, 1 not as expected" in result.out
    assert "run 2: error[TV820]: `path` of cart is" in result.err
    listed = json.loads(thorvaldc("scenario", str(scenario), *expected, "--json").out)
    assert [run["passed"] for run in listed] == [True, False]
    assert listed[1]["values"] == {"expect.path.max": "0.1 m"}
    assert listed[0]["result"]["metrics"]["cart"]["path"] > 0.1
    assert "real_time_factor" not in listed[0]["result"]["run"]


def test_invalid_values_are_reported_before_the_first_run(
    thorvaldc: Command, scenario: Path
) -> None:
    for setting, stderr in (
        ("world.friction=0.3,-1", "--set world.friction: error[TV206]"),
        ("world.friction=0.3,-1,0.5,0.6", "--set world.friction: error[TV206]"),
        ("noise.seed=1,3,2.5,2", "--set noise.seed: error[TV203]"),
        ("world.friction=0.1,0.2,x,0.4", "--set world.friction: error[TV210]"),
        ("world.friktion=0.3,0.4", "error[TV201] unknown-key"),
        ("faults.3.angle=1,2", "error[TV846] variation-path"),
        ("duration=1 s,two", "error[TV210]"),
    ):
        result = thorvaldc("scenario", str(scenario), "-j", "1", "--set", setting)
        assert result.status == 1, setting
        assert result.out == ""
        assert stderr in result.err


def test_variations_of_the_document_name_the_sweep(thorvaldc: Command, scenario: Path) -> None:
    scenario.write_text(SCENARIO + "variations: {vary: {world.friction: [0.2, 0.6]}}\n")
    result = thorvaldc("scenario", str(scenario))
    assert result.status == 1
    assert "has no key `variations`" in result.err
    assert "`thorvaldc scenario FILE --set world.friction=0.3,0.6`" in result.err


def test_wrong_options_are_usage_errors(thorvaldc: Command, scenario: Path) -> None:
    several = ["--set", FRICTIONS]
    for arguments in (
        [str(ROBOT), "--set", "driver.rate=20 Hz,50 Hz"],
        [str(scenario), "--set", "world.friction"],
        [str(scenario), "--set", "world.friction="],
        [str(scenario), *several, "--plot", "x.png"],
        [str(scenario), *(f"--set={path}={'1,' * 1000}1" for path in ("noise.seed", "duration"))],
        [str(scenario), *several, "--jobs", "none"],
        [str(scenario), *several, "-o", "x.txt"],
    ):
        assert thorvaldc("scenario", *arguments).status == 2, arguments
    assert thorvaldc("scenario", str(scenario), *several, "-o", "none/x.csv").status == 3


@pytest.mark.slow
def test_ctrl_c_keeps_the_finished_runs(scenario: Path) -> None:
    """The signal goes to all processes, as from a terminal."""
    out = scenario.with_name("out.csv")
    command = [sys.executable, "-m", "thorvaldc", "scenario", str(scenario), "-j", "2"]
    process = ChildProcess(
        [*command, "--set", MANY, "-o", str(out)],
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
    assert stdout.endswith(f"{len(result)} of 800 runs, 0 not as expected\n")


def test_a_killed_process_is_reported(scenario: Path) -> None:
    """The operating system may kill a process, for instance when memory is short."""
    runs = sweep(scenario, MANY).runs(2)
    first = next(runs)
    assert first.passed or first.errors
    victim = multiprocessing.active_children()[0]
    victim.kill()
    with pytest.raises(BrokenProcessPool, match="was killed"):
        list(runs)
