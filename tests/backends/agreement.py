"""Comparison of a robot's URDF and MJCF by readers that are independent of the backends.

MuJoCo loads both files; poses at random joint positions are also those of the model.
Values that its URDF importer does not keep (speed limits, mesh scales, materials, limits at the
gear) are compared in the raw XML, and values of one format only are compared with the model.
``differences`` returns a line for each disagreement.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from thorvaldc.model import Box, Cylinder, MeshShape, Robot, Shape
from thorvaldc.model.statics.joint_tree import JointTree

TOLERANCE = 1e-9
UNLIMITED = 1e9
POSES = 50


def differences(folder: Path, robot: Robot) -> list[str]:
    """Compare ``urdf/robot.urdf``, ``mjcf/robot.xml`` and ``mjcf/scene.xml`` under ``folder``."""
    check = _Check(robot)
    urdf = ET.parse(folder / "urdf" / "robot.urdf").getroot()
    mjcf = ET.parse(folder / "mjcf" / "robot.xml").getroot()
    models: list[Any] = []
    for path in ("urdf/robot.urdf", "mjcf/robot.xml", "mjcf/scene.xml"):
        try:
            models.append(mujoco.MjModel.from_xml_path(str(folder / path)))
        except ValueError as error:
            check.differences.append(f"{path} does not load: {error}")
    if not check.differences:
        check.structure(models[0], models[1])
        check.dynamics(models[0], models[1])
        check.actuators(models[1])
        check.at_home(models[2])
        check.raw_joints(urdf, mjcf)
        check.raw_shapes(urdf, mjcf, folder)
        check.sensors(models[1])
        check.rest_of_urdf(urdf)
    return check.differences


class _Check:
    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.prefix = robot.prefix
        self.differences: list[str] = []

    def same(self, what: str, *values: Any, tolerance: float = TOLERANCE) -> None:
        """Record a difference unless all values are equal.

        Numbers and arrays may differ by the tolerance, relative for values above 1.
        """
        first = values[0]
        for other in values[1:]:
            if isinstance(first, str | bool) or first is None or other is None:
                good = first == other
            else:
                a, b = np.asarray(first, float), np.asarray(other, float)
                scale = max(1.0, float(np.abs(a).max(initial=0.0)))
                good = a.shape == b.shape and bool((np.abs(a - b) <= tolerance * scale).all())
            if not good:
                self.differences.append(f"{what}: {first} and {other}")

    # -- both files, read by MuJoCo -------------------------------------------------------

    def structure(self, urdf: Any, mjcf: Any) -> None:
        expected = [self.prefix + link.name for link in self.robot.links]
        names = [[m.body(i).name for i in range(1, m.nbody)] for m in (urdf, mjcf)]
        self.same_names("links", expected, *names)
        parent = {self.prefix + j.child: self.prefix + j.parent for j in self.robot.joints}
        for m, kind in ((urdf, "urdf"), (mjcf, "mjcf")):
            for i in range(1, m.nbody):
                name = m.body(i).name
                above = m.body(m.body_parentid[i]).name
                self.same(f"{kind}: parent of {name}", above, parent.get(name, "world"))
        moving = [self.prefix + j.name for j in self.robot.joints if j.type != "fixed"]
        free = [j for j in range(mjcf.njnt) if mjcf.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
        self.same("number of free joints", len(free), 1)
        self.same_names(
            "joints",
            moving,
            [urdf.joint(j).name for j in range(urdf.njnt)],
            [mjcf.joint(j).name for j in range(mjcf.njnt) if j not in free],
        )

    def same_names(self, what: str, *lists: Sequence[str]) -> None:
        for other in lists[1:]:
            for name in sorted({*lists[0], *other}):
                if lists[0].count(name) != other.count(name):
                    self.differences.append(f"{what}: {name} is not in all")

    def dynamics(self, urdf: Any, mjcf: Any) -> None:
        if self.differences:
            return
        for joint in self.robot.joints:
            if joint.type == "fixed":
                continue
            name = self.prefix + joint.name
            a, b = urdf.joint(name), mjcf.joint(name)
            ia, ib = a.id, b.id
            self.same(f"{name}: type", int(urdf.jnt_type[ia]), int(mjcf.jnt_type[ib]))
            self.same(f"{name}: axis", urdf.jnt_axis[ia], mjcf.jnt_axis[ib])
            self.same(f"{name}: anchor", urdf.jnt_pos[ia], mjcf.jnt_pos[ib], np.zeros(3))
            limited = joint.lower is not None or joint.upper is not None
            self.same(f"{name}: limited", bool(mjcf.jnt_limited[ib]), limited)
            if limited:
                self.same(f"{name}: limits", urdf.jnt_range[ia], mjcf.jnt_range[ib])
            da, db = urdf.jnt_dofadr[ia], mjcf.jnt_dofadr[ib]
            self.same(f"{name}: damping", urdf.dof_damping[da], mjcf.dof_damping[db], joint.damping)
            self.same(f"{name}: friction", urdf.dof_frictionloss[da], joint.friction)
            self.same(f"{name}: armature", mjcf.dof_armature[db], joint.armature)
            self.same(f"{name}: stiffness", mjcf.jnt_stiffness[ib], joint.stiffness)
            if joint.stiffness:
                self.same(
                    f"{name}: spring reference",
                    mjcf.qpos_spring[mjcf.jnt_qposadr[ib]],
                    joint.spring_reference,
                )
        self.bodies(urdf, mjcf)
        self.poses(urdf, mjcf)
        self.same("mimics", self.equalities(urdf), self.equalities(mjcf))

    def equalities(self, m: Any) -> str:
        lines = []
        for i in range(m.neq):
            if m.eq_type[i] == mujoco.mjtEq.mjEQ_JOINT:
                one, two = m.joint(m.eq_obj1id[i]).name, m.joint(m.eq_obj2id[i]).name
                lines.append(f"{one} {two} {[round(v, 9) for v in m.eq_data[i, :5].tolist()]}")
        return "; ".join(sorted(lines))

    def bodies(self, urdf: Any, mjcf: Any) -> None:
        for link in self.robot.links:
            name = self.prefix + link.name
            ia, ib = urdf.body(name).id, mjcf.body(name).id
            mass = 0.0 if link.inertial is None else link.inertial.mass
            self.same(f"{name}: mass", urdf.body_mass[ia], mjcf.body_mass[ib], mass)
            if mass:
                self.same(f"{name}: centre", urdf.body_ipos[ia], mjcf.body_ipos[ib])
                self.same(f"{name}: inertia", _inertia(urdf, ia), _inertia(mjcf, ib))

    def poses(self, urdf: Any, mjcf: Any) -> None:
        rng = np.random.default_rng(1)
        a, b = mujoco.MjData(urdf), mujoco.MjData(mjcf)
        free = next(j for j in range(mjcf.njnt) if mjcf.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE)
        adr = mjcf.jnt_qposadr[free]
        links = [self.prefix + link.name for link in self.robot.links]
        ia = [urdf.body(name).id for name in links]
        ib = [mjcf.body(name).id for name in links]
        for _ in range(POSES):
            b.qpos[adr : adr + 7] = (0, 0, 0, 1, 0, 0, 0)
            positions = {}
            for j in range(urdf.njnt):
                low, high = urdf.jnt_range[j] if urdf.jnt_limited[j] else (-math.pi, math.pi)
                q = rng.uniform(max(low, -10.0), min(high, 10.0))
                name = urdf.joint(j).name
                positions[name.removeprefix(self.prefix)] = q
                a.qpos[urdf.jnt_qposadr[j]] = q
                b.qpos[mjcf.jnt_qposadr[mjcf.joint(name).id]] = q
            mujoco.mj_kinematics(urdf, a)
            mujoco.mj_kinematics(mjcf, b)
            count = len(self.differences)
            model = JointTree(self.robot.links, self.robot.joints, positions).pose
            at = [model[link.name] for link in self.robot.links]
            turns = [np.array([p.rotate(e) for e in np.eye(3)]).T.ravel() for p in at]
            self.same("link positions", a.xpos[ia], b.xpos[ib], [p.xyz for p in at])
            self.same("link rotations", a.xmat[ia], b.xmat[ib], turns)
            for what, u, m in zip(
                ("total mass", "centre of mass", "inertia about it"),
                _composite(urdf, a),
                _composite(mjcf, b),
                strict=True,
            ):
                self.same(what, u, m)
            if len(self.differences) > count:
                return

    # -- values that only MJCF has --------------------------------------------------------

    def actuators(self, m: Any) -> None:
        robot = self.robot
        self.same_names(
            "actuators",
            [self.prefix + a.name for a in robot.actuators],
            [m.actuator(i).name for i in range(m.nu)],
        )
        if self.differences:
            return
        d = mujoco.MjData(m)
        mujoco.mj_forward(m, d)
        full = np.zeros((m.nv, m.nv))
        # The argument is the MjData in MuJoCo 4, and an array of it in MuJoCo 3.
        mujoco.mj_fullM(m, full, d.qM) if hasattr(d, "qM") else mujoco.mj_fullM(m, d, full)
        driven = sum(wheel.driven for wheel in robot.wheels)
        total = sum(link.inertial.mass for link in robot.links if link.inertial is not None)
        for actuator in robot.actuators:
            name = self.prefix + actuator.name
            i = m.actuator(name).id
            joint = robot.joint(actuator.joint)
            j = m.actuator_trnid[i, 0]
            self.same(f"{name}: joint", m.joint(j).name, self.prefix + joint.name)
            self.same(f"{name}: gear", m.actuator_gear[i], (1, 0, 0, 0, 0, 0))
            torque, speed = actuator.max_torque, actuator.max_velocity
            self.same(f"{name}: torque", m.actuator_forcerange[i], (-torque, torque))
            if actuator.role == "steering":
                if joint.lower is not None:
                    limits = (joint.lower, joint.upper)
                    self.same(f"{name}: range", m.actuator_ctrlrange[i], limits)
                self.same(f"{name}: stiffness", m.actuator_gainprm[i, 0], 4000.0)
                self.same(f"{name}: no integrator", int(m.actuator_actnum[i]), 0)
                continue
            self.same(f"{name}: speed", m.actuator_ctrlrange[i], (-speed, speed))
            self.same(f"{name}: integrator", int(m.actuator_actnum[i]), 1)
            wheel = next((w for w in robot.wheels if w.spin_joint == joint.name), None)
            dof = m.jnt_dofadr[j]
            inertia = full[dof, dof]
            if wheel is not None:
                inertia += total * wheel.radius**2 / driven
            self.same(f"{name}: kp", m.actuator_gainprm[i, 0], inertia * 400.0)
            self.same(f"{name}: bias", m.actuator_biasprm[i, 1], -inertia * 400.0)
            self.same(f"{name}: kv", m.actuator_biasprm[i, 2], -inertia * 40.0)

    def at_home(self, m: Any) -> None:
        """Check in the home pose that each loaded wheel rolls on its radius with its friction."""
        d = mujoco.MjData(m)
        self.same("key frames", m.nkey, 1)
        mujoco.mj_resetDataKeyframe(m, d, 0)
        mujoco.mj_forward(m, d)
        self.same("gravity", m.opt.gravity, (0, 0, -9.81))
        self.same("cone", int(m.opt.cone), int(mujoco.mjtCone.mjCONE_ELLIPTIC))
        self.same("impratio", m.opt.impratio, 100.0)
        damped = max(h / i for h, i in self.servos(m))
        # Wheels without steering must be on one axle, or they slide in a turn.
        axles = {
            round(w.x, 3)
            for w in self.robot.wheels
            if w.steering_joint is None and w.swivel_joint is None
        }
        explicit = damped * m.opt.timestep <= 1.5 and len(axles) <= 1
        integrators = mujoco.mjtIntegrator
        expected = integrators.mjINT_EULER if explicit else integrators.mjINT_IMPLICITFAST
        self.same("integrator", int(m.opt.integrator), int(expected))
        touched: dict[str, tuple[Any, float]] = {}
        for contact in d.contact:
            # The contact force at rest for this penetration.
            row = contact.efc_address
            force = float(d.efc_aref[row] / d.efc_R[row])
            for g in contact.geom:
                touched[m.body(m.geom_bodyid[g]).name] = (contact, force)
        self.bits(m)
        weight = sum(m.body_mass) * 9.81
        carried = sum(force for name, (_, force) in touched.items() if name != "world")
        self.same("weight on the ground", carried / weight, 1.0, tolerance=1e-5)
        for wheel in self.robot.wheels:
            name = self.prefix + wheel.link
            joint = m.joint(self.prefix + wheel.spin_joint)
            loss = self.robot.joint(wheel.spin_joint).friction
            if name in touched:
                contact, normal = touched[name]
                axis, anchor = d.xaxis[joint.id], d.xanchor[joint.id]
                arm = contact.pos - anchor
                radius = np.linalg.norm(arm - axis * (axis @ arm))
                self.same(f"{name}: rolling radius", radius, wheel.radius, tolerance=1e-6)
                self.same(f"{name}: contact in the middle", axis @ arm, 0.0, tolerance=5e-4)
                mu = wheel.friction
                friction = (mu, mu, mu * wheel.width / 16)
                self.same(f"{name}: friction", contact.friction[:3], friction)
                self.same(f"{name}: contact dimensions", int(contact.dim), 4)
                # The contacts of lightly loaded wheels are softer, so that all wheels sink in
                # equally.
                self.same(f"{name}: time constant", contact.solref[0], 0.01)
                self.same(f"{name}: damping ratio", 1.0 <= contact.solref[1] <= 4.0, True)
                self.same(f"{name}: solimp", contact.solimp[:3], (0.02, 0.95, 0.002))
                loss += wheel.rolling_resistance * normal * wheel.radius
            geoms = [
                g
                for g in range(m.ngeom)
                if m.geom_bodyid[g] == m.body(name).id and m.geom_contype[g] | m.geom_conaffinity[g]
            ]
            rings = sum(3 if tread.flange else 1 for tread in wheel.treads)
            self.same(f"{name}: treads", len(geoms), 1 + rings)
            for tread in wheel.treads:
                ring = mujoco.mj_name2id(
                    m, mujoco.mjtObj.mjOBJ_GEOM, f"{self.prefix}{wheel.link}_{tread.name}"
                )
                self.same(f"{name}: ring", ring in geoms, True)
                grown = float(m.geom_size[ring][0]) - dict(wheel.radii)[tread.name]
                self.same(f"{name}: ring's radius", 0.0 <= grown < 0.002, True)
                self.same(f"{name}: ring's width", m.geom_size[ring][1] * 2, tread.width)
                self.same(f"{name}: ring's place", m.geom_pos[ring], np.array(tread.center))
            if geoms:
                size, turn = m.geom_size[geoms[0]], np.zeros(3)
                ellipsoid = int(mujoco.mjtGeom.mjGEOM_ELLIPSOID)
                self.same(f"{name}: tread", int(m.geom_type[geoms[0]]), ellipsoid)
                self.same(f"{name}: width", size[2] * 2, wheel.width)
                self.same(f"{name}: round", size[0], size[1])
                mujoco.mju_rotVecQuat(turn, np.array([0.0, 0.0, 1.0]), m.geom_quat[geoms[0]])
                axis = self.robot.joint(wheel.spin_joint).axis
                if self.robot.joint(wheel.spin_joint).child == wheel.link:
                    self.same(f"{name}: tread's axis", np.cross(turn, axis), np.zeros(3))
            self.same(
                f"{name}: rolling loss", m.dof_frictionloss[joint.dofadr[0]], loss, tolerance=1e-5
            )

    def servos(self, m: Any) -> list[tuple[float, float]]:
        """Return the damping of every servo in the scene and the inertia of its joint."""
        d = mujoco.MjData(m)
        mujoco.mj_forward(m, d)
        full = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, full, d.qM) if hasattr(d, "qM") else mujoco.mj_fullM(m, d, full)
        dofs = m.jnt_dofadr[m.actuator_trnid[:, 0]]
        return [
            (-float(m.actuator_biasprm[i, 2]), float(full[dof, dof])) for i, dof in enumerate(dofs)
        ] or [(0.0, 1.0)]

    def bits(self, m: Any) -> None:
        """Check that collision shapes collide with other bodies but not with each other."""
        shapes = []
        for g in range(m.ngeom):
            if m.geom_bodyid[g] == 0:
                continue
            contype, conaffinity = int(m.geom_contype[g]), int(m.geom_conaffinity[g])
            group = int(m.geom_group[g])
            if group == 3:
                shapes.append((contype, conaffinity))
                self.same("shapes meet the world", bool((contype | conaffinity) & 1), True)
            else:
                self.same("group of a shape", group, 2)
                self.same("visuals touch", contype | conaffinity, 0)
        for contype, _ in shapes:
            if any(contype & conaffinity for _, conaffinity in shapes):
                self.differences.append("shapes of the robot meet one another")
                break

    def sensors(self, m: Any) -> None:
        for sensor in self.robot.sensors:
            name = self.prefix + sensor.name
            site = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_SITE, name)
            if site < 0:
                self.differences.append(f"sensor {name} has no site")
                continue
            self.same(f"{name}: link", m.body(m.site_bodyid[site]).name, self.prefix + sensor.link)
            self.same(f"{name}: place", m.site_pos[site], np.zeros(3))
            self.same(f"{name}: turn", m.site_quat[site], (1, 0, 0, 0))
            if sensor.type == "imu":
                for part in ("gyro", "accelerometer"):
                    i = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_SENSOR, f"{name}_{part}")
                    self.same(f"{name}_{part}", site, -1 if i < 0 else int(m.sensor_objid[i]))
            if sensor.type == "camera":
                camera = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_CAMERA, name)
                self.same(f"{name}: camera", camera >= 0, True)
                values = dict(sensor.properties)
                if camera >= 0 and "image_width" in values:
                    ratio = float(values["image_width"]) / float(values["image_height"])
                    across = 2 * math.atan(
                        math.tan(math.radians(float(m.cam_fovy[camera])) / 2) * ratio
                    )
                    self.same(f"{name}: view", across, values["horizontal_field_of_view"])
        measured = [
            self.prefix + j.name
            for j in self.robot.joints
            if j.role == "suspension" or self.robot.actuator_of(j.name) is not None
        ]
        for name in measured:
            for part in ("position", "velocity"):
                i = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_SENSOR, f"{name}_{part}")
                seen = "" if i < 0 else m.joint(m.sensor_objid[i]).name
                self.same(f"{name}_{part}", seen, name)

    # -- values in the raw XML --------------------------------------------------------------

    def raw_joints(self, urdf: ET.Element, mjcf: ET.Element) -> None:
        joints = {j.get("name", ""): j for j in urdf.findall("joint")}
        self.same_names(
            "urdf joints",
            [self.prefix + j.name for j in self.robot.joints],
            [j.get("name", "") for j in urdf.findall("joint")],
        )
        forces = {
            str(a.get("joint")): (a.get("forcerange"), a.get("ctrlrange"), a.tag)
            for section in mjcf.findall("actuator")
            for a in section
        }
        for joint in self.robot.joints:
            name = self.prefix + joint.name
            element = joints.get(name)
            if element is None:
                continue
            self.same(f"{name}: urdf type", element.get("type"), joint.type)
            limit = element.find("limit")
            values = (None, None) if limit is None else (limit.get("effort"), limit.get("velocity"))
            for what, raw, own in zip(
                ("effort", "velocity"), values, (joint.effort, joint.velocity), strict=True
            ):
                if raw is None:
                    self.same(f"{name}: {what}", None, own)
                else:
                    self.same(f"{name}: {what}", float(raw), UNLIMITED if own is None else own)
            actuator = self.robot.actuator_of(joint.name)
            if name in forces and actuator is not None:
                force, control, tag = forces[name]
                if joint.effort == actuator.max_torque:
                    self.same(f"{name}: effort in both", values[0], str(force).split()[1])
                if tag == "intvelocity" and joint.velocity == actuator.max_velocity:
                    self.same(f"{name}: speed in both", values[1], str(control).split()[1])

    def raw_shapes(self, urdf: ET.Element, mjcf: ET.Element, folder: Path) -> None:
        colors = {m.get("name"): m.find("color") for m in urdf.findall("material")}
        palette = {m.get("name"): m.get("rgba") for m in mjcf.iter("material")}
        assets = {m.get("name"): m for m in mjcf.iter("mesh")}
        links = {link.get("name"): link for link in urdf.findall("link")}
        bodies = {body.get("name"): body for body in mjcf.iter("body")}
        treads = {wheel.link for wheel in self.robot.wheels}
        for link in self.robot.links:
            name = self.prefix + link.name
            element, body = links[name], bodies[name]
            geoms = body.findall("geom")
            seen = [g for g in geoms if g.get("class") == "visual"]
            touched = [g for g in geoms if g.get("class") != "visual"]
            parts = element.findall("visual")
            self.same(f"{name}: visuals", len(parts), len(seen), len(link.visuals))
            for i, (part, geom, visual) in enumerate(zip(parts, seen, link.visuals, strict=False)):
                what = f"{name}: visual {i}"
                self.shape(what, part, geom, assets, visual.shape, folder)
                material = part.find("material")
                color = None if material is None else colors.get(material.get("name"))
                rgba = "" if color is None else color.get("rgba")
                self.same(
                    f"{what}: colour",
                    visual.color,
                    _floats(rgba),
                    _floats(palette.get(geom.get("material"))),
                    tolerance=1e-12,
                )
            parts = element.findall("collision")
            self.same(f"{name}: urdf collisions", len(parts), len(link.collisions))
            for i, (part, collision) in enumerate(zip(parts, link.collisions, strict=False)):
                self.shape(f"{name}: collision {i}", part, None, assets, collision.shape, folder)
                pose = _urdf_pose(part)
                self.same(f"{name}: collision {i}: place", pose[:3, 3], collision.pose.xyz)
                rotation = np.zeros(9)
                mujoco.mju_quat2Mat(rotation, np.array(collision.pose.quat))
                self.same(f"{name}: collision {i}: turn", pose[:3, :3], rotation.reshape(3, 3))
            if link.name in treads:
                continue
            self.same(f"{name}: collisions", len(parts), len(touched))
            for i, (part, geom, collision) in enumerate(
                zip(parts, touched, link.collisions, strict=False)
            ):
                self.shape(f"{name}: collision {i}", part, geom, assets, collision.shape, folder)

    def shape(
        self,
        what: str,
        part: ET.Element,
        geom: ET.Element | None,
        assets: Mapping[str | None, ET.Element],
        shape: Shape,
        folder: Path,
    ) -> None:
        geometry = part.find("geometry")
        inner = None if geometry is None else next(iter(geometry), None)
        if inner is None:
            self.differences.append(f"{what} has no shape")
            return
        kind = inner.tag
        expected, values = _described(shape)
        self.same(f"{what}: kind", kind, expected)
        if kind != expected:
            return
        if kind == "mesh":
            file = Path(inner.get("filename", ""))
            if not (folder / "urdf" / file).is_file():
                self.differences.append(f"{what}: no file {file}")
            assert isinstance(shape, MeshShape)
            self.same(f"{what}: mesh", file.name, shape.mesh)
            self.same(f"{what}: scale", _floats(inner.get("scale", "1 1 1")), shape.scale)
        else:
            keys = {"box": ["size"], "cylinder": ["radius", "length"], "sphere": ["radius"]}[kind]
            sizes = [v for key in keys for v in _floats(inner.get(key))]
            self.same(f"{what}: size", sizes, values)
        if geom is None:
            return
        self.same(f"{what}: kind in MJCF", geom.get("type"), kind)
        if kind == "mesh":
            asset = assets.get(geom.get("mesh"))
            if asset is None:
                self.differences.append(f"{what}: no mesh {geom.get('mesh')}")
                return
            assert isinstance(shape, MeshShape)
            file = Path(asset.get("file", ""))
            if not (folder / "mjcf" / file).is_file():
                self.differences.append(f"{what}: no file {file}")
            self.same(f"{what}: mesh in MJCF", file.name, shape.mesh)
            self.same(f"{what}: scale in MJCF", _floats(asset.get("scale", "1 1 1")), shape.scale)
        else:
            size = _floats(geom.get("size"))
            full = {"box": [2 * v for v in size], "cylinder": [size[0], 2 * size[-1]]}
            self.same(f"{what}: size in MJCF", full.get(kind, size), values)
        self.same(f"{what}: pose", _urdf_pose(part), _mjcf_pose(geom))

    def rest_of_urdf(self, urdf: ET.Element) -> None:
        self.same("robot's name", urdf.get("name"), self.robot.name)
        root = urdf.find(f"link[@name='{self.prefix}base_link']")
        self.same("massless root", root is None or root.find("inertial") is None, True)
        springs = {
            g.get("reference"): (g.findtext("springStiffness"), g.findtext("springReference"))
            for g in urdf.findall("gazebo")
        }
        for joint in self.robot.joints:
            if joint.stiffness:
                stiffness, reference = springs.get(self.prefix + joint.name, (None, None))
                self.same(f"{joint.name}: urdf stiffness", float(stiffness or 0), joint.stiffness)
                self.same(
                    f"{joint.name}: urdf spring reference",
                    float(reference or 0),
                    joint.spring_reference,
                )
        for wheel in self.robot.wheels:
            for tag in ("mu1", "mu2"):
                path = f"gazebo[@reference='{self.prefix}{wheel.link}']/{tag}"
                self.same(f"{wheel.link}: {tag}", float(urdf.findtext(path, "nan")), wheel.friction)
        for joint in self.robot.joints:
            if joint.mimic is not None:
                path = f"joint[@name='{self.prefix}{joint.name}']/mimic"
                mimic = urdf.find(path)
                values = {} if mimic is None else mimic.attrib
                self.same(
                    f"{joint.name}: mimic", values.get("joint"), self.prefix + joint.mimic.joint
                )


def _floats(text: str | None) -> list[float]:
    return [float(v) for v in (text or "").split()]


def _described(shape: Shape) -> tuple[str, Iterable[float]]:
    match shape:
        case Box(size):
            return "box", size
        case Cylinder(radius, length):
            return "cylinder", (radius, length)
        case MeshShape():
            return "mesh", ()
        case _:
            return "sphere", (shape.radius,)


def _urdf_pose(part: ET.Element) -> Any:
    origin = part.find("origin")
    xyz = _floats("0 0 0" if origin is None else origin.get("xyz", "0 0 0"))
    roll, pitch, yaw = _floats("0 0 0" if origin is None else origin.get("rpy", "0 0 0"))
    x, y, z = (
        _turn(axis, angle) for axis, angle in zip(np.eye(3), (roll, pitch, yaw), strict=True)
    )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = z @ y @ x, xyz
    return pose


def _turn(axis: Any, angle: float) -> Any:
    quat, out = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quat, axis, angle)
    mujoco.mju_quat2Mat(out, quat)
    return out.reshape(3, 3)


def _mjcf_pose(geom: ET.Element) -> Any:
    quat, out = np.array(_floats(geom.get("quat", "1 0 0 0"))), np.zeros(9)
    mujoco.mju_quat2Mat(out, quat)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = out.reshape(3, 3), _floats(geom.get("pos", "0 0 0"))
    return pose


def _inertia(m: Any, body: int) -> Any:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, m.body_iquat[body])
    r = out.reshape(3, 3)
    return r @ np.diag(m.body_inertia[body]) @ r.T


def _composite(m: Any, d: Any) -> tuple[float, Any, Any]:
    mass = float(m.body_mass.sum())
    com = (m.body_mass[:, None] * d.xipos).sum(axis=0) / mass
    total = np.zeros((3, 3))
    for i in range(1, m.nbody):
        r = d.ximat[i].reshape(3, 3)
        s = d.xipos[i] - com
        total += r @ np.diag(m.body_inertia[i]) @ r.T
        total += m.body_mass[i] * (s @ s * np.eye(3) - np.outer(s, s))
    return mass, com, total
