"""Ways in which the world of a driving robot breaks, and a MuJoCo scene in which they do.

A class of breaks draws a random ``Break``.  A break changes the physics, and nothing that is
measured or commanded:

- ice, or a wheel in the air: the friction of the contact is small, or none;
- mud: the joint of a wheel gets Coulomb friction, so that its motor stalls or is slower;
- a body that is held, or that lies on the ground with its belly: Coulomb friction of the body;
- a wall: a box across the robot's path;
- a trailer, a tug and a hand: a force at a point of the body, towards a velocity.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any, NamedTuple

import mujoco

from thorvaldc.model import Robot
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.simulation.physics.drive_servos import set_hard_friction
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.physics.sim_base import WheelErrors

_WALL = "bench_wall"
_WALL_SIZE = (0.5, 20.0, 2.0)
_AWAY = (0.0, 0.0, -100.0)
_WALL_FRICTION = 0.3
_UNMOVABLE = 1e5
"""Friction (N) of a body that no robot moves."""
_PULL_GAIN = 25.0
"""Gain (1/s) of a pull: force per mass and difference of velocities."""
_HITCH_HEIGHT = 0.1
"""Height (m) of the hitch, at which no robot falls over."""


class Break(NamedTuple):
    """What happens to the world at once.

    - ``slippery``: wheels whose contact has the coefficient ``friction``.
    - ``slippery_after``: time (s) from the break to that.
    - ``stalled``: wheels whose joints have the Coulomb friction ``resistance`` (N m).
    - ``hold``: Coulomb friction (N) of the body; its lever arm for the yaw is ``arm`` (m).
    - ``wall``: a wall stands directly ahead.
    - ``pull``: largest force (N); it acts at ``hitch`` (m, in ``base_link``) towards the velocity
      ``drawn`` (m/s, in the world).
    """

    slippery: tuple[int, ...] = ()
    friction: float = 0.0
    slippery_after: float = 0.0
    stalled: tuple[int, ...] = ()
    resistance: float = 0.0
    hold: float = 0.0
    arm: float = 0.4
    wall: bool = False
    pull: float = 0.0
    hitch: tuple[float, float] = (0.0, 0.0)
    drawn: tuple[float, float] = (0.0, 0.0)


class Body(NamedTuple):
    """What a break depends on.

    - ``wheels``: wheels that do not swivel.
    - ``sides``: those of the left and of the right side.
    - ``weight``: N.
    - ``torque``: largest torque (N m) of a drive.
    - ``half_length``: largest x (m) of a wheel.
    - ``direction``: direction (rad) of the motion in the world.
    """

    wheels: tuple[int, ...]
    sides: tuple[tuple[int, ...], ...]
    weight: float
    torque: float
    half_length: float
    direction: float


Draw = Callable[[random.Random, Body], Break]


def _some(rng: random.Random, wheels: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(sorted(rng.sample(wheels, rng.randint(1, len(wheels)))))


def _nothing(rng: random.Random, body: Body) -> Break:
    return Break()


def _ice(rng: random.Random, body: Body) -> Break:
    return Break(slippery=_some(rng, body.wheels), friction=rng.uniform(0.01, 0.1))


def _wall(rng: random.Random, body: Body) -> Break:
    return Break(wall=True)


def _wall_and_ice(rng: random.Random, body: Body) -> Break:
    return _ice(rng, body)._replace(wall=True, slippery_after=rng.uniform(0.0, 1.0))


def _wall_then_ice_under(count: int) -> Draw:
    """Returns the break of a wall and, 0.6 s later, of ice under ``count`` wheels."""

    def draw(rng: random.Random, body: Body) -> Break:
        slippery = tuple(sorted(rng.sample(body.wheels, count)))
        return Break(slippery=slippery, friction=0.05, slippery_after=0.6, wall=True)

    return draw


def _held(rng: random.Random, body: Body) -> Break:
    return _ice(rng, body)._replace(hold=_UNMOVABLE)


def _high_centred(rng: random.Random, body: Body) -> Break:
    hanging = _some(rng, body.wheels)
    carried = body.weight * len(hanging) / len(body.wheels)
    return Break(slippery=hanging, hold=rng.uniform(0.2, 0.6) * carried)


def _wheel_in_the_air(rng: random.Random, body: Body) -> Break:
    return Break(slippery=(rng.choice(body.wheels),))


def _trailer(rng: random.Random, body: Body) -> Break:
    """A trailer that rolls backwards, not exactly behind the robot."""
    angle = body.direction + math.pi + rng.uniform(-0.6, 0.6)
    return Break(
        pull=rng.uniform(0.1, 0.9) * body.weight,
        hitch=(-math.copysign(body.half_length, math.cos(angle - math.pi)), 0.0),
        drawn=(math.cos(angle), math.sin(angle)),
    )


def _tug(rng: random.Random, body: Body) -> Break:
    speed, angle = rng.uniform(0.3, 1.0), rng.uniform(-math.pi, math.pi)
    half = body.half_length
    return Break(
        pull=rng.uniform(0.1, 1.2) * body.weight,
        hitch=(rng.uniform(-half, half), rng.uniform(-half, half)),
        drawn=(speed * math.cos(angle), speed * math.sin(angle)),
    )


def _mud(rng: random.Random, body: Body) -> Break:
    side = rng.choice([side for side in body.sides if side] or [body.wheels])
    return Break(
        slippery=side,
        friction=rng.uniform(0.2, 0.7),
        stalled=side,
        resistance=rng.uniform(0.5, 2.0) * body.torque,
    )


GOOD_GROUND = "good ground"
CLASSES: dict[str, Draw] = {
    GOOD_GROUND: _nothing,
    "ice": _ice,
    "wall": _wall,
    "wall and ice": _wall_and_ice,
    "held body": _held,
    "high-centred": _high_centred,
    "wheel in the air": _wheel_in_the_air,
    "trailer": _trailer,
    "tug": _tug,
    "push at rest": _tug,
    "mud on one side": _mud,
}
AT_REST = ("push at rest",)
"""Classes in which zero is commanded."""


class Case(NamedTuple):
    """A class with a fixed twist, largest torque (N m) of the drives, and duration (s)."""

    draw: Draw
    twist: tuple[float, float, float]
    torque: float
    seconds: float


CASES: dict[str, Case] = {
    "wall, 1 on ice": Case(_wall_then_ice_under(1), (0.6, 0.0, 0.0), 22.0, 9.0),
    "wall, 2 on ice, in a turn": Case(_wall_then_ice_under(2), (0.4, 0.0, 0.1), 22.0, 9.0),
}


class World:
    """A MuJoCo scene with one robot, which breaks and is whole again after ``restart``."""

    def __init__(self, robot: Robot, files: dict[str, bytes]) -> None:
        self.robot = robot
        self.scene = scene = MujocoScene(files, prepare=_add_wall)
        self._model = model = scene.model
        self._changed = (
            model.geom_friction,
            model.dof_frictionloss,
            model.dof_solimp,
            model.actuator_forcerange,
        )
        self._whole = [array.copy() for array in self._changed]
        self._body = scene.index("body", robot.prefix + robot.links[0].name, robot)
        self._first_dof = int(model.body_dofadr[self._body])
        self._spin = [
            scene.index("joint", robot.prefix + wheel.spin_joint, robot) for wheel in robot.wheels
        ]
        wall = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, _WALL)
        self._wall = int(model.body_mocapid[wall])
        self._drives: list[tuple[int, int]] = []
        for i, wheel in enumerate(robot.wheels):
            actuator = robot.actuator_of(wheel.spin_joint)
            if actuator is not None:
                name = robot.prefix + actuator.name
                self._drives.append((i, scene.index("actuator", name, robot)))
        self.base = MujocoBase(robot, scene)

    def restart(self, torque: float, errors: WheelErrors) -> MujocoBase:
        """Returns a base at rest on good ground, with this largest torque (N m) of the drives."""
        for array, values in zip(self._changed, self._whole, strict=True):
            array[:] = values
        for _, motor in self._drives:
            self._model.actuator_forcerange[motor] = (-torque, torque)
        self.scene.data.mocap_pos[self._wall] = _AWAY
        self.scene.reset()
        self.scene.data.mocap_pos[self._wall] = _AWAY
        self.base = MujocoBase(self.robot, self.scene, wheel_errors=errors)
        return self.base

    def torques(self, limit: float) -> list[float]:
        """Returns the torque of each wheel's motor relative to its limit (N m)."""
        shares = [0.0] * len(self.robot.wheels)
        for i, motor in self._drives:
            shares[i] = float(self.scene.data.actuator_force[motor]) / limit
        return shares

    def begin(self, change: Break, direction: float) -> None:
        """Breaks the world, except for ``slippery`` and ``pull``.

        ``direction``: direction (rad) in which a wall stands.
        """
        model = self._model
        for i in change.stalled:
            dof = int(model.jnt_dofadr[self._spin[i]])
            set_hard_friction(model, dof, model.dof_frictionloss[dof] + change.resistance)
        if change.hold:
            for k, arm in ((0, 1.0), (1, 1.0), (5, change.arm)):
                set_hard_friction(model, self._first_dof + k, change.hold * arm)
        if change.wall:
            self._put_wall(direction)

    def make_slippery(self, change: Break) -> None:
        """Sets the friction of the slippery wheels.

        The torsional friction is proportional to the sliding friction.
        """
        model, own = self._model, self._whole[0]
        for i in change.slippery:
            body = int(model.jnt_bodyid[self._spin[i]])
            first = int(model.body_geomadr[body])
            for geom in range(first, first + int(model.body_geomnum[body])):
                model.geom_friction[geom, :2] = own[geom, :2] * (change.friction / own[geom, 0])

    def pull(self, change: Break) -> None:
        """Sets the force of the break for the present velocity of its hitch."""
        data = self.scene.data
        pose, twist = self.base.true_pose(), self.base.true_twist()
        c, s = math.cos(pose.yaw), math.sin(pose.yaw)
        x, y = change.hitch
        vx, vy = twist.vx - twist.wz * y, twist.vy + twist.wz * x
        gain = _PULL_GAIN * self.robot.inertial.mass
        fx = gain * (change.drawn[0] - (c * vx - s * vy))
        fy = gain * (change.drawn[1] - (s * vx + c * vy))
        share = min(1.0, change.pull / max(math.hypot(fx, fy), 1e-9))
        fx, fy = share * fx, share * fy
        # The force acts in the centre of mass of the body, and the torque moves it to the hitch.
        centre = data.xipos[self._body].tolist()
        rx, ry = pose.x + c * x - s * y - centre[0], pose.y + s * x + c * y - centre[1]
        rz = _HITCH_HEIGHT - centre[2]
        data.xfrc_applied[self._body] = (fx, fy, 0.0, -rz * fy, rz * fx, rx * fy - ry * fx)

    def _put_wall(self, direction: float) -> None:
        """Puts the wall directly ahead of the foremost point of the robot."""
        data, model = self.scene.data, self._model
        c, s = math.cos(direction), math.sin(direction)
        ahead = max(
            _extent(model, data, geom, c, s)
            for geom in range(model.ngeom)
            if model.geom_conaffinity[geom] > 1
        )
        pose = self.base.true_pose()
        along = ahead + _WALL_SIZE[0] + 0.01 - (c * pose.x + s * pose.y)
        data.mocap_pos[self._wall] = (pose.x + c * along, pose.y + s * along, _WALL_SIZE[2])
        data.mocap_quat[self._wall] = (math.cos(direction / 2), 0.0, 0.0, math.sin(direction / 2))


def body_of(robot: Robot, torque: float, direction: float) -> Body:
    """Returns what a break depends on."""
    wheels = [(i, wheel) for i, wheel in enumerate(robot.wheels) if wheel.swivel_joint is None]
    return Body(
        tuple(i for i, _ in wheels),
        tuple(tuple(i for i, w in wheels if side * w.y > 0.05) for side in (1, -1)),
        robot.inertial.mass * GRAVITY,
        torque,
        max(abs(wheel.x) for wheel in robot.wheels),
        direction,
    )


def _extent(model: Any, data: Any, geom: int, c: float, s: float) -> float:
    """Returns how far (m) the bounding box of a geom reaches in the direction (c, s)."""
    box = model.geom_aabb[geom].tolist()
    rotation = data.geom_xmat[geom].reshape(3, 3)
    along = (c * rotation[0] + s * rotation[1]).tolist()
    x, y, _ = data.geom_xpos[geom].tolist()
    centre = sum(a * b for a, b in zip(along, box[:3], strict=True))
    return float(
        c * x + s * y + centre + sum(abs(a) * b for a, b in zip(along, box[3:], strict=True))
    )


def _add_wall(spec: Any) -> None:
    body = spec.worldbody.add_body(name=_WALL, mocap=True, pos=_AWAY)
    body.add_geom(
        name=_WALL,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=_WALL_SIZE,
        contype=0,
        conaffinity=1,
        priority=2,
        condim=3,
        friction=(_WALL_FRICTION, 0.0, 0.0),
    )
