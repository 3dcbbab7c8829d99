"""The names of colours and the mesh files that the URDF and MJCF backends write."""

from __future__ import annotations

from thorvaldc.model import Robot

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
