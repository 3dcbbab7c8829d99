"""Length, width, height, wheelbase, track and ground clearance of a robot."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from thorvaldc.model import (
    MeshShape,
    Robot,
    Vec3,
    Wheel,
)
from thorvaldc.model import quantities as si
from thorvaldc.model.statics.convex_bodies import bounds_of
from thorvaldc.model.statics.ground_contacts import with_ground_contacts
from thorvaldc.model.statics.joint_tree import JointTree, tree_of
from thorvaldc.model.statics.occupied_space import solids_of

_SMALLEST_DISTANCE = 1e-3
"""A wheelbase or track below this distance (m) is no distance between two axles."""


@dataclass(frozen=True, slots=True)
class Size:
    """Extents of a robot with all joints at position 0, in m.

    - ``length``, ``width``, ``height``: extents along x, y and z of ``base_link``. The height is
      measured from the ground.
    - ``lower``, ``upper``: corners of the box around the robot in ``base_link``.
    - ``wheelbase``, ``track``: largest distance of two wheels along x and along y, or ``None`` if
      all wheels are in one line. A wheel that steers or swivels counts where its axis meets the
      ground.
    - ``ground_clearance``: height of the lowest part that does not roll or stand on the ground, or
      ``None`` without parts.
    - ``lowest_module``: path of the module with that part.
    - ``meshes_left_out``: names of mesh files whose bytes the model does not contain.
    """

    length: si.Metres
    width: si.Metres
    height: si.Metres
    lower: si.Position
    upper: si.Position
    wheelbase: si.Metres | None
    track: si.Metres | None
    ground_clearance: si.Metres | None
    lowest_module: str
    meshes_left_out: tuple[str, ...]


def size_of(robot: Robot) -> Size:
    """Return the size of a robot, from the solids of ``model.statics.occupied_space``."""
    tree = tree_of(robot)
    left_out: dict[str, None] = {}
    boxes: list[tuple[str, Vec3, Vec3]] = []
    for name, solids in solids_of(robot).items():
        for shape, pose, data in solids:
            box = bounds_of(shape, tree.pose[name] * pose, data)
            if box is not None:
                boxes.append((name, *box))
            elif isinstance(shape, MeshShape):
                left_out[shape.mesh] = None
    lower = _corner(min, (box[1] for box in boxes))
    upper = _corner(max, (box[2] for box in boxes))
    rolling = rolling_links(tree, with_ground_contacts(robot).wheels)
    lowest = min(
        (box for box in boxes if box[0] not in rolling), key=lambda box: box[1][2], default=None
    )
    return Size(
        length=upper[0] - lower[0],
        width=upper[1] - lower[1],
        height=upper[2],
        lower=lower,
        upper=upper,
        wheelbase=_spread(wheel.x for wheel in robot.wheels),
        track=_spread(wheel.y for wheel in robot.wheels),
        ground_clearance=lowest[1][2] if lowest is not None else None,
        lowest_module=tree.links[lowest[0]].module if lowest is not None else "",
        meshes_left_out=tuple(left_out),
    )


def _corner(choose: Callable[[list[float]], float], corners: Iterable[Vec3]) -> Vec3:
    points = list(corners) or [(0.0, 0.0, 0.0)]
    x, y, z = (choose(list(values)) for values in zip(*points, strict=True))
    return x, y, z


def _spread(values: Iterable[float]) -> float | None:
    """Return the difference of the largest and the smallest value, or ``None`` for less than a
    millimetre."""
    ordered = sorted(values)
    spread = ordered[-1] - ordered[0] if ordered else 0.0
    return spread if spread >= _SMALLEST_DISTANCE else None


def rolling_links(tree: JointTree, wheels: Iterable[Wheel]) -> set[str]:
    """Return the names of the links that turn with a wheel, such as tyre and hub."""
    names: set[str] = set()
    for wheel in wheels:
        names.update(tree.links_below(tree.joints[wheel.spin_joint].child))
    return names
