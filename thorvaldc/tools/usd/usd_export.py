"""Writes a robot as one OpenUSD file, with the converter ``mujoco-usd-converter``.

The robot's MJCF with spheres of the rolling radius in place of its ellipsoid tyres, which the
converter leaves out, goes to a limited worker process (``usd_conversion``).  Begin with
``export_usd``.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from thorvaldc.backends.description_parts import mesh_files, urdf_only_elements
from thorvaldc.backends.mjcf import ros2_control_files
from thorvaldc.backends.mjcf_robot import body_names
from thorvaldc.compiler.sandbox.worker_process import WorkerLimitError, WorkerLimits, limited_worker
from thorvaldc.diagnostics import CODES, Diagnostic, OutsideError, Report
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.model import Inertial, Pose, Robot
from thorvaldc.model.spatial import combine
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.standing_pose import spin_axis
from thorvaldc.model.statics.wheel_contact import rolling_sphere

_SERVICE = "thorvaldc.tools.usd.usd_conversion"
_IMPORTS = ("mujoco_usd_converter", "mujoco", "pxr.UsdValidation")
_LIMITS = WorkerLimits(
    wall_seconds=120.0,
    processor_seconds=100,
    memory_bytes=4 << 30,
    file_bytes=256 << 20,
    answer_bytes=256 << 20,
)


class UsdError(OutsideError):
    """The converter is not installed, fails, or makes a file that is not valid."""


def export_usd(robot: Robot, suffix: str, report: Report) -> bytes:
    """Returns a robot as an OpenUSD file.  Adds a warning for each part that the file leaves out.

    - ``suffix``: ``.usda`` for text, ``.usdc`` for binary.

    Raises ``UsdError``.
    """
    if find_spec("mujoco_usd_converter") is None:
        raise UsdError(
            "OpenUSD files require mujoco-usd-converter, which is not installed:"
            f" {install_command('usd')}"
        )
    with tempfile.TemporaryDirectory(prefix="thorvaldc-usd-") as name:
        folder = Path(name)
        for path, data in _files(robot).items():
            target = folder / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
        request = {
            "mjcf": str(folder / "mjcf" / "robot.xml"),
            "usd": str(folder / f"robot{suffix}"),
            "bodies": _rigid_bodies(robot),
            "targets": {robot.prefix + servo.joint: servo.initial for servo in robot.joint_servos},
            "limits": {
                robot.prefix + joint.name: joint.velocity
                for joint in robot.joints
                if joint.velocity is not None
            },
        }
        paths = [os.path.abspath(entry) for entry in sys.path]
        with limited_worker(_SERVICE, _LIMITS, path=paths, imports=_IMPORTS) as worker:
            try:
                answer, data = worker.ask(request)
            except WorkerLimitError as error:
                raise UsdError(f"the converter to OpenUSD {error}") from None
    if answer["errors"]:
        raise UsdError(f"the file breaks rules of OpenUSD: {'; '.join(answer['errors'])}")
    report.extend(unsupported(robot))
    for text in answer["left_out"]:
        report.add("usd-left-out", text, robot.span)
    return data


def unsupported(robot: Robot) -> Iterator[Diagnostic]:
    """Yields a diagnostic for each property of the robot that the file cannot express."""
    yield from urdf_only_elements(robot, "USD")
    code = CODES["usd-left-out"]
    sensors = [sensor.name for sensor in robot.sensors]
    if sensors:
        text = f"the USD file has only the frames of the sensors {', '.join(sensors)}"
        yield Diagnostic(code, text, robot.span, "add the sensors in the simulator")
    coupled = [joint.name for joint in robot.joints if joint.mimic is not None]
    if coupled:
        text = (
            f"the USD file couples the joints {', '.join(coupled)} by attributes of Newton and"
            " MuJoCo, which PhysX does not read"
        )
        yield Diagnostic(code, text, robot.span)


def _files(robot: Robot) -> dict[str, bytes]:
    """Returns the MJCF file and the meshes by path.

    A drive of UsdPhysics follows a speed or a position, and none integrates its set point, so that
    the drives are ``velocity`` servos.
    """
    text = ros2_control_files(robot)["mjcf/robot.xml"].decode()
    text = re.sub(r'(<default class="wheel">\s*<geom type=)"ellipsoid"', r'\1"sphere"', text)
    tree = tree_of(robot)
    for wheel in robot.wheels:
        # The ellipsoid is larger, by what it sinks into the ground of MuJoCo.
        axis = spin_axis(tree, wheel)
        sphere = rolling_sphere(wheel.radius, axis, tree.pose[wheel.link].rotate(axis)[2])
        place = " ".join(map(repr, sphere.center))
        name = re.escape(f'name="{robot.prefix}{wheel.link}_tread"')
        text = re.sub(
            rf'(<geom {name}[^>]*) size="[^"]*"(?: pos="[^"]*")?',
            rf'\1 size="{sphere.radius!r}" pos="{place}"',
            text,
        )
    return {"mjcf/robot.xml": text.encode(), **mesh_files(robot)}


def _rigid_bodies(robot: Robot) -> list[dict[str, Any]]:
    """Returns the groups of links that fixed joints hold together, each as one rigid body.

    A rigid body without a mass of its own gets one from the simulator (PhysX: from its shapes, or
    1 kg), so that links without mass, such as frames of sensors, must not be bodies.  Each group
    has the names of its links, its root first, and mass (kg), centre of mass (m) and inertia
    (kg m^2, about the centre of mass) in the frame of its root.
    """
    tree, names = tree_of(robot), body_names(robot)
    groups: dict[str, list[str]] = {}
    inertials: dict[str, list[Inertial]] = {}
    root_of: dict[str, str] = {}
    pose_in_root: dict[str, Pose] = {}
    for link in tree.order:
        joint = tree.parent_joint.get(link)
        if joint is None or joint.type != "fixed":
            root_of[link], pose_in_root[link] = link, Pose()
        else:
            root_of[link] = root_of[joint.parent]
            pose_in_root[link] = pose_in_root[joint.parent] * joint.pose
        groups.setdefault(root_of[link], []).append(names[link])
        inertial = tree.links[link].inertial
        if inertial is not None:
            body = inertial.transformed(pose_in_root[link])
            inertials.setdefault(root_of[link], []).append(body)
    bodies = []
    for root, links in groups.items():
        total = combine(inertials.get(root, []))
        bodies.append(
            {"links": links, "mass": total.mass, "com": total.com, "inertia": total.inertia}
        )
    return bodies
