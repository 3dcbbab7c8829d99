"""Reads URDF files with DART."""

from __future__ import annotations

from typing import Any

import dartpy
import numpy as np
from reader_program import count, main, state_of


def read(path: str, states: list[dict[str, float]]) -> dict[str, Any]:
    # DART gives a link without inertia, as base_link, 1 kg by default.
    none = dartpy.dynamics.Inertia(1e-12, np.zeros(3), 1e-12 * np.eye(3))
    loader = dartpy.utils.DartLoader()
    plain = loader.parseSkeleton(path).getMass()
    loader.setOptions(dartpy.utils.DartLoaderOptions(defaultInertia=none))
    robot = loader.parseSkeleton(path)
    bodies = [robot.getBodyNode(i) for i in range(robot.getNumBodyNodes())]
    results = []
    for state in states:
        robot.setPositions(np.zeros(robot.getNumDofs()))
        for name, value in state.items():
            robot.getJoint(name).setPosition(0, value)
        matrices = [body.getWorldTransform().matrix() for body in bodies]
        places = [(m[:3, 3].copy(), m[:3, :3].copy()) for m in matrices]
        results.append(
            state_of(
                {body.getName(): place for body, place in zip(bodies, places, strict=True)},
                (
                    (
                        body.getMass(),
                        *place,
                        body.getLocalCOM(),
                        body.getInertia().getMoment(),
                    )
                    for body, place in zip(bodies, places, strict=True)
                ),
            )
        )
    joints = [robot.getJoint(i) for i in range(robot.getNumJoints())]
    contacts: dict[str, int] = {}
    for body in bodies:
        for k in range(body.getNumShapeNodes()):
            shape = body.getShapeNode(k)
            if shape.getCollisionAspect() is not None:
                count(contacts, type(shape.getShape()).__name__.removesuffix("Shape"))
    return {
        "plain_mass": plain,
        "states": results,
        "contacts": contacts,
        "limits": {
            j.getName(): [j.getPositionLowerLimit(0), j.getPositionUpperLimit(0)]
            for j in joints
            if j.getNumDofs() == 1 and abs(j.getPositionUpperLimit(0)) < 1e8
        },
    }


if __name__ == "__main__":
    main(read)
