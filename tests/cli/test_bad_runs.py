"""Runs that fail: the message, the exit status, and records that are kept."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from contextlib import ExitStack
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from tests.child_process import ChildProcess
from tests.cli.conftest import Command
from tests.cli.test_terminal import on_terminal
from tests.full_disk import full_disk
from tests.outside_tools import require
from thorvaldc.cli.diagnostic_output import Progress
from thorvaldc.simulation.control_loop import ControlLoop

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SLIM, TALL = EXAMPLES / "4wd4ws_slim/robot.yaml", EXAMPLES / "4wd2ws_tall/robot.yaml"
SCENARIO = """thorvaldc: 1
scenario: trial
robots: {{cart: {{robot: {robot}}}}}
duration: {duration} s
world: {{ground: {{type: {ground}}}, friction: {friction}}}
script: [{{at: 0, vx: 0.8 m/s}}]
"""
STIFF = """thorvaldc: 1
name: stiff
defaults: {drive: {stiffness: 50 GN/m, damping: 0}}
modules:
  frame: {type: frame/tube_rectangular}
  fl: {type: assembly/suspended_steered_drive, mount: frame.front_left}
  fr: {type: assembly/suspended_steered_drive, mount: frame.front_right}
  rl: {type: assembly/suspended_steered_drive, mount: frame.rear_left}
  rr: {type: assembly/suspended_steered_drive, mount: frame.rear_right}
"""


def scenario(
    robot: Path | str = SLIM,
    duration: float = 1,
    ground: str = "plane",
    friction: float = 0.8,
) -> str:
    text = SCENARIO.format(robot=robot, duration=duration, ground=ground, friction=friction)
    Path("s.yaml").write_text(text)
    return "s.yaml"


def last_time(record: str) -> float:
    """Returns the time in the last line of a CSV file; checks that the lines are complete."""
    head, *rows = Path(record).read_text().splitlines()
    assert all(row.count(",") == head.count(",") for row in rows)
    return float(rows[-1].split(",")[0])


def test_errors_of_scenario_and_robot_are_reported_together(thorvaldc: Command) -> None:
    result = thorvaldc("sim", scenario("bad.yaml", ground="swamp"), "--record", "r.mcap")
    assert (result.status, result.out) == (1, "")
    assert "bad.yaml:" in result.err
    assert "`type` cannot be `swamp`" in result.err
    assert "allowed values are `plane`, `slope`, `rough`" in result.err
    assert not Path("r.mcap").exists()


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [
        ("--record", "none/r.mcap", "No such file or directory"),
        ("--record", "folder.mcap", "Is a directory"),
        ("--record", "s.yaml", "it is a file; name a folder, or a .mcap file"),
        ("--record", "full", "No space left on device"),
        ("--record", "full/cart.csv", "No space left on device"),
        ("--log", "none/l.csv", "No such file or directory"),
        ("--junit", "none/j.xml", "No such file or directory"),
        ("--plot", "none/p.png", "No such file or directory"),
        ("--video", "none/v.gif", "No such file or directory"),
    ],
)
def test_an_output_that_cannot_be_written_is_reported_before_the_run(
    thorvaldc: Command, option: str, value: str, expected: str
) -> None:
    Path("folder.mcap").mkdir()
    Path("full").mkdir()
    Path("full/cart.csv").symlink_to("/dev/full")
    result = thorvaldc("scenario", scenario(duration=80000), option, value)
    assert (result.status, result.out) == (3, "")
    assert result.err.startswith("error: cannot write ")
    assert value in result.err
    assert expected in result.err
    assert result.err.count("\n") == 1


@pytest.mark.parametrize("option", ["--record", "--log"])
@pytest.mark.parametrize("name", ["r.csv", "r.mcap"])
def test_a_full_disk_is_reported_with_the_name_of_the_file(
    thorvaldc: Command, monkeypatch: pytest.MonkeyPatch, option: str, name: str
) -> None:
    """No file may grow beyond a limit after the first tick.

    The record of an earlier run stays as it was, and the content so far is kept beside it.
    """
    Path(name).write_text("an earlier run")
    with ExitStack() as stack:

        def watch(self: Progress, meter: ControlLoop) -> None:
            stack.enter_context(full_disk(20000))

        monkeypatch.setattr(Progress, "watch", watch)
        result = thorvaldc("sim", scenario(duration=60), option, name)
    assert (result.status, result.out) == (3, "")
    assert result.err == f"error: {name}: File too large\n"
    assert 5000 < Path(f"{name}.incomplete").stat().st_size <= 20000
    assert Path(name).read_text() == "an earlier run"
    assert not list(Path().glob(".*"))


@pytest.mark.slow
def test_a_robot_that_tips_over_is_reported_and_recorded(thorvaldc: Command) -> None:
    path = scenario(TALL, 40, "slope, angle: 58 deg, direction: 90 deg", 4.5)
    result = thorvaldc("scenario", path, "--record", "r.csv", "--junit", "j.xml", "--plot", "p.png")
    assert result.status == 1
    assert "cart fell over to its right after 1." in result.err
    assert "ended after 1." in result.out
    failure = ET.parse("j.xml").getroot().find(".//failure")
    assert failure is not None
    assert "fell over" in str(failure.get("message"))
    assert 1.0 < last_time("r.csv") < 2.0
    assert Path("p.png").stat().st_size > 1000


def test_a_diverged_robot_is_reported_with_time_and_cause(thorvaldc: Command) -> None:
    Path("stiff.yaml").write_text(STIFF)
    text = Path(scenario()).read_text()
    Path("s.yaml").write_text(
        text.replace("}}\nduration", "}, wild: {robot: stiff.yaml, xyz: [0, 5, 0]}}\nduration")
    )
    result = thorvaldc("sim", "s.yaml", "--record", "r.mcap")
    assert result.status == 1
    assert "stiff.yaml:2:7: error[TV805]" in result.err
    assert "after 0.0" in result.err
    assert "the joint `wild/" in result.err
    with AnyReader([Path("r.mcap")]) as record:
        assert "/wild/odom" in {connection.topic for connection in record.connections}


CTRL_C = (signal.SIGINT, 130, "interrupted\n")
KILL = (signal.SIGTERM, 143, "terminated\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("record", "end"),
    [
        ("r.csv", CTRL_C),
        ("r.mcap", KILL),
        pytest.param("r.csv", KILL, marks=pytest.mark.exhaustive),
        pytest.param("r.mcap", CTRL_C, marks=pytest.mark.exhaustive),
    ],
)
def test_a_terminated_run_leaves_a_readable_record(
    thorvaldc: Command, record: str, end: tuple[int, int, str]
) -> None:
    number, status, expected = end
    path = scenario(duration=80000)
    command = [sys.executable, "-m", "thorvaldc", "sim", path, "--record", record]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with ChildProcess(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        deadline = time.monotonic() + 300
        while time.monotonic() < deadline and _written() < 20_000:
            time.sleep(0.02)
        process.send_signal(number)
        try:
            out, err = process.communicate(timeout=300)
        finally:
            process.kill()
    assert (process.returncode, out, err) == (status, "", expected)
    assert not list(Path().glob(".*"))
    if record.endswith(".csv"):
        assert last_time(record) > 0.1
    else:
        with AnyReader([Path(record)]) as reader:
            assert reader.duration > 1e8  # ns
            assert len([*reader.messages()]) == reader.message_count


def _written() -> int:
    """Size of the unfinished record: a CSV file under a temporary name, MCAP in a folder."""
    names = (".thorvaldc-*", "record.mcap")
    return sum(p.stat().st_size for name in names for p in Path().rglob(name) if p.is_file())


@pytest.mark.slow
def test_the_progress_of_a_video_is_shown(tmp_path: Path, thorvaldc: Command) -> None:
    require("OpenGL")
    scenario()
    status, output = on_terminal(tmp_path, "sim", "s.yaml", "--video", "v.gif", COLUMNS="40")
    assert status == 0
    assert "[##############################] 100 %" in output
    assert "v.gif [#######" in output
    bars = [part for part in output.replace("\x1b[K", "\r").split("\r") if "%" in part]
    assert len(bars) > 20
    assert max(map(len, bars)) < 40


def test_progress_is_shown_on_a_terminal_only(tmp_path: Path, thorvaldc: Command) -> None:
    result = thorvaldc("sim", "good.yaml", "--twist", "1,0,0", "--duration", "1", "--record", "r")
    assert "%" not in result.err
    _, output = on_terminal(tmp_path, "sim", "good.yaml", "--ideal", "--duration", "1")
    assert "1.0 of 1 s" in output
