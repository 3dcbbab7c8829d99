"""Reads MJCF files with MuJoCo."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from reader_program import count, main, state_of


def facts_of(model: Any, states: list[dict[str, float]]) -> dict[str, Any]:
    data = mujoco.MjData(model)
    bodies = range(1, model.nbody)
    rest = model.qpos0.copy()
    rest[:7] = 0, 0, 0, 1, 0, 0, 0
    results = []
    for state in states:
        data.qpos[:] = rest
        for name, value in state.items():
            data.joint(name).qpos[0] = value
        mujoco.mj_kinematics(model, data)
        results.append(
            state_of(
                {model.body(b).name: (data.xpos[b], data.xmat[b].reshape(3, 3)) for b in bodies},
                (
                    (
                        model.body_mass[b],
                        data.xipos[b],
                        data.ximat[b].reshape(3, 3),
                        np.zeros(3),
                        np.diag(model.body_inertia[b]),
                    )
                    for b in bodies
                ),
            )
        )
    return {"states": results, **contents_of(model)}


def contents_of(model: Any) -> dict[str, Any]:
    contacts: dict[str, int] = {}
    friction = {}
    for g in range(model.ngeom):
        if model.geom_contype[g] | model.geom_conaffinity[g]:
            count(contacts, mujoco.mjtGeom(int(model.geom_type[g])).name.removeprefix("mjGEOM_"))
            friction[model.geom(g).name] = float(model.geom_friction[g, 0])
    joints = [j for j in range(model.njnt) if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE]
    return {
        "contacts": contacts,
        "friction": friction,
        "actuators": {
            model.joint(model.actuator_trnid[i, 0]).name: [
                float(model.actuator_gainprm[i, 0]),
                -float(model.actuator_biasprm[i, 2]),
            ]
            for i in range(model.nu)
        },
        "springs": {
            model.joint(j).name: float(model.jnt_stiffness[j])
            for j in joints
            if model.jnt_stiffness[j]
        },
        "limits": {
            model.joint(j).name: model.jnt_range[j].tolist() for j in joints if model.jnt_limited[j]
        },
    }


def read(path: str, states: list[dict[str, float]]) -> dict[str, Any]:
    return facts_of(mujoco.MjModel.from_xml_path(path), states)


if __name__ == "__main__":
    main(read)
