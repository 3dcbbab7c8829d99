"""Colours as named materials, and the mesh files that both XML formats refer to."""

from __future__ import annotations

from thorvaldc.model import Robot

Color = tuple[float, float, float, float]


class Palette:
    """Names for a robot's colours, made from the colours so that they are stable.

    ``color_7f7f7f``, with two digits more where it is not opaque.
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
                    # Two colours may round to one name.
                    taken[name] = taken.get(name, 0) + 1
                    self._names[color] = name if taken[name] == 1 else f"{name}_{taken[name]}"

    def name(self, color: Color) -> str:
        return self._names[color]

    def entries(self) -> list[tuple[str, Color]]:
        """Names and colours in order of first use."""
        return [(name, color) for color, name in self._names.items()]


def mesh_files(robot: Robot) -> dict[str, bytes]:
    """The mesh files by path; both XML formats name them ``../meshes/<name>``."""
    return {f"meshes/{mesh.name}": mesh.data for mesh in robot.meshes}
