"""Several robots in one scene, and their world.  All values in SI."""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.model.element import Element
from thorvaldc.model.robot import Robot, Shape
from thorvaldc.model.spatial import Pose


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Placement(Element):
    """A robot of a fleet.

    ``name`` is its name in the scene and its name space, ``pose`` that of its ``base_link`` in the
    world.
    """

    name: str
    pose: Pose
    robot: Robot


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Ground(Element):
    """The ground of a scene.  The poses of the robots are relative to its plane z = 0.

    ``angle`` (rad) is its inclination and ``direction`` (rad, from x to y) the uphill direction.
    It has random bumps of +-``amplitude`` (m; 0: none), no shorter than ``wavelength`` (m), with
    the random seed ``seed``, on a rectangle of ``size`` (m along x and y) around the origin.
    """

    angle: float = 0.0
    direction: float = 0.0
    amplitude: float = 0.0
    wavelength: float = 1.0
    seed: int = 0
    size: tuple[float, float] = (30.0, 30.0)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Zone(Element):
    """A rectangle of the ground, of ``size`` (m along x and y), centred on ``pose``.

    ``friction`` and ``rolling_resistance`` apply to wheels in the zone (``None``: the
    values of each wheel apply).  The zone is raised by ``height`` (m), with sides that rise at
    ``slope`` (rad).  It has random bumps of +-``amplitude`` (m) around their mean, no
    shorter than ``wavelength`` (m), with the random seed ``seed``.
    """

    pose: Pose
    size: tuple[float, float]
    friction: float | None = None
    rolling_resistance: float | None = None
    height: float = 0.0
    slope: float = 0.0
    amplitude: float = 0.0
    wavelength: float = 1.0
    seed: int = 0

    @property
    def level(self) -> bool:
        """True if the zone neither rises above the ground nor has bumps."""
        return not (self.height or self.amplitude)

    def holds(self, x: float, y: float, margin: float = 0.0) -> bool:
        """Return whether a point of the ground (m) is in the zone, or within ``margin`` m of it."""
        local = self.pose.inverse().apply((x, y, self.pose.xyz[2]))
        return all(abs(local[i]) <= self.size[i] / 2 + margin for i in range(2))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Block(Element):
    """A fixed body of the scene.

    ``kind`` is ``kerb``, ``rail``, ``obstacle``, ``crop`` or ``post``.  Wheels may roll on kerbs
    and rails.  ``name`` is unique within the kind.
    """

    kind: str
    name: str
    shape: Shape
    pose: Pose


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class World(Element):
    """The surroundings of the robots: the ground, fixed bodies, zones of the ground."""

    ground: Ground
    blocks: tuple[Block, ...] = ()
    zones: tuple[Zone, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Fleet(Element):
    """Several robots in one scene, in file order.  ``world`` is ``None`` for level ground alone."""

    name: str
    description: str
    placements: tuple[Placement, ...]
    world: World | None = None
