"""Converts a description of others to a robot.yaml and a folder with its own modules.

Each wheel, steering axis, caster and sensor, and each part that moves in the file without a role,
becomes a module; equal modules are written once.  All other links are one module, the frame.
Modules of this package, in order::

    other_formats               SDF and MJCF -> elements of URDF
    foreign_robot               files -> description, who drives what
    wheel_roles, sensor_roles   description -> roles of joints and links
    urdf_import                 roles -> modules
    module_text, robot_text     modules -> text
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from thorvaldc.compiler.descriptions.description_rules import check_description
from thorvaldc.compiler.descriptions.wheel_rules import (
    Stated,
    check_stated_sides,
    check_stated_wheels,
)
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.shapes.meshes import MAX_FILE_BYTES
from thorvaldc.diagnostics import Report, Span, plain
from thorvaldc.diagnostics.files import read_bounded, write_file
from thorvaldc.model import Joint, Pose
from thorvaldc.model.spatial import GRAVITY, norm, scale
from thorvaldc.model.sums import float_sum
from thorvaldc.tools.importer import robot_text
from thorvaldc.tools.importer.foreign_robot import ForeignRobot, read_robot
from thorvaldc.tools.importer.module_text import ModuleText, placed
from thorvaldc.tools.importer.robot_text import Names, Value, as_id, flow
from thorvaldc.tools.importer.sensor_roles import Sensor, find_sensors
from thorvaldc.tools.importer.wheel_roles import Roles, Tyre, recognise

LIBRARY = "modules"
_FASTEST = 20.0  # m/s; a faster wheel has no real limit
_ASSUMED_SPEED = 1.0  # m/s
_ASSUMED_ACCELERATION = 1.0  # m/s^2
_STEERING_SPEED = 2.0  # rad/s
_ROTOR = 0.05  # share of the inertia that a motor moves
_BALL_FRICTION = 0.1  # of a ball that also rolls sideways
_OPTICAL = Pose.from_xyz_rpy((0.0, 0.0, 0.0), (-math.pi / 2.0, 0.0, -math.pi / 2.0))


@dataclass
class UrdfImport:
    """The files of an imported robot, by their paths; none if the input has errors.

    - ``links``: name of each link in the built robot by its name in the file.
    """

    report: Report
    sources: dict[str, Path]
    files: dict[str, bytes | Path] = field(default_factory=dict)
    links: dict[str, str] = field(default_factory=dict)


def import_urdf(
    path: Path, controllers: Path | None = None, arguments: Mapping[str, str] | None = None
) -> UrdfImport:
    """Converts a file; mesh files among the result are paths to copy.

    ``arguments``: values of the arguments of a xacro file, by name.
    """
    report = Report()
    robot = read_robot(path, controllers, report, arguments)
    result = UrdfImport(report, robot.sources)
    if report.has_errors:
        return result
    _judge(robot, report)
    roles = recognise(robot, report)
    if roles is None or report.has_errors:
        return result
    sensors = find_sensors(robot, report)
    _report_rigid(roles, report)
    _Conversion(robot, roles, sensors, report, result).write()
    if report.has_errors:
        result.files.clear()
    return result


def write_files(files: Mapping[str, bytes | Path], folder: Path) -> None:
    """Writes the files of an imported robot into a folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        data = read_bounded(content, MAX_FILE_BYTES) if isinstance(content, Path) else content
        write_file(path, data, new=True)


def _judge(robot: ForeignRobot, report: Report) -> None:
    """Applies the rules of the audit about bodies, joints and stated wheels."""
    check_description(robot.description, report)
    kinds = ("wheel radius", "wheel separation", "wheelbase")
    stated: list[Stated] = [
        (fact, [robot.description]) for fact in robot.description.facts if fact.kind in kinds
    ]
    check_stated_wheels(stated, report)
    check_stated_sides([s for s in stated if s[0].kind == "wheel separation"], report)


def _report_rigid(roles: Roles, report: Report) -> None:
    if roles.rigid:
        shown = ", ".join(f"`{joint.name}`" for joint in roles.rigid)
        report.add(
            "import-assumed",
            f"{shown}: these joints move no wheel, or carry one, and are fixed at 0",
            roles.rigid[0].span,
            hint="add an arm as an extra, and a suspension as a module of your own",
        )


@dataclass
class _Part:
    """A rigid part that becomes a module: the joint above it, and its first link."""

    root: str
    joint: Joint | None
    kind: str
    name: str
    parent: _Part | None
    links: dict[str, str]  # names in the module by the names in the file
    module: ModuleText


class _Conversion:
    """Makes modules of the rigid parts of a robot, from the root outwards."""

    def __init__(
        self,
        robot: ForeignRobot,
        roles: Roles,
        sensors: Mapping[str, Sensor],
        report: Report,
        result: UrdfImport,
    ) -> None:
        self.robot, self.roles, self.sensors = robot, roles, sensors
        self.report, self.result = report, result
        self.description = robot.description
        self.name = as_id(self.description.name) or "robot"
        self.file = Path(self.description.file).name
        self.names = Names((robot_text.ROOT_MODULE,))
        self.types = Names()
        self.written: dict[tuple[str, tuple[tuple[str, Path], ...]], str] = {}
        bodies = [link.inertial for link in self.description.links.values()]
        self.weight = GRAVITY * float_sum(body.mass for body in bodies if body is not None)
        self.assumed: dict[str, None] = {}
        self.entries: list[robot_text.Module] = []

    def write(self) -> None:
        """Adds the files of the robot to the result."""
        inner = {joint.child for joint in self.description.joints.values()}
        root = next(link for link in self.description.links if link not in inner)
        parts = list(self.parts(root))
        robot = robot_text.Robot(self.name, library=[LIBRARY], driver=self.driver_limits())
        robot.comments = [f"Imported from {self.file}. Each module names its link and joint."]
        self.entries = robot.modules
        for part in parts:
            robot.modules.append(self.instance(part))
            for link, own in part.links.items():
                self.result.links[link] = f"{part.name}_{own}"
        robot.comments += [f"Assumed, not read from the file: {text}." for text in self.assumed]
        if self.assumed:
            self.report.add(
                "import-assumed",
                f"assumed, and not read from `{self.file}`: {'; '.join(self.assumed)}",
                self.description.links[root].span,
                hint="correct the values in the modules; comments mark them",
            )
        text = robot_text.render(robot)
        self.result.files["robot.yaml"] = text.encode()
        accepted = self.check(text, {part.name: part for part in parts})
        if accepted:
            text += f"accept: {flow(accepted)}\n"
            self.result.files["robot.yaml"] = text.encode()

    def check(self, text: str, parts: Mapping[str, _Part]) -> list[Value]:
        """Reports the errors that the robot has, at the links from which they come.

        Returns the warnings that are no fault of a description, which the robot file accepts.
        """
        with TemporaryDirectory() as folder:
            write_files(self.result.files, Path(folder))
            compilation = compile_file(Path(folder, "robot.yaml"))
        owners = {f"{LIBRARY}/{e.type}/module.yaml": e.name for e in self.entries[::-1]}
        for error in compilation.report.errors:
            span = error.span or Span("")
            name = owners.get(os.path.relpath(span.file, folder), "")
            if not name:
                above = text.splitlines()[: span.line]
                keys = [m[1] for line in above if (m := re.match(r"  ([a-z]\w*):", line))]
                name = keys[-1] if keys else robot_text.ROOT_MODULE
            link = self.description.links[parts[name].root]
            self.report.add(error.code.name, error.message, link.span, hint=error.hint)
        codes = {warning.code.name for warning in compilation.report.warnings}
        return [
            {"code": code, "reason": reason} for code, reason in _DRAWN.items() if code in codes
        ]

    def driver_limits(self) -> dict[str, Value]:
        names = {
            "linear.x.max_velocity": ("max_linear_velocity", "m/s"),
            "angular.z.max_velocity": ("max_angular_velocity", "rad/s"),
            "linear.x.max_acceleration": ("max_linear_acceleration", "m/s^2"),
            "angular.z.max_acceleration": ("max_angular_acceleration", "rad/s^2"),
        }
        limits = self.robot.limits
        return {key: f"{limits[n]:g} {unit}" for n, (key, unit) in names.items() if n in limits}

    # -- rigid parts ---------------------------------------------------------------------

    def parts(
        self, root: str, joint: Joint | None = None, parent: _Part | None = None
    ) -> Iterator[_Part]:
        """Yields the part of a link, and then the parts below it."""
        kind = self.kind(root, joint)
        name = robot_text.ROOT_MODULE
        if joint is not None:
            stem = as_id(root).removesuffix("_link").removesuffix("_wheel")
            name = self.names.make(stem, "part")
        part = _Part(root, joint, kind, name, parent, {}, ModuleText("", kind, self.file))
        below: list[Joint] = []
        locals_ = Names(_OWN_NAMES if kind != "ball" else _OWN_NAMES[1:])
        open_links: list[tuple[str, Joint | None]] = [(root, None)]
        while open_links:
            link, above = open_links.pop(0)
            own_name = _MAIN.get(kind, as_id(link)) if link == root else as_id(link)
            part.links[link] = locals_.make(own_name, "link")
            if above is not None:
                pose = placed(above.pose)
                parent_link = part.links[above.parent]
                joint_name = f"{part.links[link]}_joint"
                part.module.add_joint(joint_name, "fixed", parent_link, part.links[link], **pose)
            for outer in self.description.joints_below.get(link, ()):
                if outer.type == "fixed" and not self.is_cut(outer):
                    open_links.append((outer.child, outer))
                else:
                    below.append(outer)
        self.fill(part)
        yield part
        for outer in below:
            yield from self.parts(outer.child, outer, part)

    def is_cut(self, joint: Joint) -> bool:
        return joint.child in self.sensors or joint.child in self.roles.balls

    def kind(self, link: str, joint: Joint | None) -> str:
        if joint is None:
            return "frame"
        if link in self.roles.balls:
            return "ball"
        for names, kind in (
            (self.roles.wheels, "wheel"),
            (self.roles.steering, "steering"),
            (self.roles.swivels, "caster"),
        ):
            if joint.name in names:
                return kind
        return "sensor" if link in self.sensors else "part"

    def instance(self, part: _Part) -> robot_text.Module:
        """Returns the entry of the robot file, and adds the module if it is new."""
        text = part.module.text(part.joint is None)
        key = text, tuple(part.module.meshes.items())
        if key not in self.written:
            type_name = part.name if part.kind in ("sensor", "part") else part.kind
            self.written[key] = f"{self.name}/{self.types.make(type_name, 'part')}"
            folder = f"{LIBRARY}/{self.written[key]}"
            self.result.files[f"{folder}/module.yaml"] = text.encode()
            for name, path in part.module.meshes.items():
                self.result.files[f"{folder}/{name}"] = path
        entry = robot_text.Module(part.name, self.written[key])
        joint = part.joint
        entry.comments = [f"link `{part.root}`" + (f", joint `{joint.name}`" if joint else "")]
        if joint is not None and part.parent is not None:
            poses = self.description.poses
            pose = (poses[part.parent.root].inverse() * poses[part.root]).clean()
            entry.mount = robot_text.Mount(pose.xyz, pose.rpy(), part.parent.name)
        return entry

    # -- the content of a module ---------------------------------------------------------

    def fill(self, part: _Part) -> None:
        module, joint, kind = part.module, part.joint, part.kind
        module.description = f"{_TEXTS[kind]} of {self.name}, imported from {self.file}."
        main = part.links[part.root]
        module.carrier = main
        moves = kind in ("wheel", "steering", "caster")
        if moves:
            module.links["mount"] = []
        tyre = self.roles.wheels.get(joint.name) if joint is not None else None
        for link, own in part.links.items():
            element = self.description.links[link]
            if kind == "ball" and link == part.root:
                module.links[own] = []
                continue
            module.add_link(own, element, self.robot.mesh_files, collides=kind != "wheel")
        if moves and joint is not None:
            self.add_moving_joint(part, joint, main)
        if kind == "wheel" and joint is not None and tyre is not None:
            self.add_tyre(part, joint, tyre, main)
        elif kind == "steering" and joint is not None:
            self.add_steering(part, joint)
        elif kind == "ball":
            self.add_ball(part, self.roles.balls[part.root], main)
        elif kind == "sensor":
            self.add_sensor(part, self.sensors[part.root])

    def add_moving_joint(self, part: _Part, joint: Joint, main: str) -> None:
        driven = joint.name in self.roles.driven
        role = {"wheel": "propulsion" if driven else "wheel", "steering": "steering"}.get(
            part.kind, "swivel"
        )
        values: dict[str, Value] = {"role": role, "axis": [*joint.axis]}
        is_endless = part.kind == "wheel" or joint.type == "continuous"
        if not is_endless and joint.lower is not None and joint.upper is not None:
            values |= {"lower": joint.lower, "upper": joint.upper}
        for key in ("damping", "friction"):
            if getattr(joint, key):
                values[key] = getattr(joint, key)
        kind = "continuous" if is_endless else "revolute"
        part.module.add_joint("axle" if part.kind == "wheel" else part.kind, kind, "mount", main,
                              **values)  # fmt: skip

    def add_tyre(self, part: _Part, joint: Joint, tyre: Tyre, main: str) -> None:
        """Adds the wheel, in a link of its own if its middle is not that of the link."""
        module, link = part.module, main
        if norm(tyre.center) > 1e-6:
            link = "tyre"
            module.links[link] = []
            module.add_joint("tyre_joint", "fixed", main, link, xyz=[*tyre.center])
        if joint.name in self.roles.driven:
            self.add_motor(part, joint, "axle", tyre)
        self.add_wheel_section(module, link, tyre, 0.8)

    def add_wheel_section(self, module: ModuleText, link: str, tyre: Tyre, friction: float) -> None:
        entry: dict[str, Value] = {"link": link, "radius": tyre.radius, "width": tyre.width}
        entry |= {"friction": friction, "source": f"published: {self.file}; estimated: friction"}
        module.sections.append(f"wheel: {flow(entry)}")
        self.assumed[f"friction {friction:g} of a {'ball' if friction < 0.5 else 'wheel'}"] = None

    def add_motor(self, part: _Part, joint: Joint, own: str, tyre: Tyre) -> None:
        """Adds the motor of a driven wheel, as if it had no gear."""
        comments: list[str] = []
        limits = self.robot.limits
        speed = joint.velocity or 0.0
        if not 0.0 < speed * tyre.radius <= _FASTEST:
            turning = limits.get("angular.z.max_velocity", 0.0) * self.reach()
            fastest = limits.get("linear.x.max_velocity", _ASSUMED_SPEED) + turning
            speed = fastest / tyre.radius
            comments.append(f"speed {plain(fastest, 3)} m/s")
        push = self.weight * tyre.radius / len(self.roles.driven)
        torque = joint.effort or 0.0
        if not 0.0 < torque <= 20.0 * push:
            torque = push + joint.friction
            comments.append("torque, which pushes with the weight of the robot")
        acceleration = limits.get("linear.x.max_acceleration", 0.0)
        if acceleration <= 0.0:
            acceleration = _ASSUMED_ACCELERATION
            comments.append(f"acceleration {acceleration:g} m/s^2")
        self.motor(part, own, "propulsion", speed, acceleration / tyre.radius, torque, comments)

    def add_steering(self, part: _Part, joint: Joint) -> None:
        comments: list[str] = []
        speed = joint.velocity or 0.0
        if not 0.0 < speed <= 50.0:
            speed = _STEERING_SPEED
            comments.append(f"steering speed {speed:g} rad/s")
        largest = max(tyre.radius for tyre in self.roles.wheels.values())
        push = self.weight * largest / len(self.roles.wheels)
        torque = joint.effort or 0.0
        if not 0.0 < torque <= 20.0 * push:
            torque = push + joint.friction
            comments.append("steering torque")
        comments.append("steering acceleration 20 rad/s^2")
        self.motor(part, "steering", "steering", speed, 20.0, torque, comments)

    def motor(
        self,
        part: _Part,
        own: str,
        role: str,
        speed: float,
        acceleration: float,
        torque: float,
        comments: list[str],
    ) -> None:
        # Wheels that are much lighter than what they move would chatter in a simulation.
        radius = max(tyre.radius for tyre in self.roles.wheels.values())
        moved = self.weight / GRAVITY * radius * radius / len(self.roles.driven)
        comments.append(
            "no gear between motor and joint, and 5 % of the moved inertia in the rotor"
        )
        self.assumed |= dict.fromkeys(comments)
        entry: dict[str, Value] = {"joint": own, "role": role, "gear_ratio": 1}
        entry |= {"motor_max_speed": speed, "max_acceleration": acceleration}
        entry |= {
            "max_torque": torque,
            "rotor_inertia": _ROTOR * moved,
            "source": f"estimated: {', '.join(comments)}",
        }
        part.module.sections += ["motors:", f"  # assumed: {', '.join(comments)}"]
        part.module.sections.append(f"  {role}: {flow(entry)}")

    def reach(self) -> float:
        """Returns the largest distance of a driven wheel from the middle between all in m."""
        poses, joints = self.description.poses, self.description.joints
        points = [poses[joints[name].child].xyz for name in self.roles.driven]
        x, y = (float_sum(p[k] for p in points) / len(points) for k in (0, 1))
        return max(math.hypot(p[0] - x, p[1] - y) for p in points)

    def add_ball(self, part: _Part, ball: Tyre, main: str) -> None:
        """Adds a ball as an upright joint and an axle in one point, which share its mass."""
        module, link = part.module, self.description.links[part.root]
        turned = self.description.poses[part.root].inverse()
        at: Value = [*ball.center]
        up, across = (turned.rotate(v) for v in ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)))
        module.links |= {"swivel": [], "ball": []}
        module.add_joint("swivel", "continuous", main, "swivel", role="swivel", xyz=at, axis=[*up])
        module.add_joint("axle", "continuous", "swivel", "ball", role="wheel", axis=[*across])
        shift = Pose(scale(-1.0, ball.center))
        body = link.inertial
        if body is not None:
            half = body.transformed(shift).with_mass(body.mass / 2.0)
            module.add_mass("swivel", half)
            module.add_mass("ball", half)
        visuals = tuple(replace(v, pose=shift * v.pose) for v in link.visuals)
        bare = replace(link, inertial=None, visuals=visuals)
        module.add_link("ball", bare, self.robot.mesh_files, collides=False)
        self.add_wheel_section(module, "ball", ball, _BALL_FRICTION)

    def add_sensor(self, part: _Part, sensor: Sensor) -> None:
        module = part.module
        link = part.links.get(sensor.link, part.links[part.root])
        if sensor.type == "camera":
            optical = [own for name, own in part.links.items() if "optical" in name]
            ranked = sorted(optical, key=lambda own: "rgb" not in own and "color" not in own)
            if "optical" not in link and ranked:
                link = ranked[0]
            elif "optical" not in link:
                module.links["optical"] = []
                module.add_joint("optical_joint", "fixed", link, "optical", **placed(_OPTICAL))
                link = "optical"
        entry: dict[str, Value] = {"type": sensor.type, "link": link}
        if sensor.properties:
            entry["properties"] = sensor.properties
        module.sections.append(f"sensor: {flow(entry)}")


_DRAWN = {
    "part-loose": "the imported description draws no parts between its links",
    "parts-overlap": "the shapes of the imported description overlap",
}
_OWN_NAMES = ("mount", "swivel", "tyre", "optical")
_MAIN = {
    "wheel": "wheel",
    "steering": "knuckle",
    "caster": "fork",
    "ball": "mount",
}
_TEXTS = {
    "frame": "Frame",
    "wheel": "Wheel",
    "steering": "Steering",
    "caster": "Caster fork",
    "ball": "Ball caster",
    "sensor": "Sensor",
    "part": "Part",
}
