"""The bench runs only on request; these tests detect modules that cannot be imported any more."""

from __future__ import annotations

import importlib
import math
import pkgutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import bench
from bench import broken_sensors, broken_world, learning, world_breaks, world_robots
from bench.broken_world import evaluate, record
from bench.figure import Figure, in_turns
from bench.healthy_readings import healthy_fit
from bench.machine_load import MachineLoad
from bench.recorded_trials import Recording, logarithm
from bench.world_breaks import Break, World
from thorvaldc.runtime.calculators import BaseGeometry, Noise

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


# -- broken_world ----------------------------------------------------------------------------------


SPINNING = Break(slippery=(0, 1, 2, 3), friction=0.02, hold=1e5)
"""All four wheels spin on a body that is held."""


@pytest.fixture(scope="module")
def world() -> World:
    return World(*world_robots.robot("4 steered, wide"))


@pytest.fixture(scope="module")
def good_ground(world: World) -> Recording:
    return record(world, world_breaks.GOOD_GROUND, 2)


@pytest.fixture
def after_break(world: World, monkeypatch: pytest.MonkeyPatch) -> Callable[[Break], Recording]:
    """Returns a function that records two trials with this break."""

    def recorded(change: Break) -> Recording:
        monkeypatch.setitem(world_breaks.CLASSES, "test", lambda rng, body: change)
        return record(world, "test", 2)

    return recorded


def travelled(recording: Recording) -> float:
    """Returns the largest distance (m) of a trial after the break and 0.2 s."""
    starts = [
        poses[first + 10] for poses, first in zip(recording.poses, recording.breaks, strict=True)
    ]
    return float(np.abs(recording.poses[:, -1, :2] - np.array(starts)[:, :2]).max())


def healthy_share(world: World, recording: Recording, *, gyro: bool = False) -> float:
    """Returns the share of the ticks after the break that look like those of a healthy drive."""
    geometry = BaseGeometry.from_robot(world.robot)
    rates = recording.yaw_rates if gyro else None
    healthy = healthy_fit(geometry, Noise(), recording, rates).is_healthy
    after = [row[first:] for row, first in zip(healthy, recording.breaks, strict=True)]
    return float(np.concatenate(after).mean())


@pytest.mark.parametrize("name", world_robots.NAMES)
def test_every_family_of_the_broken_world_drives(name: str) -> None:
    world = World(*world_robots.robot(name))
    recording = record(world, world_breaks.GOOD_GROUND, 1)
    assert np.abs(recording.true_twists()).max() > 0.1
    assert world.base.uprightness() > 0.99
    assert healthy_share(world, recording) > 0.8


def test_recorded_drives_are_repeatable_and_survive_a_file(
    world: World, good_ground: Recording, tmp_path: Path
) -> None:
    record(world, "wall and ice", 1)
    path = tmp_path / "drives.npz"
    record(world, world_breaks.GOOD_GROUND, 2).save(path)
    for saved, first in zip(Recording.load(path), good_ground, strict=True):
        assert np.array_equal(saved, first)


@pytest.mark.parametrize("gyro", [False, True])
def test_no_drive_on_good_ground_is_outside(
    world: World, good_ground: Recording, gyro: bool
) -> None:
    share = evaluate(world.robot, good_ground, gyro=gyro)
    assert share.trials == share.hidden == share.silent == 0.0
    assert share.nees < 2.0


@pytest.mark.parametrize(("visible", "shares"), [(True, (100.0, 0.0)), (False, (0.0, 100.0))])
def test_an_error_that_no_reading_shows_is_hidden(
    world: World, good_ground: Recording, visible: bool, shares: tuple[float, float]
) -> None:
    poses, commanded = good_ground.poses.copy(), good_ground.commanded.copy()
    poses[:, -1, 0] += 100.0
    if visible:
        commanded[:, -1] += 1.0
    share = evaluate(
        world.robot, good_ground._replace(poses=poses, commanded=commanded), gyro=False
    )
    assert (share.trials, share.hidden) == shares


def test_an_error_of_the_yaw_is_an_angle() -> None:
    assert logarithm(np.array([0.1, 0.0, 2.0 * np.pi])) == pytest.approx([0.1, 0.0, 0.0])


def test_a_trial_ends_when_the_robot_tips_over(world: World, good_ground: Recording) -> None:
    """Its readings and its pose after that do not count."""
    poses = good_ground.poses.copy()
    poses[:, -1, 0] += 100.0
    ended = good_ground._replace(poses=poses, ends=good_ground.ends - 1)
    assert len(ended.joint_states(0, None)) == len(good_ground.times) - 1
    assert evaluate(world.robot, ended, gyro=False).hidden == 0.0
    whole = evaluate(world.robot, good_ground._replace(poses=poses), gyro=False)
    assert whole.trials + whole.hidden == 100.0


def test_a_robot_that_climbs_a_wall_tips_over() -> None:
    recording = record(World(*world_robots.robot("3 steered")), "wall", 2)
    assert recording.ends[1] < recording.poses.shape[1] - 1


def test_wheels_that_spin_on_a_held_body_look_healthy(
    world: World, after_break: Callable[[Break], Recording]
) -> None:
    recording = after_break(SPINNING)
    assert travelled(recording) < 0.01
    assert healthy_share(world, recording) > 0.9
    assert healthy_share(world, recording, gyro=True) < 0.9  # it has to turn


def test_a_gyro_sees_that_a_held_robot_with_skidding_wheels_does_not_turn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(world_breaks.CLASSES, "test", lambda rng, body: SPINNING)
    world = World(*world_robots.robot("4 skid"))
    recording = record(world, "test", 4)
    assert healthy_share(world, recording) > 0.9
    assert healthy_share(world, recording, gyro=True) < 0.9


@pytest.mark.parametrize(
    "change",
    [
        Break(wall=True),
        Break(stalled=(0, 1, 2, 3), resistance=500.0),
        Break(stalled=(0,), resistance=500.0),
    ],
    ids=["wall", "mud", "mud under one wheel"],
)
def test_wheels_that_stall_do_not_look_healthy(
    world: World, after_break: Callable[[Break], Recording], change: Break
) -> None:
    recording = after_break(change)
    assert healthy_share(world, recording) < 0.5
    assert np.abs(recording.torques).max() == pytest.approx(1.0)


def test_a_pull_moves_a_robot_at_rest(
    world: World, monkeypatch: pytest.MonkeyPatch, after_break: Callable[[Break], Recording]
) -> None:
    monkeypatch.setattr("bench.broken_world.AT_REST", ("test",))
    pull = Break(pull=3000.0, drawn=(0.5, 0.0))
    recording = after_break(pull)
    assert travelled(recording) > 0.3
    assert not recording.commanded.any()


@pytest.mark.parametrize("name", broken_sensors.CLASSES)
def test_broken_sensors_are_right_until_the_break(
    world: World, good_ground: Recording, name: str
) -> None:
    recording = broken_sensors.broken(good_ground, BaseGeometry.from_robot(world.robot), name)
    for trial, first in enumerate(good_ground.breaks):
        for values, right in (
            (recording.positions, good_ground.positions),
            (recording.speeds, good_ground.speeds),
        ):
            assert np.allclose(values[trial, : first + 1], right[trial, : first + 1])
            assert not np.allclose(values[trial, first + 1 :], right[trial, first + 1 :])
    if name not in broken_sensors.ALSO_COMMANDED:
        assert healthy_share(world, recording) < 0.9


def test_recordings_are_evaluated_from_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(broken_world, "SAMPLE", 1)
    broken_world.main("record", str(tmp_path), "tricycle")
    broken_world.main("evaluate", str(tmp_path), "tricycle", "encoders")
    names = [line.split("  ")[0] for line in capsys.readouterr().out.splitlines()[1:]]
    kinds = [name for name in broken_sensors.CLASSES if "encoders" in name]
    assert names == [f"tricycle; {kind}{gyro}" for kind in kinds for gyro in ("", ", gyro")]


def test_a_class_has_the_figure_of_its_worst_family(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(broken_world, "TRIALS", 1)
    monkeypatch.setattr(world_robots, "NAMES", ("4 steered, wide", "tricycle"))
    monkeypatch.setattr(broken_world, "CLASSES", {"wall": world_breaks.CLASSES["wall"]})
    monkeypatch.setattr(broken_world, "CASES", {})
    figures = list(broken_world.figures())
    assert [figure.name for figure in figures] == ["wall: outside", "wall, gyro: outside"]
    assert all("tricycle: " in figure.how for figure in figures)


def test_the_environment_with_a_goal_rewards_the_way_to_it() -> None:
    env = learning.environment()
    check_env(env.unwrapped, skip_render_check=True)
    observation, _ = env.reset(seed=1)
    start, rewards, terminated, truncated = math.hypot(*observation[:2]), 0.0, False, False
    while not terminated and not truncated:
        ahead, left = observation[:2] / max(1.0, math.hypot(*observation[:2]))
        action = np.array([ahead, left, 0.0], np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        rewards += float(reward)
    assert info["cause"] == "ended"
    assert rewards == pytest.approx(start + 1.0 - learning.NEAR, abs=0.1)
    env.close()
