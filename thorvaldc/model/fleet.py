"""Several robots in one scene, and the world around the robots. All values of the fleet model are
in SI units."""

from __future__ import annotations

from dataclasses import dataclass, replace

from thorvaldc.model import quantities as si
from thorvaldc.model.robot import Robot
from thorvaldc.model.shapes import Shape
from thorvaldc.model.spatial import Pose


@dataclass(frozen=True, slots=True)
class Placement:
    """A robot of a fleet.

    - ``name``: name and name space of the robot in the scene.
    - ``pose``: pose of the robot's ``base_link`` in the world.
    - ``robot``: the robot; its name space becomes ``name``.
    """

    name: str
    pose: Pose
    robot: Robot

    def __post_init__(self) -> None:
        if self.robot.namespace != self.name:
            object.__setattr__(self, "robot", replace(self.robot, namespace=self.name))

    def __repr__(self) -> str:
        x, y, z = self.pose.xyz
        return f"<Placement {self.name}: {self.robot.name} at ({x:g}, {y:g}, {z:g}) m>"


@dataclass(frozen=True, slots=True)
class HeightMap:
    """Heights of the ground on a regular grid, from a file of a scenario.

    - ``center``: position x, y of the centre of the grid in m.
    - ``size``: edge lengths of the grid in m along x and y.
    - ``rows``: heights in m above the lowest one, one row for each y coordinate, with increasing x
      and y.
    """

    center: tuple[si.Metres, si.Metres]
    size: tuple[si.Metres, si.Metres]
    rows: tuple[tuple[si.Metres, ...], ...]

    def height(self, x: float, y: float) -> float:
        """Return the height in m at a position in m, bilinear between the points of the grid.

        The height outside of the grid is 0.
        """
        counts = (len(self.rows[0]), len(self.rows))
        places = [
            ((value - center) / edge + 0.5) * (count - 1)
            for value, center, edge, count in zip(
                (x, y), self.center, self.size, counts, strict=True
            )
        ]
        if not all(0.0 <= place <= count - 1 for place, count in zip(places, counts, strict=True)):
            return 0.0
        (i, j) = (min(int(place), count - 2) for place, count in zip(places, counts, strict=True))
        u, v = places[0] - i, places[1] - j
        below, above = self.rows[j], self.rows[j + 1]
        return (1.0 - v) * ((1.0 - u) * below[i] + u * below[i + 1]) + v * (
            (1.0 - u) * above[i] + u * above[i + 1]
        )


@dataclass(frozen=True, slots=True)
class Ground:
    """The ground on which the robots of a scene drive. The poses of the robots are relative to the
    ground plane z = 0.

    - ``angle``: inclination of the ground in rad.
    - ``direction``: uphill direction in rad, measured from x to y.
    - ``amplitude``: largest height of the random bumps above and below the plane in m, 0 for no
      bumps.
    - ``wavelength``: shortest wavelength of the bumps in m.
    - ``seed``: seed of the random number generator for the bumps.
    - ``size``: edge lengths in m along x and y of the bumpy rectangle around the origin.
    - ``heights``: the heights of the ground, or ``None`` for a plane and random bumps.
    """

    angle: si.Radians = 0.0
    direction: si.Radians = 0.0
    amplitude: si.Metres = 0.0
    wavelength: si.Metres = 1.0
    seed: int = 0
    size: tuple[si.Metres, si.Metres] = (30.0, 30.0)
    heights: HeightMap | None = None

    @property
    def even(self) -> bool:
        """True if the ground is a plane: without bumps and without a height map."""
        return not self.amplitude and self.heights is None


@dataclass(frozen=True, slots=True)
class Zone:
    """A rectangular zone of the ground, whose centre has the pose ``pose``.

    - ``size``: edge lengths of the zone in m along x and y.
    - ``friction``, ``rolling_resistance``: coefficients of the wheels in the zone, or ``None`` if
      each wheel keeps its own coefficient.
    - ``height``: height of the zone above the ground in m.
    - ``slope``: angle of the sides of a raised zone in rad.
    - ``amplitude``: largest height of the random bumps above and below their mean in m.
    - ``wavelength``: shortest wavelength of the bumps in m.
    - ``seed``: seed of the random number generator for the bumps.
    """

    pose: Pose
    size: tuple[si.Metres, si.Metres]
    friction: si.Number | None = None
    rolling_resistance: si.Number | None = None
    height: si.Metres = 0.0
    slope: si.Radians = 0.0
    amplitude: si.Metres = 0.0
    wavelength: si.Metres = 1.0
    seed: int = 0

    @property
    def level(self) -> bool:
        """True if the zone of the ground is level: not raised and without bumps."""
        return not (self.height or self.amplitude)

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point of the ground (m) is in the zone."""
        local = self.pose.inverse().apply((x, y, self.pose.xyz[2]))
        return all(abs(local[i]) <= self.size[i] / 2 for i in range(2))


@dataclass(frozen=True, slots=True)
class Block:
    """A fixed body of the scene.

    - ``kind``: ``kerb``, ``rail``, ``obstacle``, ``crop`` or ``post``. A fixed body of the kind
      kerb or rail may carry wheels.
    - ``name``: name of the body, unique among the bodies of the same kind.
    - ``shape``, ``pose``: shape of the body, and its pose in the world.
    """

    kind: str
    name: str
    shape: Shape
    pose: Pose


@dataclass(frozen=True, slots=True)
class World:
    """The surroundings of the robots: the ground, fixed bodies and zones of the ground.

    - ``blocks``: fixed bodies, such as kerbs, rails and obstacles.
    - ``zones``: parts of the ground with other properties.
    """

    ground: Ground
    blocks: tuple[Block, ...] = ()
    zones: tuple[Zone, ...] = ()


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Fleet:
    """Several robots in one scene, in the order of the fleet file.

    - ``name``: name of the fleet.
    - ``description``: text of the fleet file, for people.
    - ``placements``: the robots with their poses.
    - ``world``: surroundings of the robots, or ``None`` for level ground without other bodies.
    """

    name: str
    description: str
    placements: tuple[Placement, ...]
    world: World | None = None

    def __repr__(self) -> str:
        robots = f"{len(self.placements)} robot{'' if len(self.placements) == 1 else 's'}"
        return f"<Fleet {self.name}: {robots}>"


def robots_by_name(model: Robot | Fleet) -> dict[str, Robot]:
    """Return the robots of a fleet, or the robot itself, by their names in the scene."""
    if isinstance(model, Fleet):
        return {placement.name: placement.robot for placement in model.placements}
    return {model.name: model}
