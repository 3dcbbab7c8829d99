"""Replays: a record gives the same table, plot and video as its run."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import Command, run_in_this_process
from tests.slow import mostly_slow
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.model.scenario import GROUPS
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.records.mcap_writer import McapRecorder
from thorvaldc.simulation.records.record_reader import read_record
from thorvaldc.tools.pictures.picture_commands import has_display, parse_record_time
from thorvaldc.tools.pictures.replay import Replay

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
FLEET = str(EXAMPLES / "fleet_of_four/fleet.yaml")
SLIM = str(EXAMPLES / "4wd4ws_slim/robot.yaml")
SCENARIO = f"""thorvaldc: 1
scenario: bumps
robots: {{cart: {{robot: {SLIM}, xyz: [1, 2, 0], yaw: 2}}}}
duration: 3 s
world: {{ground: {{type: rough, amplitude: 40 mm, seed: 3, size: [20, 20]}}}}
script: [{{at: 0, vx: 0.8 m/s, wz: 0.4 rad/s}}]
"""


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of s.yaml with its records a.mcap and a.csv, its plot run.svg and its result."""
    folder = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as monkeypatch:
        thorvaldc = run_in_this_process(monkeypatch, folder)
        Path("s.yaml").write_text(SCENARIO)
        run = thorvaldc("sim", "s.yaml", "--record", "a.csv", "--json")
        other = thorvaldc("sim", "s.yaml", "--record", "a.mcap", "--plot", "run.svg")
    assert other.status == run.status == 0
    (folder / "run.json").write_text(run.out)
    return folder


@pytest.fixture
def recorded(thorvaldc: Command, run_folder: Path, tmp_path: Path) -> dict[str, Any]:
    """Copies the files of the run to the working folder; returns its result."""
    shutil.copytree(run_folder, tmp_path, dirs_exist_ok=True)
    run_summary: dict[str, Any] = json.loads(Path("run.json").read_text())
    return run_summary


@pytest.mark.parametrize("record", ["a.mcap", "a.csv"])
def test_a_replay_equals_its_run(thorvaldc: Command, recorded: dict[str, Any], record: str) -> None:
    result = thorvaldc("replay", "s.yaml", record, "--json")
    assert result.status == 0, result.err
    played = json.loads(result.out)
    assert (played["physics"], played["simulated"]) == ("record", 3.0)
    (run_robot,), (replay_robot,) = recorded["run"]["robots"], played["robots"]
    for key in ("path_true", "path_odometry", "end_error", "yaw_error", "largest_tilt"):
        assert replay_robot[key] == pytest.approx(run_robot[key], rel=1e-4, abs=1e-7), key
    for pose in ("pose_true", "pose_odometry"):
        assert replay_robot[pose] == pytest.approx(run_robot[pose], abs=1e-6)


def test_records_are_converted_without_loss(thorvaldc: Command, recorded: dict[str, Any]) -> None:
    assert thorvaldc("replay", "s.yaml", "a.mcap", "--record", "b.csv").status == 0
    assert Path("b.csv").read_bytes() == Path("a.csv").read_bytes()


@pytest.mark.parametrize("record", mostly_slow(["a.mcap", "a.csv"], slow=0))
def test_robots_have_their_recorded_poses(
    thorvaldc: Command, recorded: dict[str, Any], record: str
) -> None:
    """Every wheel is on the rough ground, at the depth that it had in the run."""
    result = compile_file("s.yaml")
    assert result.scenario is not None
    fleet = result.scenario.fleet
    robots = [(p.name, p.robot) for p in fleet.placements]
    report = Report()
    runs = read_record(Path(record), robots, report)
    assert runs is not None, [d.message for d in report]
    scene = MujocoScene(emit(fleet, ["mjcf"], report))
    heights_seen = []
    replay = Replay(scene, robots, runs)
    for number, _ in enumerate(replay.scenes(2.0)):
        time = number / 2.0
        sample = max((s for s in runs["cart"].samples if s.time <= time), key=lambda s: s.time)
        position = scene.data.qpos[:7].tolist()
        assert position[:3] == pytest.approx([*sample.pose_true[:2], sample.posture[0]])
        touching = {int(c.geom[1]) for c in scene.data.contact[: scene.data.ncon]}
        heights_seen.append(len(touching))
    assert len(heights_seen) == 7
    assert min(heights_seen) >= 3
    heights = [sample.posture[0] for sample in runs["cart"].samples]
    assert max(heights) - min(heights) > 0.005
    joint = scene.index("joint", "cart/fl_steering_joint", robots[0][1])
    joints = runs["cart"].samples[-1].joints
    assert joints is not None
    assert scene.data.qpos[scene.model.jnt_qposadr[joint]] == pytest.approx(joints.angles[0])
    assert abs(joints.angles[0]) > 0.1


def test_a_record_is_plotted(thorvaldc: Command, recorded: dict[str, Any]) -> None:
    result = thorvaldc("replay", "s.yaml", "a.mcap", "--plot", "p.svg")
    assert result.status == 0, result.err
    assert result.err == "p.svg\n"
    # The same lines but for the last digits of headings, which went through quaternions.
    played, run = Path("p.svg").read_text().split(), Path("run.svg").read_text().split()
    assert len(played) == len(run)
    assert sum(a != b for a, b in zip(played, run, strict=True)) < len(run) / 100


def test_videos_and_pictures_show_the_recorded_poses(thorvaldc: Command, tmp_path: Path) -> None:
    assert thorvaldc("sim", SLIM, "--ideal", "--duration", "0.6", "--record", "a.mcap").status == 0
    result = thorvaldc("replay", SLIM, "a.mcap", "--video", "v.gif")
    assert result.status == 0, result.err
    from PIL import Image

    with Image.open("v.gif") as film:
        assert getattr(film, "n_frames", 1) == math.floor(0.6 * 12.5) + 1
    small = ["--size", "64x48", "--view", "top", "--replay", "a.mcap", "-o", "p.png"]
    pictures = []
    for options in ([], ["--at", "0.1 s"], ["--at", "99"]):
        result = thorvaldc("render", SLIM, *small, *options)
        assert result.status == 0, result.err
        pictures.append(Path("p.png").read_bytes())
    assert pictures[0] == pictures[2] != pictures[1]
    assert thorvaldc("render", SLIM, "--at", "1").status == 2
    assert thorvaldc("render", SLIM, "--replay", "a.mcap", "--at", "-1").status == 2
    assert thorvaldc("render", SLIM, "--replay", "none.mcap").status == 1


def test_fleets_are_replayed_from_a_folder_and_a_file(thorvaldc: Command, tmp_path: Path) -> None:
    short = ["--twist", "0.5,0,0", "--duration", "0.3"]
    tables = []
    for record in ("all", "all.mcap"):
        assert thorvaldc("sim", FLEET, *short, "--record", record).status == 0
        result = thorvaldc("replay", FLEET, record)
        assert result.status == 0, result.err
        tables.append(result.out)
    assert tables[0] == tables[1]
    Path("all/six.csv").unlink()
    result = thorvaldc("replay", FLEET, "all")
    assert result.status == 1
    assert "`all` has no robot six" in result.err


def test_missing_groups_are_dashes(thorvaldc: Command, tmp_path: Path) -> None:
    Path("s.yaml").write_text(SCENARIO.replace("3 s", "0.3 s") + "record: {what: [odometry]}\n")
    for record in ("a.csv", "a.mcap"):
        assert thorvaldc("sim", "s.yaml", "--record", record).status == 0
        result = thorvaldc("replay", "s.yaml", record)
        assert result.status == 0, result.err
        assert result.out.splitlines()[1].split()[-6:-4] == ["-", "-"]
        assert result.out.splitlines()[1].split()[-2:] == ["-", "-"]


def test_a_record_without_samples_is_an_error(thorvaldc: Command, tmp_path: Path) -> None:
    result = compile_file(SLIM)
    assert isinstance(result.model, Robot)
    McapRecorder(Path("a.mcap"), [(result.model.name, result.model)], GROUPS).close()
    result = thorvaldc("replay", SLIM, "a.mcap")
    assert result.status == 1
    assert "`a.mcap` has no samples of thorvald_4wd4ws_slim" in result.err


def test_files_that_are_no_records_are_errors(thorvaldc: Command, tmp_path: Path) -> None:
    assert thorvaldc("sim", SLIM, "--ideal", "--duration", "1", "--record", "a.mcap").status == 0
    whole = Path("a.mcap").read_bytes()
    broken = bytearray(whole)
    broken[len(whole) // 4 : len(whole) // 2] = bytes(len(whole) // 2 - len(whole) // 4)
    for name, content, expected in (
        ("cut", whole[: len(whole) // 2], "mcap recover"),
        ("broken", bytes(broken), "mcap recover"),
        ("empty", b"", "seems to be empty"),
        ("other", b"no bag at all", "cannot be read as a ROS bag"),
    ):
        path = Path(f"{name}.mcap")
        path.write_bytes(content)
        result = thorvaldc("replay", SLIM, str(path))
        assert (result.status, result.out) == (1, ""), name
        assert "error[TV821]" in result.err
        assert expected in result.err
    result = thorvaldc("replay", SLIM, "none.mcap")
    assert result.status == 1
    assert "does not exist" in result.err
    other_robot = str(EXAMPLES / "6wd6ws/robot.yaml")
    result = thorvaldc("replay", other_robot, "a.mcap")
    assert result.status == 1
    assert "error[TV822]" in result.err
    assert "is it the record of another robot?" in result.err


@pytest.mark.parametrize(
    ("system", "variables", "expected"),
    [
        ("linux", {}, False),
        ("linux", {"DISPLAY": ":0"}, True),
        ("linux", {"WAYLAND_DISPLAY": "wayland-0"}, True),
        ("darwin", {}, True),
        ("win32", {}, True),
    ],
)
def test_a_window_needs_a_display(
    monkeypatch: pytest.MonkeyPatch, system: str, variables: dict[str, str], expected: bool
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("sys.platform", system)
    assert has_display() == expected


def test_a_record_begins_at_zero() -> None:
    assert parse_record_time("0") == 0.0
    with pytest.raises(ValueError, match="before the start"):
        parse_record_time("-0.1 s")
