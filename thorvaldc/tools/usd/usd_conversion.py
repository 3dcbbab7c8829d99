"""Converts an MJCF file to one OpenUSD file, as the service of a limited worker process.

``mujoco-usd-converter`` makes one rigid body of each link, nested in one another, welded by fixed
joints, and without drives.  The stage is then changed to what importers of UsdPhysics expect, of
which Isaac Sim (PhysX) is the strictest:

* One rigid body for each group of links that fixed joints hold together; the links are its frames.
* Rigid bodies side by side.  PhysX refuses nested ones (requirement RB.006 of NVIDIA's asset
  requirements, before OpenUSD 25.11 a rule of UsdPhysics as well).
* A ``PhysicsDriveAPI`` for each motor, spring and damper, from which simulators read gains.
* Parts of one robot do not collide with each other, as in the MJCF.

A request has the paths ``mjcf`` and ``usd``, ``bodies`` (see ``usd_export``), ``targets``
(positions of servos, by joint) and ``limits`` (speeds of joints).  The answer has the texts
``left_out`` and ``errors``, and the file as data.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

_DEGREE = math.pi / 180.0  # rad; angles and gains of UsdPhysics are in degrees


def answer(request: dict[str, Any], _: bytes) -> tuple[dict[str, Any], bytes]:
    """Converts the file of a request, see ``worker_protocol``."""
    from pxr import Usd

    left_out: list[str] = []
    stage = _converted(Path(request["mjcf"]), left_out)
    prims = _named_prims(stage)
    _merge_bodies(prims, request["bodies"])
    _add_drives(prims, Path(request["mjcf"]), request["targets"])
    _limit_speeds(prims, request["limits"])
    _filter_collisions(stage)
    _unnest_bodies(stage)
    path = Path(request["usd"])
    stage.GetRootLayer().Export(str(path), comment="")
    errors = _validated(Usd.Stage.Open(str(path)))
    return {"left_out": left_out, "errors": errors}, path.read_bytes()


def _converted(mjcf: Path, left_out: list[str]) -> Any:
    """Returns the stage of an MJCF file.  Adds what the converter leaves out to ``left_out``."""
    from mujoco_usd_converter import Converter
    from pxr import Tf, Usd

    def warn(text: str) -> None:
        # Every MJCF of thorvaldc has sensors; ``usd_export`` warns of those of the robot.
        if text not in ("sensors are not supported", "cameras are not supported"):
            left_out.append(f"the USD file leaves out a part of the MJCF: {text}")

    # The converter reports by this function; pxr gives Python no other way to receive its warnings.
    Tf.Warn = warn
    folder = tempfile.mkdtemp(dir=mjcf.parent)
    stage = Usd.Stage.Open(Converter().convert(str(mjcf), folder).path)
    # OpenUSD numbers the prototypes of instances in any order, so that bytes would differ.
    while instances := [prim for prim in stage.Traverse() if prim.IsInstance()]:
        for prim in instances:
            prim.SetInstanceable(False)
    return Usd.Stage.Open(stage.Flatten(addSourceFileComment=False))


def _named_prims(stage: Any) -> dict[str, Any]:
    """Returns bodies and joints by their name in the MJCF, which may be no name of a prim."""
    from pxr import UsdPhysics

    return {
        prim.GetDisplayName() or prim.GetName(): prim
        for prim in stage.Traverse()
        if prim.HasAPI(UsdPhysics.RigidBodyAPI) or prim.IsA(UsdPhysics.Joint)
    }


def _merge_bodies(prims: dict[str, Any], bodies: list[dict[str, Any]]) -> None:
    """Makes one rigid body of each group of links, and attaches the joints to these bodies."""
    from pxr import Usd, UsdGeom, UsdPhysics

    root_of = {}
    for body in bodies:
        root, *others = (prims[name] for name in body["links"])
        root_of[root.GetPath()] = root
        for prim in others:
            root_of[prim.GetPath()] = root
            prim.RemoveAPI(UsdPhysics.RigidBodyAPI)
            prim.RemoveAPI(UsdPhysics.MassAPI)
            prim.RemoveAppliedSchema("NewtonMassAPI")
            for name in [p.GetName() for p in prim.GetProperties()]:
                if name.startswith("physics:") or name == "newton:inertia":
                    prim.RemoveProperty(name)
            for child in prim.GetChildren():
                if child.IsA(UsdPhysics.FixedJoint):
                    prim.GetStage().RemovePrim(child.GetPath())
        if body["mass"] > 0.0:
            _set_mass(root, body)
    cache = UsdGeom.XformCache(Usd.TimeCode.Default())
    for prim in prims.values():
        if prim and prim.IsA(UsdPhysics.Joint):
            _attach(UsdPhysics.Joint(prim), root_of, cache)


def _set_mass(prim: Any, body: dict[str, Any]) -> None:
    import mujoco
    import numpy as np
    from pxr import Gf, UsdPhysics, Vt

    xx, yy, zz, xy, xz, yz = body["inertia"]
    values, vectors, axes = np.zeros(3), np.zeros(9), np.zeros(4)
    mujoco.mju_eig3(values, vectors, axes, np.array([xx, xy, xz, xy, yy, yz, xz, yz, zz]))
    mass = UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr().Set(body["mass"])
    mass.CreateCenterOfMassAttr().Set(Gf.Vec3f(*body["com"]))
    mass.CreateDiagonalInertiaAttr().Set(Gf.Vec3f(*values))
    mass.CreatePrincipalAxesAttr().Set(Gf.Quatf(*axes))
    prim.ApplyAPI("NewtonMassAPI")
    prim.GetAttribute("newton:inertia").Set(Vt.DoubleArray(body["inertia"]))


def _attach(joint: Any, root_of: dict[Any, Any], cache: Any) -> None:
    """Attaches the first side of a joint to the rigid body of its link, at the same place."""
    from pxr import Gf

    (target,) = joint.GetBody0Rel().GetTargets()
    if target not in root_of or root_of[target].GetPath() == target:
        return
    link, root = joint.GetPrim().GetStage().GetPrimAtPath(target), root_of[target]
    local = Gf.Matrix4d().SetRotate(Gf.Quatd(joint.GetLocalRot0Attr().Get()))
    local.SetTranslateOnly(Gf.Vec3d(joint.GetLocalPos0Attr().Get()))
    # Row vectors: from the joint to the link, to the world, to the root.
    pose = local * cache.GetLocalToWorldTransform(link)
    pose *= cache.GetLocalToWorldTransform(root).GetInverse()
    joint.GetBody0Rel().SetTargets([root.GetPath()])
    joint.GetLocalPos0Attr().Set(Gf.Vec3f(pose.ExtractTranslation()))
    joint.GetLocalRot0Attr().Set(Gf.Quatf(pose.ExtractRotationQuat()))


def _add_drives(prims: dict[str, Any], mjcf: Path, targets: dict[str, float]) -> None:
    """Adds the drives of motors, springs and dampers, with the gains of the compiled MJCF.

    The force of a drive is stiffness (target - position) + damping (target speed - speed).  A servo
    of MuJoCo has the force gain control + bias_1 position + bias_2 speed.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(mjcf))
    joints = [model.joint(number) for number in range(model.njnt)]
    driven = set()
    for number in range(model.nu):
        joint = joints[model.actuator_trnid[number, 0]]
        driven.add(joint.id)
        stiffness, damping = (abs(float(bias)) for bias in model.actuator_biasprm[number, 1:3])
        limited = model.actuator_forcelimited[number]
        limit = model.actuator_forcerange[number, 1] if limited else math.inf
        target = targets.get(joint.name, 0.0)
        _add_drive(prims[joint.name], stiffness, damping, target, limit)
    for joint in joints:
        if joint.name in prims and joint.id not in driven:
            stiffness, damping = float(joint.stiffness[0]), float(joint.damping[0])
            if stiffness > 0.0 or damping > 0.0:
                reference = float(model.qpos_spring[joint.qposadr[0]])
                _add_drive(prims[joint.name], stiffness, damping, reference, math.inf)


def _add_drive(prim: Any, stiffness: float, damping: float, target: float, limit: float) -> None:
    """Adds a drive with the gains per rad or m."""
    from pxr import UsdPhysics

    is_linear = prim.IsA(UsdPhysics.PrismaticJoint)
    unit = 1.0 if is_linear else _DEGREE
    drive = UsdPhysics.DriveAPI.Apply(prim, "linear" if is_linear else "angular")
    drive.CreateTypeAttr("force")
    drive.CreateStiffnessAttr(stiffness * unit)
    drive.CreateDampingAttr(damping * unit)
    drive.CreateMaxForceAttr(limit)
    if stiffness > 0.0:
        drive.CreateTargetPositionAttr(target / unit)
    drive.CreateTargetVelocityAttr(0.0)


def _limit_speeds(prims: dict[str, Any], limits: dict[str, float]) -> None:
    """Limits the speeds of joints by the attribute of PhysX; UsdPhysics has none."""
    from pxr import Sdf, UsdPhysics

    for name, limit in limits.items():
        prim = prims.get(name)
        if prim and prim.IsA(UsdPhysics.Joint):
            unit = 1.0 if prim.IsA(UsdPhysics.PrismaticJoint) else _DEGREE
            prim.AddAppliedSchema("PhysxJointAPI")
            attribute = prim.CreateAttribute(
                "physxJoint:maxJointVelocity", Sdf.ValueTypeNames.Float, custom=False
            )
            attribute.Set(limit / unit)


def _filter_collisions(stage: Any) -> None:
    """Lets the parts of the robot, which overlap at the joints, not collide with each other."""
    from pxr import Sdf, UsdPhysics

    robot = stage.GetDefaultPrim()
    group = UsdPhysics.CollisionGroup.Define(stage, robot.GetPath().AppendChild("Collisions"))
    collection = group.GetCollidersCollectionAPI()
    collection.CreateIncludesRel().AddTarget(robot.GetPath())
    group.CreateFilteredGroupsRel().AddTarget(group.GetPath())
    for prim in stage.Traverse():
        if prim.HasAPI(UsdPhysics.ArticulationRootAPI):
            prim.AddAppliedSchema("PhysxArticulationAPI")
            attribute = prim.CreateAttribute(
                "physxArticulation:enabledSelfCollisions", Sdf.ValueTypeNames.Bool, custom=False
            )
            attribute.Set(False)
            prim.GetAttribute("newton:selfCollisionEnabled").Set(False)


def _unnest_bodies(stage: Any) -> None:
    """Moves rigid bodies out of other ones, to the same place in the world."""
    import usdex.core
    from pxr import Gf, Usd, UsdGeom, UsdPhysics

    bodies = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.RigidBodyAPI)]
    scope = bodies[0].GetParent().GetPath()
    cache = UsdGeom.XformCache(Usd.TimeCode.Default())
    to_scope = cache.GetLocalToWorldTransform(stage.GetPrimAtPath(scope)).GetInverse()
    moved = [
        (prim.GetPath(), cache.GetLocalToWorldTransform(prim) * to_scope)
        for prim in bodies
        if prim.GetParent().GetPath() != scope
    ]
    for path, pose in reversed(moved):  # children first
        editor = Usd.NamespaceEditor(stage)
        editor.ReparentPrim(stage.GetPrimAtPath(path), stage.GetPrimAtPath(scope))
        editor.ApplyEdits()
        prim = stage.GetPrimAtPath(scope.AppendChild(path.name))
        usdex.core.setLocalTransform(prim, Gf.Transform(pose))


def _validated(stage: Any) -> list[str]:
    """Returns the errors that the validators of OpenUSD find on a stage."""
    from pxr import UsdValidation

    registry = UsdValidation.ValidationRegistry()
    validators = registry.GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    return [f"{error.GetName()}: {error.GetMessage()}" for error in errors]
