"""What URDF, MJCF and SDF files have in common: names of colours, colours of fixed bodies, mesh
files, gravity on a slope, and the elements that only a URDF has.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from thorvaldc.backends.xml_writer import parse
from thorvaldc.diagnostics import CODES, Diagnostic
from thorvaldc.model import Ground, Inertial, Robot, Vec3
from thorvaldc.model.spatial import GRAVITY, clean

NEGLIGIBLE = Inertial(1e-10, (0.0, 0.0, 0.0), (1e-12, 1e-12, 1e-12, 0.0, 0.0, 0.0))
"""Inertia of a link without mass for readers that refuse the mass 0, or take 1 kg for no mass: DART
for each link in URDF, Pinocchio for each mesh in MJCF."""

Color = tuple[float, float, float, float]
BLOCK_COLORS: dict[str, Color] = {
    "kerb": (0.62, 0.62, 0.6, 1.0),
    "rail": (0.45, 0.47, 0.5, 1.0),
    "obstacle": (0.7, 0.35, 0.2, 1.0),
    "crop": (0.25, 0.5, 0.2, 1.0),
    "post": (0.75, 0.77, 0.8, 1.0),
}
"""Colours of the fixed bodies of a scenario by their kind."""


class Palette:
    """Names of the colours of robots, such as ``color_7f7f7f``.

    The name of a colour contains the RGB value in hexadecimal digits. The name of a transparent
    colour also contains the opacity. The name of a colour does not depend on the other colours of
    the robot.
    """

    def __init__(self, *robots: Robot) -> None:
        self._names: dict[Color, str] = {}
        taken: dict[str, int] = {}
        for robot in robots:
            for link in robot.links:
                for visual in link.visuals:
                    color = visual.color
                    if color in self._names:
                        continue
                    digits = 3 if color[3] >= 1.0 else 4
                    name = "color_" + "".join(
                        f"{round(255 * min(max(c, 0.0), 1.0)):02x}" for c in color[:digits]
                    )
                    # Different colours can have the same name, because RGBA values are rounded to 8
                    # bits.
                    taken[name] = taken.get(name, 0) + 1
                    self._names[color] = name if taken[name] == 1 else f"{name}_{taken[name]}"

    def name(self, color: Color) -> str:
        return self._names[color]

    def entries(self) -> list[tuple[str, Color]]:
        """Return the names and RGBA values of the robot's colours in order of first use."""
        return [(name, color) for color, name in self._names.items()]


def mesh_files(robot: Robot) -> dict[str, bytes]:
    """Return the contents of the mesh files by path relative to the build folder.

    URDF and MJCF files refer to a mesh file as ``../meshes/<name>``.
    """
    return {f"meshes/{mesh.name}": mesh.data for mesh in robot.meshes}


SERVO_ELEMENTS = ("ros2_control", "transmission")
"""Elements from which the compiler reads the servos of joints."""


def urdf_only_elements(
    robot: Robot, target: str, *, mimics: bool = False, in_gazebo: Sequence[str] | None = None
) -> Iterator[Diagnostic]:
    """Yield a diagnostic if a format leaves out elements of the extras or couplings of joints.

    - ``target``: name of the format.
    - ``mimics``: true for a format without mimic joints.
    - ``in_gazebo``: descriptions of what a format that reads the elements ``<gazebo>`` leaves out
      of them, or ``None`` for a format that reads none.
    """
    tags = [parse(text).tag for text in robot.urdf_extensions]
    if in_gazebo is not None:
        tags = [tag for tag in tags if tag != "gazebo"]
    if robot.joint_servos:  # read from these elements
        tags = [tag for tag in tags if tag not in SERVO_ELEMENTS]
    if mimics:
        tags += ["mimic" for joint in robot.joints if joint.mimic is not None]
    parts = [f"{tags.count(tag)} x <{tag}>" for tag in dict.fromkeys(tags)]
    parts += in_gazebo or []
    if parts:
        yield Diagnostic(
            CODES["urdf-only-element"],
            f"{target} has no elements for these parts of the robot: " + ", ".join(parts),
            robot.span,
            "the URDF has them",
        )


def gravity_on(ground: Ground) -> Vec3:
    """Return the vector of gravity in a world that is fixed to the ground, in m/s^2."""
    down = GRAVITY * math.sin(ground.angle)
    x, y = math.cos(ground.direction), math.sin(ground.direction)
    return clean(-down * x), clean(-down * y), clean(-GRAVITY * math.cos(ground.angle))
