"""Several robots in one scene, and the world that they are in; in SI, as the robots are."""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.model.element import Element
from thorvaldc.model.robot import Robot, Shape
from thorvaldc.model.spatial import Pose


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Placement(Element):
    """A robot of a fleet: its name in the scene, its name space, ``base_link`` in the world."""

    name: str
    pose: Pose
    robot: Robot


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Ground(Element):
    """The ground of a scene, in whose plane z = 0 the robots' poses are given.

    ``angle`` (rad) is its inclination and ``direction`` (rad, from x to y) the way uphill.
    Bumps are -``amplitude``..``amplitude`` high (m; 0: none), no shorter than ``wavelength``
    (m), drawn by ``seed``, on ``size`` (m along x and y, about the origin).
    """

    angle: float = 0.0
    direction: float = 0.0
    amplitude: float = 0.0
    wavelength: float = 1.0
    seed: int = 0
    size: tuple[float, float] = (30.0, 30.0)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Zone(Element):
    """A rectangle of the ground, ``size`` (m) along x and y about the middle of ``pose``.

    ``friction`` and ``rolling_resistance`` are those of wheels in it (``None``: their own).
    It is raised by ``height`` (m) within sides that rise at ``slope`` (rad), and has bumps of
    +-``amplitude`` (m) about their mean, no shorter than ``wavelength`` (m), drawn by ``seed``.
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
        """Whether it is as level as the ground."""
        return not (self.height or self.amplitude)

    def holds(self, x: float, y: float, margin: float = 0.0) -> bool:
        """Whether a place on the ground (m) is in it, or nearer to it than ``margin`` (m)."""
        local = self.pose.inverse().apply((x, y, self.pose.xyz[2]))
        return all(abs(local[i]) <= self.size[i] / 2 + margin for i in range(2))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Block(Element):
    """A thing that does not move.  ``kind``: ``kerb``, ``rail``, ``obstacle``, ``crop``, ``post``.

    Wheels may roll on kerbs and rails.  ``name`` is its own within the kind.
    """

    kind: str
    name: str
    shape: Shape
    pose: Pose


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class World(Element):
    """What the robots of a scene stand on and what stands around them."""

    ground: Ground
    blocks: tuple[Block, ...] = ()
    zones: tuple[Zone, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Fleet(Element):
    """Several robots in one scene, in file order.  ``world`` ``None``: level ground alone."""

    name: str
    description: str
    placements: tuple[Placement, ...]
    world: World | None = None
