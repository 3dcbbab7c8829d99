"""Prints what OpenUSD itself reads from files, as JSON; it runs in an environment with usd-core.

It imports nothing of thorvaldc and nothing of the converter, so that the files open where only
OpenUSD is.  Angles are converted to rad, and angular gains to N m/rad.
"""

from __future__ import annotations

import json
import math
import sys
from typing import Any

from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdValidation

DEGREE = math.pi / 180.0


def matrix(value: Any) -> list[list[float]]:
    """Returns the transposed matrix, for column vectors."""
    return [[value[column][row] for column in range(4)] for row in range(4)]


def read_body(prim: Any, cache: Any) -> dict[str, Any]:
    mass = UsdPhysics.MassAPI(prim)
    axes = Gf.Matrix3d(Gf.Rotation(Gf.Quatd(mass.GetPrincipalAxesAttr().Get())))
    diagonal = Gf.Matrix3d(1.0)
    diagonal.SetDiagonal(Gf.Vec3d(mass.GetDiagonalInertiaAttr().Get()))
    inertia = axes.GetTranspose() * diagonal * axes  # row vectors
    return {
        "mass": mass.GetMassAttr().Get(),
        "com": list(mass.GetCenterOfMassAttr().Get()),
        "inertia": [list(row) for row in inertia],
        "pose": matrix(cache.GetLocalToWorldTransform(prim)),
    }


def read_joint(prim: Any, cache: Any) -> dict[str, Any]:
    joint = UsdPhysics.Joint(prim)
    linear = prim.IsA(UsdPhysics.PrismaticJoint)
    typed = (UsdPhysics.PrismaticJoint if linear else UsdPhysics.RevoluteJoint)(prim)
    unit = 1.0 if linear else DEGREE
    sides = []
    for rel, pos, rot in (
        (joint.GetBody0Rel(), joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()),
        (joint.GetBody1Rel(), joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr()),
    ):
        (target,) = rel.GetTargets()
        body = prim.GetStage().GetPrimAtPath(target)
        local = Gf.Matrix4d().SetRotate(Gf.Quatd(rot.Get()))
        local.SetTranslateOnly(Gf.Vec3d(pos.Get()))
        world = local * cache.GetLocalToWorldTransform(body)
        sides.append({"body": body.GetName(), "pose": matrix(world)})
    value = {
        "type": "prismatic" if linear else "revolute",
        "axis": typed.GetAxisAttr().Get(),
        "lower": typed.GetLowerLimitAttr().Get() * unit,
        "upper": typed.GetUpperLimitAttr().Get() * unit,
        "sides": sides,
    }
    drive = UsdPhysics.DriveAPI.Get(prim, "linear" if linear else "angular")
    if drive:
        value["drive"] = {
            "stiffness": drive.GetStiffnessAttr().Get() / unit,
            "damping": drive.GetDampingAttr().Get() / unit,
            "force": drive.GetMaxForceAttr().Get(),
            "target": (drive.GetTargetPositionAttr().Get() or 0.0) * unit,
            "speed": drive.GetTargetVelocityAttr().Get(),
        }
    limit = prim.GetAttribute("physxJoint:maxJointVelocity")
    value["max_speed"] = limit.Get() * unit if limit else None
    return value


def read(path: str) -> dict[str, Any]:
    stage = Usd.Stage.Open(path)
    cache = UsdGeom.XformCache(Usd.TimeCode.Default())
    prims = list(stage.Traverse())
    registry = UsdValidation.ValidationRegistry()
    validators = registry.GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    bodies = [prim for prim in prims if prim.HasAPI(UsdPhysics.RigidBodyAPI)]
    collisions = {}
    for prim in prims:
        if prim.HasAPI(UsdPhysics.CollisionAPI):
            body = prim
            while body not in bodies:
                body = body.GetParent()
            center = cache.GetLocalToWorldTransform(prim).ExtractTranslation()
            collisions[str(prim.GetPath())] = {
                "type": prim.GetTypeName(),
                "body": body.GetName(),
                "center": list(center),
                "radius": prim.GetAttribute("radius").Get() if prim.HasAttribute("radius") else 0,
            }
    objects = UsdPhysics.LoadUsdPhysicsFromRange(stage, [stage.GetPseudoRoot().GetPath()])
    return {
        "validators": sorted(v.GetMetadata().name for v in validators),
        "errors": [f"{error.GetName()} {error.GetMessage()}" for error in errors],
        "up_axis": UsdGeom.GetStageUpAxis(stage),
        "metres": UsdGeom.GetStageMetersPerUnit(stage),
        "default": stage.GetDefaultPrim().GetName(),
        "files": sum(not layer.anonymous for layer in stage.GetUsedLayers()),
        "roots": [p.GetName() for p in prims if p.HasAPI(UsdPhysics.ArticulationRootAPI)],
        "nested": [
            prim.GetName()
            for prim in bodies
            if any(prim != other and prim.GetPath().HasPrefix(other.GetPath()) for other in bodies)
        ],
        "frames": {
            (p.GetDisplayName() or p.GetName()): matrix(cache.GetLocalToWorldTransform(p))
            for p in prims
            if p.IsA(UsdGeom.Xform)
        },
        "bodies": {prim.GetName(): read_body(prim, cache) for prim in bodies},
        "joints": {
            prim.GetDisplayName() or prim.GetName(): read_joint(prim, cache)
            for prim in prims
            if prim.IsA(UsdPhysics.Joint)
        },
        "collisions": collisions,
        "parsed": {str(kind).rpartition(".")[2]: len(found[0]) for kind, found in objects.items()},
    }


if __name__ == "__main__":
    print(json.dumps([read(path) for path in sys.argv[1:]]))
