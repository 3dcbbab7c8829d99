"""Reads MJCF files with Drake."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from pydrake.geometry import Role
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from reader_program import count, main, state_of


def read(path: str, states: list[dict[str, float]]) -> dict[str, Any]:
    builder = DiagramBuilder()
    plant, scene = AddMultibodyPlantSceneGraph(builder, 0.0)
    (instance,) = Parser(plant).AddModels(path)
    plant.Finalize()
    bodies = [plant.get_body(i) for i in plant.GetBodyIndices(instance)]
    joints = {
        j.name(): j
        for j in (plant.get_joint(i) for i in plant.GetJointIndices(instance))
        if j.num_positions() == 1
    }
    context = plant.CreateDefaultContext()
    results = []
    for state in states:
        q = np.zeros(plant.num_positions())
        q[bodies[0].floating_positions_start()] = 1.0
        for name, value in state.items():
            q[joints[name].position_start()] = value
        plant.SetPositions(context, q)
        places = [plant.EvalBodyPoseInWorld(context, body) for body in bodies]
        turned = [(p.translation(), p.rotation().matrix()) for p in places]
        parts = []
        for body, place in zip(bodies, turned, strict=True):
            own = body.default_spatial_inertia()
            if own.get_mass():
                center = own.get_com()
                about = own.Shift(center).CalcRotationalInertia().CopyToFullMatrix3()
                parts.append((own.get_mass(), *place, center, about))
        named = {body.name(): place for body, place in zip(bodies, turned, strict=True)}
        results.append(state_of(named, parts))
    inspector = scene.model_inspector()
    contacts: dict[str, int] = {}
    friction = {}
    for shape in inspector.GetAllGeometryIds(Role.kProximity):
        surface = inspector.GetProximityProperties(shape).GetProperty(
            "material", "coulomb_friction"
        )
        friction[inspector.GetName(shape).partition("::")[2]] = surface.static_friction()
        count(contacts, type(inspector.GetShape(shape)).__name__)
    actuators = {}
    for index in plant.GetJointActuatorIndices(instance):
        actuator = plant.get_joint_actuator(index)
        gains = actuator.get_controller_gains() if actuator.has_controller() else None
        actuators[actuator.joint().name()] = [gains.p, gains.d] if gains else []
    return {
        "states": results,
        "contacts": contacts,
        "friction": friction,
        "actuators": actuators,
        "limits": {
            name: [float(j.position_lower_limits()[0]), float(j.position_upper_limits()[0])]
            for name, j in joints.items()
            if np.isfinite(j.position_upper_limits()[0])
        },
    }


if __name__ == "__main__":
    logging.getLogger("drake").setLevel(logging.ERROR)
    main(read)
