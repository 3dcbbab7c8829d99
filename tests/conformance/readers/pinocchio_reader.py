"""Reads MJCF files with Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio
from reader_program import count, main, state_of


def read(path: str, states: list[dict[str, float]]) -> dict[str, Any]:
    result = pinocchio.buildModelFromMJCF(path)
    model = result[0] if isinstance(result, tuple) else result
    data = model.createData()
    shapes = pinocchio.buildGeomFromMJCF(model, path, pinocchio.GeometryType.COLLISION)
    bodies = [
        f for f in model.frames if f.type == pinocchio.FrameType.BODY and f.name != "universe"
    ]
    results = []
    for state in states:
        q = pinocchio.neutral(model)
        q[:7] = 0, 0, 0, 0, 0, 0, 1
        for name, value in state.items():
            joint = model.joints[model.getJointId(name)]
            # A joint without limits has a cosine and a sine.
            wide = joint.nq == 2
            q[joint.idx_q : joint.idx_q + joint.nq] = (
                (np.cos(value), np.sin(value)) if wide else (value,)
            )
        pinocchio.framesForwardKinematics(model, data, q)
        places = {f.name: data.oMf[model.getFrameId(f.name, f.type)] for f in bodies}
        results.append(
            state_of(
                {name: (place.translation, place.rotation) for name, place in places.items()},
                (
                    (body.mass, place.translation, place.rotation, body.lever, body.inertia)
                    for body, place in zip(model.inertias, data.oMi, strict=True)
                    if body.mass
                ),
            )
        )
    contacts: dict[str, int] = {}
    for shape in shapes.geometryObjects:
        count(contacts, type(shape.geometry).__name__)
    upper, lower = model.upperPositionLimit, model.lowerPositionLimit
    limits = {
        name: [float(lower[joint.idx_q]), float(upper[joint.idx_q])]
        for name, joint in list(zip(model.names, model.joints, strict=True))[1:]  # after the world
        if joint.nq == 1 and np.isfinite(upper[joint.idx_q])
    }
    return {"states": results, "contacts": contacts, "limits": limits}


if __name__ == "__main__":
    main(read)
