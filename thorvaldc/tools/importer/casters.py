"""Adds casters to a robot that would fall over.

Original configuration files do not contain passive wheels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.model.float_sum import float_sum
from thorvaldc.tools.importer.drives import mount_on_root
from thorvaldc.tools.importer.original_mapping import OriginalMapping
from thorvaldc.tools.importer.robot_text import Module, Names

_SHORTEST_CASTER = 0.4  # m, from the ground to the mount
_LEAST_WHEELBASE = 0.8  # m, least distance of the casters from the drives, along x
_ON_LINE = 0.05  # m, largest distance of a wheel from the straight line through the other wheels

Point = tuple[float, float]  # x, y in base_link, m


def add_casters(
    drive_modules: Sequence[Module],
    source: OriginalMapping,
    frame_height: float,
    frame_center_x: float,
    names: Names,
) -> list[Module]:
    """Returns two casters if all driven wheels are on one straight line.

    If the driven wheels are not on one straight line, no casters are needed and the list is empty.
    Added casters are reported as an assumption.

    ``frame_height`` (m) is the height of the robot's frame above the ground.  ``frame_center_x``
    (m) is the x coordinate of the middle of the frame in ``base_link``.
    """
    points = [mount_position(module) for module in drive_modules if module.mount is not None]
    if not _are_on_a_line(points):
        return []
    module_type = "caster/fixed" if len(set(points)) == 1 else "caster/swivel"
    positions = _caster_positions(points, frame_center_x)
    height = max(frame_height, _SHORTEST_CASTER)
    source.report.add(
        "import-assumed",
        f"all drives are on one line and the file contains no passive wheels: {len(positions)} "
        f"`{module_type}` are added at " + " and ".join(f"({x:g}, {y:g}) m" for x, y in positions),
        source.node.where,
        hint="correct type and position of the passive wheels in the robot.yaml",
    )
    return [
        Module(
            names.make(f"support_{i}", "support"),
            module_type,
            mount_on_root(x, y, height - frame_height),
            {"height": height},
            comments=["assumed: original files do not contain passive wheels"],
        )
        for i, (x, y) in enumerate(positions)
    ]


def _caster_positions(points: Sequence[Point], frame_center_x: float) -> list[Point]:
    """Returns the positions of two casters (x, y in m) in ``base_link``.

    The driven wheels are on one straight line, which usually is an axle across the robot.  If the
    wheels are in line along the x axis, as on a bicycle, one caster is placed on each side of the
    robot.
    """
    x = float_sum(point[0] for point in points) / len(points)
    y = float_sum(point[1] for point in points) / len(points)
    half_length = max(abs(point[0] - x) for point in points)
    half_width = max(abs(point[1] - y) for point in points)
    half_track = max(0.3, half_width)
    if half_length > half_width:  # the wheels are in line as on a bicycle: one caster on each side
        return [(x, y + 0.4), (x, y - 0.4)]
    if abs(frame_center_x - x) > 0.15:  # axle at one end of the frame: casters at the other end
        distance = max(2.0 * abs(frame_center_x - x), _LEAST_WHEELBASE)
        caster_x = x + math.copysign(distance, frame_center_x - x)
        return [(caster_x, y + half_track), (caster_x, y - half_track)]
    if len(set(points)) == 1:  # a single wheel
        return [(x - 0.8, y + 0.4), (x - 0.8, y - 0.4)]
    return [(x + 0.6, y), (x - 0.6, y)]  # axle in the middle: one caster in front, one behind


def mount_position(module: Module) -> Point:
    """Returns the x and y coordinates (m) where a module is mounted.

    Raises ``TypeError`` if the module has no mount with a position.
    """
    xyz = module.mount["xyz"] if module.mount is not None else None
    if not isinstance(xyz, list) or not isinstance(xyz[0], float) or not isinstance(xyz[1], float):
        raise TypeError(f"{module.name} has no position")
    return xyz[0], xyz[1]


def _are_on_a_line(points: Sequence[Point]) -> bool:
    x0, y0 = points[0]
    farthest = max(points, key=lambda point: math.hypot(point[0] - x0, point[1] - y0))
    dx, dy = farthest[0] - x0, farthest[1] - y0
    length = math.hypot(dx, dy)
    if length < 1e-6:
        return True
    # The distance of a point from a straight line is the cross product divided by the length.
    return all(abs((x - x0) * dy - (y - y0) * dx) / length < _ON_LINE for x, y in points)
