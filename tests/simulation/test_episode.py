"""Episodes: commands of a program, one control cycle after the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.compiler.pipeline import compile_file, emit, load
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model import Block, Box, Fleet, Ground, Placement, Pose, Robot, World
from thorvaldc.model.scenario import Scenario
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.control_loop import ControlLoop, Sample
from thorvaldc.simulation.episode import Episode
from thorvaldc.simulation.physics.sim_base import SimBase
from thorvaldc.simulation.scenario_run import ScenarioSimulation
from thorvaldc.simulation.simulation_run import Simulation

pytest.importorskip("mujoco")
EXAMPLES = Path(__file__).parents[2] / "examples"
ROBOT = make_robot(FOUR_STEERED)
OTHER = replace(ROBOT, wheels=tuple(replace(w, radius=0.8 * w.radius) for w in ROBOT.wheels))


def scenario() -> Scenario:
    compilation = compile_file(EXAMPLES / "odometry_experiment/ideal.yaml")
    assert compilation.scenario is not None
    return compilation.scenario


def fleet(*names: str) -> Fleet:
    placed = (Placement(n, Pose((0.0, 4.0 * k, 0.0)), ROBOT) for k, n in enumerate(names))
    return Fleet("two", "", tuple(placed))


@pytest.mark.parametrize("ideal", [False, True])
def test_a_controller_of_the_program_closes_a_loop(ideal: bool) -> None:
    goal = Pose2(1.5, 0.8, 0.0)
    episode = Episode(ROBOT, ideal=ideal)
    episode.reset()

    def towards_the_goal(sample: Sample) -> Twist:
        x, y, yaw = goal.relative_to(sample.pose_true)
        return Twist(min(x, 0.5), min(y, 0.5), yaw)

    sample = episode.run(8.0, towards_the_goal)
    assert sample.time == pytest.approx(8.0)
    assert sample.pose_true == pytest.approx(goal, abs=0.05)


def test_each_step_is_one_control_cycle() -> None:
    episode = Episode(ROBOT)
    first = episode.reset()
    samples = [episode.step(Twist(0.5, 0.0, 0.0)) for _ in range(100)]
    period = 1.0 / ROBOT.driver.rate
    assert [s.time for s in (first, *samples)] == pytest.approx([period * k for k in range(101)])
    assert samples[-1].true.vx == pytest.approx(0.5, abs=0.02)
    assert episode.step().limited.vx < 0.5  # without a command and a script: zero
    assert episode.reset() == first


def test_an_episode_of_a_scenario_plays_its_script() -> None:
    mission = scenario()
    played: list[Sample] = []
    files = emit(mission.fleet, ["mjcf"])
    simulation = ScenarioSimulation(mission, files)
    simulation.play(Report(), on_tick=lambda loop: played.append(loop.sample()), hashed=False)
    episode = Episode(mission)
    episode.reset()
    assert episode.run(20.0) == next(s for s in played if s.time > 20.0 - 1e-6)
    driven = episode.step(Twist(0.0, 0.0, 0.0))
    for _ in range(40):
        driven = episode.step(Twist(0.0, 0.0, 0.0))
    assert driven.limited == (0.0, 0.0, 0.0)


def test_the_seed_of_an_episode_is_that_of_the_noise() -> None:
    mission = scenario()
    episode = Episode(replace(mission, noise=replace(mission.noise, wheel_speed=0.05)))
    speeds = []
    for seed in (1, 1, 2):
        joints = episode.reset(seed).joints
        assert joints is not None
        speeds.append(joints.speeds)
    assert speeds[0] == speeds[1] != speeds[2]


def test_joint_commands_turn_the_wheels_that_they_name() -> None:
    episode = Episode(ROBOT)
    episode.reset()
    n = len(ROBOT.wheels)
    sample = episode.sample()
    for _ in range(100):
        sample = episode.step(JointCommands([2.0] * n, [0.3] * n))
    assert sample.joints is not None
    assert sample.joints.speeds == pytest.approx([2.0] * n, abs=0.1)
    assert sample.joints.angles == pytest.approx([0.3] * n, abs=0.02)
    for _ in range(100):  # and back to twists, from the angles that the joints have
        sample = episode.step(Twist(0.2, 0.0, 0.0))
    assert sample.true == pytest.approx((0.2, 0.0, 0.0), abs=0.02)
    with pytest.raises(ValueError, match="4 finite speeds"):
        episode.step(JointCommands([2.0], [0.3]))


def test_commands_by_robot() -> None:
    episode = Episode(fleet("left", "right"), robot="right")
    episode.reset()
    sample = episode.sample()
    for _ in range(60):
        sample = episode.step({"left": Twist(0.3, 0.0, 0.0), "right": None})
    assert sample.true.vx == pytest.approx(0.0, abs=0.01)
    assert episode.sample("left").true.vx == pytest.approx(0.3, abs=0.02)
    with pytest.raises(ValueError, match="did you mean `left`"):
        episode.step({"lefft": Twist(0.3, 0.0, 0.0)})


def test_a_fleet_that_a_program_places_has_name_spaces() -> None:
    assert [p.robot.namespace for p in fleet("a", "b").placements] == ["a", "b"]
    with pytest.raises(DiagnosticError, match="two robots of two have the name `a`"):
        Episode(fleet("a", "a"))


def test_a_world_of_a_program_is_that_of_the_scene() -> None:
    wall = Block("obstacle", "wall", Box((0.2, 4.0, 1.0)), Pose((3.0, 0.0, 0.5)))
    episode = Episode(replace(fleet("cart"), world=World(Ground(), (wall,))))
    episode.reset()
    sample = episode.run(6.0, lambda _: (0.6, 0.0, 0.0))
    assert episode.collisions is not None
    assert episode.collisions.collisions["cart"] > 0
    assert 1.0 < sample.pose_true.x < 2.9


def test_what_is_no_model_is_named(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="expected a Robot, Fleet or Scenario, got NoneType"):
        Episode(None)  # type: ignore[arg-type]
    (tmp_path / "robot.yaml").write_text("thorvaldc: 1\n", encoding="utf-8")
    with pytest.raises(DiagnosticError, match=r"robot\.yaml is no folder of a build"):
        Episode(tmp_path / "robot.yaml")
    with pytest.raises(DiagnosticError, match="neither a twist nor segments"):
        Simulation(ROBOT).run(1.0, "forward")  # type: ignore[arg-type]


@pytest.mark.parametrize("until", [math.nan, math.inf])
def test_a_run_must_have_an_end(until: float) -> None:
    episode = Episode(ROBOT, ideal=True)
    episode.reset()
    with pytest.raises(DiagnosticError, match="never ends"):
        episode.run(until)


def test_an_episode_must_be_started() -> None:
    with pytest.raises(DiagnosticError, match="reset it first"):
        Episode(ROBOT, ideal=True).step(Twist(0.1, 0.0, 0.0))


# -- a scene belongs to its model ------------------------------------------------------------------


@pytest.mark.parametrize("other", [OTHER, make_robot(FOUR_STEERED[:2])])
def test_the_files_of_another_model_are_an_error(other: Robot, tmp_path: Path) -> None:
    files = emit(other, ["mjcf"])
    for name, data in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(data)
    for given in (files, tmp_path):
        with pytest.raises(DiagnosticError, match="not those of") as caught:
            Simulation(ROBOT, given)
        assert caught.value.diagnostic.code.name == "simulation-scene"
    assert Episode(tmp_path).robots == {other.name: other}  # the folder brings its own model


def test_a_model_may_differ_in_what_its_scene_does_not_contain() -> None:
    faster = replace(ROBOT, driver=replace(ROBOT.driver, max_linear_velocity=2.5))
    Simulation(faster, emit(ROBOT, ["mjcf"]))


# -- what was silent -------------------------------------------------------------------------------


def test_a_function_of_each_tick_may_command_the_driver() -> None:
    def command(loop: ControlLoop) -> None:
        loop.driver.command(Twist(0.5, 0.0, 0.0), loop.driver.state.time)

    run = Simulation(ROBOT, emit(ROBOT, ["mjcf"])).run(4.0, Twist(0.0, 0.0, 0.0), on_tick=command)
    assert run.robots[0].path_true > 1.0


def test_a_motion_of_an_unknown_robot_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"no robot `lefft`; did you mean `left`\?"):
        Simulation(fleet("left", "right")).run(1.0, {"lefft": Twist(0.5, 0.0, 0.0)})


def test_segments_in_the_wrong_order_are_an_error() -> None:
    segments = [(1.0, Twist(0.5, 0.0, 0.0)), (0.0, Twist(0.1, 0.0, 0.0))]
    with pytest.raises(DiagnosticError, match="from 0 s on follows one from 1 s on"):
        Simulation(ROBOT).run(2.0, segments)


@pytest.mark.parametrize("motion", [(0.5, 0.0, 0.0), [(0.0, (0.5, 0.0, 0.0))]])
def test_plain_tuples_are_twists(motion: Sequence[float]) -> None:
    run = Simulation(ROBOT).run(2.0, motion)
    assert run.robots == Simulation(ROBOT).run(2.0, Twist(0.5, 0.0, 0.0)).robots
    driver = BaseDriver(ROBOT, SimBase(ROBOT))
    assert driver.command((0.5, 0.0, 0.0), 0.0)  # type: ignore[arg-type]
    assert driver.tick(0.0).commanded_twist == (0.5, 0.0, 0.0)
    episode = Episode(ROBOT, ideal=True)
    episode.reset()
    assert episode.step((0.5, 0.0, 0.0)).commanded == (0.5, 0.0, 0.0)
    with pytest.raises(DiagnosticError, match="not a twist of 3 numbers"):
        episode.run(1.0, lambda sample: (0.5, 0.0))


def test_start_poses_can_be_set() -> None:
    simulation = Simulation(ROBOT, emit(ROBOT, ["mjcf"]))
    simulation.starts = {ROBOT.name: Pose2(2.0, -1.0, math.pi / 2)}
    poses: list[Pose2] = []
    simulation.run(2.0, (0.5, 0.0, 0.0), on_tick=lambda loop: poses.append(loop.sample().pose_true))
    assert poses[0] == pytest.approx((2.0, -1.0, math.pi / 2), abs=0.01)
    assert poses[-1].y > -0.5
    simulation.starts = {"nobody": Pose2(0.0, 0.0, 0.0)}
    with pytest.raises(ValueError, match="no robot `nobody`"):
        simulation.run(2.0, (0.5, 0.0, 0.0))


def test_a_simulation_of_a_scenario_can_be_run_with_another_motion() -> None:
    mission = scenario()
    simulation = ScenarioSimulation(mission, emit(mission.fleet, ["mjcf"]))
    run = simulation.run(2.0, {"six": (0.5, 0.0, 0.0)})
    assert run.robots[0].path_true > 0.4


# -- the state of an episode -----------------------------------------------------------------------


def waving(sample: Sample) -> Twist:
    return Twist(0.5 * math.cos(sample.time), 0.1, 0.3 * math.sin(2.0 * sample.time))


@pytest.mark.parametrize(
    "options", [{}, {"ideal": True}, {"open_loop": True}], ids=["MuJoCo", "ideal", "open loop"]
)
def test_an_episode_goes_on_from_a_saved_state(options: dict[str, bool]) -> None:
    """To the last bit, as often as wanted, also from the middle of a ramp and after a reset."""
    episode = Episode(ROBOT, **options)
    episode.reset()
    episode.run(1.3, waving)
    state = episode.save()
    ends = []
    for _ in range(2):
        ends.append(repr(episode.run(3.0, waving)))
        if not ends[1:]:
            episode.reset()
            episode.run(0.5, (lambda sample: Twist(-0.3, 0.0, 0.5)))
        assert episode.reset(state=state).time == state.time == pytest.approx(1.3)
    assert ends[0] == ends[1] == repr(episode.run(3.0, waving))


def test_a_saved_state_has_the_joint_commands_and_the_estimate() -> None:
    episode = Episode(ROBOT)
    episode.reset()
    commands = JointCommands([2.0] * 4, [0.3] * 4)
    for _ in range(40):
        episode.step(commands)
    state = episode.save()
    expected = repr([episode.step(commands) for _ in range(40)])
    episode.reset(state=state)
    assert repr([episode.step(commands) for _ in range(40)]) == expected


def test_a_saved_state_has_faults_noise_and_sensors() -> None:
    """A wheel is on ice when the state is saved; noise and messages go on as they did."""
    early = {"faults.0.at": "0.5 s", "faults.0.until": "1.5 s"}
    model = compile_file(EXAMPLES / "scenarios/field_edge.yaml", set=early).scenario
    assert model is not None
    episode = Episode(model)
    messages: list[str] = []
    episode.sensors.listeners.append(lambda sensor, message: messages.append(repr(message)))
    assert episode.scene is not None
    friction = episode.scene.model.geom_friction.copy()
    episode.reset()
    episode.run(1.0)
    state = episode.save()
    on_ice = episode.scene.model.geom_friction.copy()
    scene = episode.scene
    names = [n for n in dir(scene.model) if isinstance(getattr(scene.model, n, None), np.ndarray)]
    arrays = {name: getattr(scene.model, name).copy() for name in names}
    assert (on_ice != friction).any()
    messages.clear()
    end, heard = repr(episode.run(2.0)), [*messages]
    assert heard
    episode.reset()
    assert (episode.scene.model.geom_friction == friction).all()
    episode.reset(state=state)
    assert (episode.scene.model.geom_friction == on_ice).all()
    for name, array in arrays.items():
        assert np.array_equal(getattr(scene.model, name), array), name
    messages.clear()
    assert repr(episode.run(2.0)) == end
    assert messages == heard
    episode.reset()
    assert (episode.scene.model.geom_friction == friction).all()
    assert repr(episode.run(2.0)) == end


class Counting(General):
    """The calculator of a plug-in, which is interpreted also in the compiled runtime."""

    commanded = 0

    def command(self, twist: Twist, joints: JointStates, dt: float) -> Any:
        self.commanded += 1
        return super().command(twist, joints, dt)


def test_a_saved_state_has_the_attributes_of_a_plug_in() -> None:
    episode = Episode(ROBOT)
    episode.reset()
    driver = episode.loops[ROBOT.name].driver
    driver.calculator = Counting(BaseGeometry.from_robot(ROBOT))
    driver.calculator.reset(driver.state.joints)
    for _ in range(5):
        episode.step(Twist(0.3, 0.0, 0.0))
    state = episode.save()
    for _ in range(5):
        episode.step()
    episode.reset(state=state)
    restored = episode.loops[ROBOT.name].driver.calculator
    assert isinstance(restored, Counting)
    assert restored.commanded == 5
    restored.opened = (number for number in ())  # type: ignore[attr-defined]
    with pytest.raises(DiagnosticError, match=r"cannot be saved: .*generator"):
        episode.save()


def test_a_state_belongs_to_its_episode() -> None:
    episode, other = Episode(ROBOT, ideal=True), Episode(ROBOT, ideal=True)
    with pytest.raises(DiagnosticError, match="was not started"):
        episode.save()
    episode.reset()
    with pytest.raises(DiagnosticError, match="not one that this episode has saved"):
        other.reset(state=episode.save())


def test_what_mujoco_has_can_be_set_in_an_episode() -> None:
    """Velocities and joints, for a start in motion."""
    episode = Episode(ROBOT)
    episode.reset()
    assert episode.scene is not None
    episode.scene.data.qvel[:2] = 0.4, 0.0
    assert episode.step(Twist(0.4, 0.0, 0.0)).true.vx > 0.2


# -- forces and slip of the wheels -----------------------------------------------------------------


@pytest.mark.parametrize("name", ["4wd4ws_wide", "lss", "rocker_bogie", "1wd1ws_rear"])
def test_the_forces_of_the_wheels_carry_and_accelerate_the_robot(name: str) -> None:
    robot = load(EXAMPLES / name / "robot.yaml")
    episode = Episode(robot)
    episode.reset()
    for _ in range(10):  # into the ramp
        before = episode.step(Twist(0.5, 0.0, 0.0))
    after = episode.step(Twist(0.5, 0.0, 0.0))
    contacts = episode.wheel_contacts()
    weight = robot.inertial.mass * GRAVITY
    assert sum(contact.force[2] for contact in contacts) == pytest.approx(weight, rel=0.03)
    acceleration = (after.true.vx - before.true.vx) / (after.time - before.time)
    pushed = sum(contact.force[0] for contact in contacts)
    assert pushed == pytest.approx(robot.inertial.mass * acceleration, rel=0.15)
    assert [contact.name for contact in contacts] == [wheel.name for wheel in robot.wheels]


def test_the_frame_of_a_steered_wheel_turns_with_it() -> None:
    """On the spot, all wheels roll on a circle: they push along it, and none slides sideways."""
    episode = Episode(ROBOT)
    episode.reset()
    episode.run(2.0, lambda sample: Twist(0.0, 0.0, 0.4))
    rolling = episode.wheel_contacts()
    assert all(abs(slip) < 0.01 for contact in rolling for slip in contact.slip)
    episode.run(2.1, lambda sample: Twist(0.0, 0.0, 1.0))
    signs = {math.copysign(1.0, contact.force[0]) for contact in episode.wheel_contacts()}
    assert signs == {1.0, -1.0}  # left wheels roll backwards


def test_a_spinning_wheel_slips() -> None:
    """On ice, the wheels turn faster than they roll; a robot that is pushed sideways slides."""
    episode = Episode(ROBOT)
    assert episode.scene is not None
    episode.scene.model.geom_friction[:, 0] = 0.02
    episode.reset()
    for _ in range(20):
        sample = episode.step(Twist(1.0, 0.0, 0.0))
    assert sample.joints is not None
    for wheel, contact, speed in zip(
        ROBOT.wheels, episode.wheel_contacts(), sample.joints.speeds, strict=True
    ):
        assert contact.slip[0] == pytest.approx(sample.true.vx - speed * wheel.radius, abs=0.03)
        assert contact.slip[0] < -0.1
        assert 0.0 < contact.force[0] <= 0.021 * contact.force[2]
    episode.scene.data.qvel[1] = 0.5
    episode.step(Twist(1.0, 0.0, 0.0))
    assert all(contact.slip[1] > 0.2 for contact in episode.wheel_contacts())
    with pytest.raises(DiagnosticError, match="ideal joints have no contacts"):
        Episode(ROBOT, ideal=True).wheel_contacts()
