"""Reads URDF and SDF files with Drake; runs in an environment with Drake, without thorvaldc.

``compare URDF SDF`` prints the differences of two descriptions of one robot as JSON.
``world SDF`` prints the robots of a world as JSON.
``drive SDF`` prints how far a robot with steered wheels comes, as JSON.
"""

from __future__ import annotations

import json
import logging
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import HalfSpace
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

TOLERANCE = 1e-9
STATES = 10
STEP = 0.002  # s


def add(plant: Any, path: Path) -> list[Any]:
    """Adds the models of a file. Drake refuses the elements that Gazebo added to SDF 1.9."""
    text = path.read_text()
    lines = [line for line in text.splitlines() if "gz_frame_id" not in line]
    copy = path.with_name(f"drake_{path.name}")
    copy.write_text("\n".join(lines))
    return Parser(plant).AddModels(str(copy))


def read(path: Path) -> Any:
    plant = MultibodyPlant(0.0)
    add(plant, path)
    plant.Finalize()
    return plant


def moving(plant: Any) -> dict[str, Any]:
    joints = [plant.get_joint(i) for i in plant.GetJointIndices()]
    return {j.name(): j for j in joints if j.num_positions() == 1}


def set_state(plant: Any, context: Any, values: dict[str, float]) -> None:
    for name, joint in moving(plant).items():
        q = plant.GetPositions(context)
        q[joint.position_start()] = values[name]
        plant.SetPositions(context, q)


def frames(plant: Any) -> dict[str, Any]:
    index = type(plant.world_frame().index())
    every = [plant.get_frame(index(i)) for i in range(plant.num_frames())]
    return {frame.name(): frame for frame in every}


def bodies(plant: Any) -> dict[str, Any]:
    index = type(plant.world_body().index())
    every = [plant.get_body(index(i)) for i in range(1, plant.num_bodies())]
    return {body.name(): body.body_frame() for body in every}


def dynamics(plant: Any, context: Any, names: list[str]) -> np.ndarray:
    """The mass matrix in the order: base (rotation, translation), then the joints by name."""
    base = plant.get_body(sorted(plant.GetFloatingBaseBodies())[0])
    first = base.floating_velocities_start_in_v()
    joints = moving(plant)
    order = [*range(first, first + 6), *(joints[name].velocity_start() for name in names)]
    return plant.CalcMassMatrixViaInverseDynamics(context)[np.ix_(order, order)]


def compare(urdf: Path, sdf: Path) -> list[str]:
    plants = [read(urdf), read(sdf)]
    differences = []
    floating = [
        [plant.get_body(i).name() for i in plant.GetFloatingBaseBodies()] for plant in plants
    ]
    if floating[0] != floating[1] or len(floating[0]) != 1:
        differences.append(f"floating bodies: {floating}")
    for plant in plants:
        fixed = [body.name() for body in plant.GetBodiesWeldedTo(plant.world_body())]
        if fixed != ["world"]:
            differences.append(f"fixed to the world: {fixed}")
    joints = [moving(plant) for plant in plants]
    names = sorted(joints[0])
    if names != sorted(joints[1]):
        return [*differences, f"joints: {names} and {sorted(joints[1])}"]
    for name in names:
        limits = [
            [float(j.position_lower_limits()[0]), float(j.position_upper_limits()[0])]
            for j in (joints[0][name], joints[1][name])
        ]
        speeds = [float(j[name].velocity_upper_limits()[0]) for j in joints]
        # URDF must state limits; a number as large as this means none.
        bounded = [[v if abs(v) < 1e8 else math.copysign(math.inf, v) for v in p] for p in limits]
        if bounded[0] != bounded[1]:
            differences.append(f"limits of {name}: {limits}")
        if min(speeds[0], 1e8) != min(speeds[1], 1e8):
            differences.append(f"speed limit of {name}: {speeds}")
    wanted = bodies(plants[0])
    given = frames(plants[1])
    missing = sorted(wanted.keys() - given.keys())
    if missing:
        differences.append(f"frames that only the URDF has: {missing}")
    random = np.random.default_rng(1)
    contexts = [plant.CreateDefaultContext() for plant in plants]
    for _ in range(STATES):
        values = {name: random.uniform(-1.0, 1.0) for name in names}
        for plant, context in zip(plants, contexts, strict=True):
            set_state(plant, context, values)
        matrices = [
            dynamics(plant, context, names) for plant, context in zip(plants, contexts, strict=True)
        ]
        size = max(1.0, float(np.abs(matrices[0]).max()))
        gap = float(np.abs(matrices[0] - matrices[1]).max()) / size
        if gap > TOLERANCE:
            differences.append(f"mass matrix: {gap}")
        for name in sorted(wanted.keys() & given.keys()):
            poses = [
                f.CalcPoseInWorld(c).GetAsMatrix4()
                for f, c in zip((wanted[name], given[name]), contexts, strict=True)
            ]
            gap = float(np.abs(poses[0] - poses[1]).max())
            if gap > TOLERANCE:
                differences.append(f"pose of {name}: {gap}")
    return differences


def world(sdf: Path) -> dict[str, Any]:
    """The pose of each floating body, the bodies that are fixed to the ground, and the mass of the
    floating models."""
    plant = read(sdf)
    context = plant.CreateDefaultContext()
    floating = [plant.get_body(i) for i in sorted(plant.GetFloatingBaseBodies())]
    models = [body.model_instance() for body in floating]
    return {
        "floating": {
            body.name(): plant.EvalBodyPoseInWorld(context, body).translation().tolist()
            for body in floating
        },
        "fixed": [body.name() for body in plant.GetBodiesWeldedTo(plant.world_body())],
        "mass": sum(plant.CalcTotalMass(context, [model]) for model in models),
    }


def drive(sdf: Path, wheels: list[dict[str, Any]], seconds: float) -> dict[str, Any]:
    """Drives a robot for ``seconds``; returns its motion after a ramp, in the frame of its base.

    ``wheels`` have the drive joint, its speed, the steering joint and angle."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, STEP)
    (model,) = add(plant, sdf)
    plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform(), HalfSpace(), "ground", CoulombFriction(1.0, 1.0)
    )
    targets: dict[str, tuple[float, float]] = {}
    for wheel in wheels:
        targets[wheel["drive"]] = (0.0, wheel["speed"])
        if wheel["steering"]:
            targets[wheel["steering"]] = (wheel["angle"], 0.0)
    drives = {wheel["drive"] for wheel in wheels}
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        joint = actuator.joint().name()
        if joint in targets:
            stiffness = 0.0 if joint in drives else 1e5
            actuator.set_controller_gains(PdControllerGains(p=stiffness, d=1e3))
    plant.Finalize()
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    joints = [
        plant.get_joint_actuator(i).joint().name() for i in plant.GetJointActuatorIndices(model)
    ]
    wanted = [targets.get(joint, (0.0, 0.0)) for joint in joints]
    base = plant.get_body(sorted(plant.GetFloatingBaseBodies())[0])
    # The wheels begin at their steering angles, and at the speed that they keep.
    for joint, (position, _) in targets.items():
        if position:
            plant.GetJointByName(joint).set_angle(context, position)
    port = plant.get_desired_state_input_port(model)
    for share in np.linspace(0.02, 1.0, 50):  # a ramp of 0.5 s
        port.FixValue(context, [p for p, _ in wanted] + [v * share for _, v in wanted])
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.01)
    before = plant.EvalBodyPoseInWorld(context, base)
    start = [plant.GetJointByName(w["drive"]).get_angle(context) for w in wheels]
    yaw = 0.0
    end = simulator.get_context().get_time() + seconds
    last = before.rotation().ToRollPitchYaw().yaw_angle()
    while simulator.get_context().get_time() < end - 1e-9:
        simulator.AdvanceTo(min(end, simulator.get_context().get_time() + 0.1))
        now = plant.EvalBodyPoseInWorld(context, base).rotation().ToRollPitchYaw().yaw_angle()
        yaw += (now - last + math.pi) % (2 * math.pi) - math.pi
        last = now
    after = plant.EvalBodyPoseInWorld(context, base)
    turned = [plant.GetJointByName(w["drive"]).get_angle(context) for w in wheels]
    return {
        "move": (before.inverse() @ after).translation().tolist(),
        "yaw": yaw,
        "turned": [b - a for a, b in zip(start, turned, strict=True)],
        "height": float(after.translation()[2]),
    }


def main() -> None:
    logging.getLogger("drake").setLevel(logging.ERROR)
    jobs = json.load(sys.stdin)
    results = []
    for job in jobs:
        kind = job.pop("kind")
        paths = {key: Path(job[key]) for key in ("urdf", "sdf") if key in job}
        call = {"compare": compare, "world": world, "drive": drive}[kind]
        results.append(call(**{**job, **paths}))
    json.dump(results, sys.stdout)


if __name__ == "__main__":
    main()
