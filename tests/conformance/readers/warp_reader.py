"""Reads and drives MJCF files with MuJoCo Warp, on the CPU."""

from __future__ import annotations

from typing import Any

import mujoco
import mujoco_warp
import numpy as np
import warp
from reader_program import main, state_of

RAMP = 0.25  # s


def read(
    path: str, states: list[dict[str, float]], drives: list[dict[str, float]] | None = None
) -> dict[str, Any]:
    """``drives`` has the set points of motions by actuator; each lasts 1 s, with a ramp."""
    host = mujoco.MjModel.from_xml_path(path)
    with warp.ScopedDevice("cpu"):
        model = mujoco_warp.put_model(host)
        mass = model.body_mass.numpy()[0]
        inertia = model.body_inertia.numpy()[0]
        results = []
        for state in states:
            data = mujoco.MjData(host)
            data.qpos[:] = host.qpos0
            data.qpos[:7] = 0, 0, 0, 1, 0, 0, 0
            for name, value in state.items():
                data.joint(name).qpos[0] = value
            there = mujoco_warp.put_data(host, data)
            mujoco_warp.kinematics(model, there)
            xpos, xmat = there.xpos.numpy()[0], there.xmat.numpy()[0]
            xipos, ximat = there.xipos.numpy()[0], there.ximat.numpy()[0]
            bodies = range(1, host.nbody)
            results.append(
                state_of(
                    {host.body(b).name: (xpos[b], xmat[b]) for b in bodies},
                    (
                        (mass[b], xipos[b], ximat[b], np.zeros(3), np.diag(inertia[b]))
                        for b in bodies
                    ),
                )
            )
        return {
            "states": results,
            "springs": {
                host.joint(j).name: float(value)
                for j, value in enumerate(model.jnt_stiffness.numpy()[0].ravel()[: host.njnt])
                if value
            },
            "driven": [drive(host, model, goal) for goal in drives or ()],
        }


def drive(host: Any, model: Any, goal: dict[str, float]) -> list[list[float]]:
    """The position of the base in m and its quaternion after 1 s, in Warp and in MuJoCo."""
    data = mujoco.MjData(host)
    mujoco.mj_resetDataKeyframe(host, data, 0)
    mujoco.mj_forward(host, data)
    there = mujoco_warp.put_data(host, data)
    home = data.ctrl.copy()
    full = home.copy()
    for name, value in goal.items():
        full[host.actuator(name).id] = value
    for step in range(round(1.0 / host.opt.timestep)):
        share = min(1.0, step * host.opt.timestep / RAMP)
        data.ctrl[:] = home + share * (full - home)
        there.ctrl.assign(data.ctrl[None].astype(np.float32))
        mujoco.mj_step(host, data)
        mujoco_warp.step(model, there)
    return [there.qpos.numpy()[0][:7].tolist(), data.qpos[:7].tolist()]


if __name__ == "__main__":
    main(read)
