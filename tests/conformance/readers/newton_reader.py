"""Reads MJCF files with Newton."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import newton
import numpy as np
from reader_program import count, main, rotation, state_of


def names(labels: list[str], parents: list[str]) -> list[str]:
    """The own part of labels that are paths."""
    return [label.removeprefix(f"{p}/") for label, p in zip(labels, parents, strict=True)]


def read(path: str, states: list[dict[str, float]]) -> dict[str, Any]:
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    builder.add_mjcf(path)
    model = builder.finalize(device="cpu")
    labels = list(model.body_label)
    child = model.joint_child.numpy()
    parent = dict(zip(child, model.joint_parent.numpy(), strict=True))
    root = labels[0].rpartition("worldbody")[0] + "worldbody"
    bodies = names(labels, [labels[parent[b]] if parent[b] >= 0 else root for b in parent])
    joints = names(list(model.joint_label), [labels[c] for c in child])
    first, dofs = model.joint_q_start.numpy(), model.joint_qd_start.numpy()
    mass, center = model.body_mass.numpy(), model.body_com.numpy()
    inertia = model.body_inertia.numpy()
    results = []
    for state in states:
        q = np.zeros(model.joint_coord_count, np.float32)
        q[6] = 1.0
        for name, value in state.items():
            q[first[joints.index(name)]] = value
        model.joint_q.assign(q)
        after = model.state()
        newton.eval_fk(model, model.joint_q, model.joint_qd, after)
        places = [(p[:3], rotation(p[6], *p[3:6])) for p in after.body_q.numpy().astype(np.float64)]
        results.append(
            state_of(
                dict(zip(bodies, places, strict=True)),
                (
                    (mass[b], *places[b], center[b].astype(float), inertia[b].astype(float))
                    for b in range(len(places))
                ),
            )
        )
    contacts: dict[str, int] = {}
    collides = int(newton.ShapeFlags.COLLIDE_SHAPES)
    friction = {}
    mu = model.shape_material_mu.numpy()
    for i, (kind, flags) in enumerate(zip(builder.shape_type, builder.shape_flags, strict=True)):
        if int(flags) & collides:
            count(contacts, kind.name)
            own = labels[builder.shape_body[i]]
            friction[model.shape_label[i].removeprefix(f"{own}/")] = float(mu[i])
    moving = [
        j
        for j in range(len(joints))
        if builder.joint_type[j] in (newton.JointType.REVOLUTE, newton.JointType.PRISMATIC)
    ]
    stiffness = model.joint_stiffness.numpy()
    lower, upper = model.joint_limit_lower.numpy(), model.joint_limit_upper.numpy()
    # Actuators keep the order of the file, and have empty names.
    actuated = [
        str(e.get("joint")) for e in ElementTree.parse(path).getroot().iterfind("actuator/*")
    ]
    gains = model.mujoco.actuator_gainprm.numpy()
    biases = model.mujoco.actuator_biasprm.numpy()
    return {
        "states": results,
        "contacts": contacts,
        "friction": friction,
        "actuators": {
            name: [float(gain[0]), -float(bias[2])]
            for name, gain, bias in zip(actuated, gains, biases, strict=True)
        },
        "springs": {joints[j]: float(stiffness[dofs[j]]) for j in moving if stiffness[dofs[j]]},
        "limits": {
            joints[j]: [float(lower[dofs[j]]), float(upper[dofs[j]])]
            for j in moving
            if upper[dofs[j]] < 1e5
        },
    }


if __name__ == "__main__":
    main(read)
