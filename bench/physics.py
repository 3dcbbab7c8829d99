"""Generated MJCF compared with closed-form results; its step time compared with a minimal model."""

from __future__ import annotations

import functools
import math
import statistics
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco

from bench.figure import Figure, in_turns
from bench.robots import built, example
from thorvaldc.model import Robot
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import Segment
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.simulation_run import Simulation

GROUP = "long"

RATES = (0.1, 0.5, 1.0, 2.0)  # rad/s
STEPS = 2000
# Four driven wheels at the corners without steering: the robot turns only by skidding.
SKID = """
thorvaldc: 1
name: skid
defaults: {drive: {motor_max_speed: 9000 rpm}}
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1 m, width: 800 mm}}
  fl: {type: assembly/fixed_drive, mount: frame.front_left}
  fr: {type: assembly/fixed_drive, mount: frame.front_right}
  rl: {type: assembly/fixed_drive, mount: frame.rear_left}
  rr: {type: assembly/fixed_drive, mount: frame.rear_right}
  left: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 300 mm, 70 mm]}}
  right: {type: battery/enclosure, mount: {parent: frame, xyz: [0, -300 mm, 70 mm]}}
"""


def figures() -> Iterator[Figure]:
    with TemporaryDirectory() as folder:
        path = Path(folder, "skid.yaml")
        path.write_text(SKID, encoding="utf-8")
        skid, files = built(path)
        ours = max(abs(_skid_error(skid, files, rate)) for rate in RATES)
        defaults = max(abs(_skid_error(skid, files, rate, True)) for rate in RATES)
    yield Figure(
        "skid steering on the spot",
        100 * ours,
        "%",
        0.5,
        "lower",
        "largest error of the yaw rate from 2 W v/(W^2 + L^2) at 0.1, 0.5, 1 and 2 rad/s; "
        f"MuJoCo's default contact: {100 * defaults:.0f} %",
    )
    robot, files = built(example("4wd4ws_wide"))
    straight = _drive(robot, files, Twist(0.8, 0.0, 0.0), 12.0)
    yield Figure(
        "straight line",
        100 * abs(straight[0] / straight[1] - 1.0),
        "%",
        0.01,
        "lower",
        "distance of 4WD4WS compared with its encoders, 10 m at 0.8 m/s",
    )
    turning = _drive(robot, files, Twist(0.0, 0.0, 0.6), 12.0)
    yield Figure(
        "turning on the spot",
        100 * abs(turning[2] / turning[3] - 1.0),
        "%",
        0.1,
        "lower",
        "angle of 4WD4WS compared with its encoders, 7 rad at 0.6 rad/s",
    )
    yield Figure(
        "creep on a slope",
        1000 * _creep(files, math.radians(10.0)),
        "mm/s",
        0.1,
        "lower",
        "speed of a standing 4WD4WS on a slope of 10 deg, between 3 s and 8 s",
    )
    for name in ("4wd4ws_wide", "6wd6ws"):
        robot, files = built(example(name))
        ours, minimal = _step_times(robot, files)
        yield Figure.ratio(
            f"step time of {name}",
            1.4,
            zip(ours, minimal, strict=True),
            "relative to a minimal model with equal degrees of freedom and contacts;"
            f" {statistics.median(ours) * 1e6 / STEPS:.1f} us",
        )


def _skid_error(
    robot: Robot, files: dict[str, bytes], rate: float, default_contact: bool = False
) -> float:
    """Returns the relative error of the yaw rate of a skid-steered robot; ``rate`` is in rad/s.

    Under Coulomb friction the friction forces of a turn in place balance at
    wz = 2 W v / (W^2 + L^2), with track W, wheelbase L and surface speed v of the wheels.
    """
    scene = MujocoScene(files)
    model = scene.model
    if default_contact:
        model.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
        model.opt.impratio = 1.0
        model.geom_solref[:] = (0.02, 1.0)
        model.geom_solimp[:] = (0.9, 0.95, 0.001, 0.5, 2.0)
    base = MujocoBase(robot, scene)
    track = 2 * abs(robot.wheels[0].y)
    wheelbase = 2 * abs(robot.wheels[0].x)
    v = rate * (track**2 + wheelbase**2) / (2 * track)
    for actuator, wheel in zip(robot.actuators, robot.wheels, strict=True):
        number = scene.index("actuator", actuator.name, robot)
        scene.data.ctrl[number] = math.copysign(v, -wheel.y) / wheel.radius
    scene.advance(2.0)
    before, angle, ticks = base.true_pose().yaw, 0.0, 400
    for i in range(ticks):
        scene.advance(2.0 + (i + 1) * 0.005)
        yaw = base.true_pose().yaw
        angle += math.remainder(yaw - before, 2 * math.pi)
        before = yaw
    return angle / (ticks * 0.005) / rate - 1.0


def _drive(
    robot: Robot, files: dict[str, bytes], twist: Twist, duration: float
) -> tuple[float, float, float, float]:
    """Returns path and angle, true and by odometry, of a robot that starts and stops (m, rad)."""
    plan = [Segment(0.0, twist), Segment(duration, Twist(0.0, 0.0, 0.0))]
    run = Simulation(robot, files).run(duration + 3.0, plan).robots[0]
    expected = twist.wz * duration  # selects the turn, because a yaw may be wrapped
    true = expected + math.remainder(run.pose_true.yaw - expected, 2 * math.pi)
    estimated = expected + math.remainder(run.pose_odometry.yaw - expected, 2 * math.pi)
    return run.path_true, run.path_odometry, true, estimated


def _creep(files: dict[str, bytes], slope: float) -> float:
    """Returns the speed (m/s) at which a standing robot slides or rolls down a slope (rad)."""
    scene = MujocoScene(files)
    # Tilting gravity is equivalent to tilting the ground.
    scene.model.opt.gravity[:] = (-9.81 * math.sin(slope), 0.0, -9.81 * math.cos(slope))
    scene.advance(3.0)
    start = scene.data.qpos[:3].copy()
    scene.advance(8.0)
    return float(math.dist(scene.data.qpos[:3], start)) / 5.0


def _step_times(robot: Robot, files: dict[str, bytes]) -> list[list[float]]:
    """Returns the times (s) of ``STEPS`` steps, and of as many of the minimal model, in turns."""
    ours, minimal = MujocoScene(files).model, _minimal(robot)
    models = (ours, minimal)
    data = []
    for model in models:
        state = mujoco.MjData(model)
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, state, 0)
        mujoco.mj_step(model, state, 500)
        data.append(state)
    steps = [
        functools.partial(mujoco.mj_step, model, state, STEPS)
        for model, state in zip(models, data, strict=True)
    ]
    times = in_turns(*steps, rounds=9)
    if data[0].ncon != data[1].ncon or ours.nv != minimal.nv:
        raise SystemExit("the minimal model has other degrees of freedom or contacts")
    return times


def _minimal(robot: Robot) -> Any:
    """Returns a minimal model: a body on steered, driven wheels, with equal contacts."""
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.005
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 100
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    base = spec.worldbody.add_body(name="base")
    base.add_freejoint()
    share = robot.inertial.mass / (2 * len(robot.wheels) + 4)
    _add_mass(base, 4 * share)
    for wheel in robot.wheels:
        holder = base.add_body(pos=[wheel.x, wheel.y, 0.65])
        if wheel.suspension_joint is not None:
            # The spring carries the load of the wheel, as in the generated model.
            holder.add_joint(
                type=mujoco.mjtJoint.mjJNT_SLIDE,
                axis=[0, 0, 1],
                stiffness=[2e4, 0, 0],
                damping=[900, 0, 0],
                springref=-wheel.load / 2e4,
            )
            _add_mass(holder, share / 4)
            holder = holder.add_body()
        leg = holder
        leg.add_joint(name=f"{wheel.name}_steer", axis=[0, 0, 1])
        _add_mass(leg, 3 * share / 4)
        tyre = leg.add_body(pos=[0, 0, wheel.radius - 0.65])
        tyre.add_joint(name=f"{wheel.name}_spin", axis=[0, 1, 0])
        _add_mass(tyre, share)
        tyre.add_geom(
            type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
            size=[wheel.radius, wheel.width / 2, wheel.radius],
            condim=4,
            priority=1,
            friction=[wheel.friction, 0.01, 0.0005],
            solref=[0.01, 1],
            solimp=[0.02, 0.95, 0.002, 0.5, 2],
            mass=0,
        )
    for wheel in robot.wheels:
        steer = spec.add_actuator(name=f"{wheel.name}_steer", target=f"{wheel.name}_steer")
        steer.trntype = mujoco.mjtTrn.mjTRN_JOINT
        steer.set_to_position(kp=4000, kv=300)
        spin = spec.add_actuator(name=f"{wheel.name}_spin", target=f"{wheel.name}_spin")
        spin.trntype = mujoco.mjtTrn.mjTRN_JOINT
        spin.set_to_intvelocity(kp=1000, kv=100)
    return spec.compile()


def _add_mass(body: Any, mass: float) -> None:
    body.mass = mass
    body.inertia = [0.1 * mass, 0.1 * mass, 0.1 * mass]
    body.explicitinertial = True
