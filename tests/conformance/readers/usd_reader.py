"""Converts MJCF files to OpenUSD with the converter of MuJoCo, and reads the stage."""

from __future__ import annotations

import tempfile
from typing import Any

import mujoco_usd_converter
import numpy as np
from pxr import Usd, UsdGeom, UsdPhysics
from reader_program import count, main, rotation, state_of


def name_of(prim: Any) -> str:
    return prim.GetDisplayName() or prim.GetName()


def read(path: str, states: list[dict[str, float]]) -> dict[str, Any]:
    """A stage has no joint positions: ``states`` may only be the one with all joints at 0."""
    assert states == [{}]
    with tempfile.TemporaryDirectory() as folder:
        asset = mujoco_usd_converter.Converter().convert(path, folder)
        return facts_of(Usd.Stage.Open(asset.path))


def facts_of(stage: Any) -> dict[str, Any]:
    bodies = {}
    parts = []
    contacts: dict[str, int] = {}
    springs, limits = {}, {}
    actuators = 0
    for prim in stage.Traverse():
        if prim.HasAPI(UsdPhysics.RigidBodyAPI):
            matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
            whole = np.array(matrix).T
            place = whole[:3, 3], whole[:3, :3]
            bodies[name_of(prim)] = place
            mass = UsdPhysics.MassAPI(prim)
            if mass.GetMassAttr().Get():
                axes = mass.GetPrincipalAxesAttr().Get()
                turn = rotation(axes.GetReal(), *axes.GetImaginary())
                own = turn @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ turn.T
                center = np.array(mass.GetCenterOfMassAttr().Get(), float)
                parts.append((mass.GetMassAttr().Get(), *place, center, own))
        if prim.HasAPI(UsdPhysics.CollisionAPI):
            count(contacts, prim.GetTypeName())
        stiffness = prim.GetAttribute("mjc:stiffness")
        if stiffness and stiffness.Get():
            springs[name_of(prim)] = float(stiffness.Get())
        ends = [prim.GetAttribute(f"physics:{end}Limit").Get() for end in ("lower", "upper")]
        if None not in ends and np.isfinite(ends).all():
            unit = 1.0 if prim.IsA(UsdPhysics.PrismaticJoint) else np.pi / 180.0
            limits[name_of(prim)] = [end * unit for end in ends]
        actuators += prim.GetTypeName() == "MjcActuator"
    return {
        "states": [state_of(bodies, parts)],
        "contacts": contacts,
        "springs": springs,
        "limits": limits,
        "actuator_count": actuators,
    }


if __name__ == "__main__":
    main(read)
