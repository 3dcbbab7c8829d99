"""Limits the integrators of the drive servos of a MuJoCo model, and switches motors off.

A drive servo of the generated MJCF files (``intvelocity``) integrates the commanded speed u to a
position set point s.  With the joint position q, the joint speed w, the gains kp and kv, and the
largest torque T, the torque of the drive servo is::

    torque = min(max(kp (s - q) - kv w, -T), T),   s' = u

The drive servo is a velocity controller with proportional and integral action, because s - q is
the integral of the speed error u - w.  MuJoCo can limit the set point s only to a fixed range, and
not to a range around the joint position q.  Without a limit, the set point of a blocked wheel runs
away, and the wheel continues to push after a stop.  ``DriveServos`` adds two rules:

- Limit: the unlimited torque kp (s - q) - kv w stays between -T and T.  The set point s of a
  blocked wheel is thus never further ahead than T / kp.
- Release: when the commanded speed becomes zero while a drive of the robot is above its release
  torque, the set points s of all drives follow their joints for ``RELEASE_TIME``.  The drive servos
  brake the wheels in this time, but do not push.  After this time, they hold the positions of the
  wheels.

A limit alone does not end the push, because a limited integrator keeps its value while the speed
error is zero.  A drive servo cannot distinguish an obstacle from a slope: in both cases, the wheel
stands under load.  Only the size of the load tells them apart: at an obstacle, the torque grows
until the drive is at its limit, or until the wheel spins.  With the weight G of the robot, the
wheel radius r and n drives::

    release torque = RELEASE_LOAD G r / n

The price: on a slope of more than asin(RELEASE_LOAD), a robot rolls back by some centimetres before
its drives hold it, and a robot that pushes against an obstacle with less than RELEASE_LOAD G
continues to push.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple

from thorvaldc.model import Actuator, Brake, Robot
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

_JOINT: Final = 0  # mjTRN_JOINT of MuJoCo
_ELLIPSOID: Final = 4  # mjGEOM_ELLIPSOID of MuJoCo
RELEASE_TIME: Final = 0.3
"""Time (s) after a stop command in which the set point of a loaded drive follows the joint."""
RELEASE_LOAD: Final = 0.3
"""Share of the robot's weight as a driving force, above which the drives release it at a stop.

The share is that of a slope of 17 degrees.
"""


class _Servo(NamedTuple):
    """The indices and gains of one drive servo.

    - ``actuator``, ``activation``, ``position``, ``speed``: indices in the views of ``ctrl``,
      ``act``, ``qpos`` and ``qvel``.
    - ``stiffness``: kp in N m/rad.
    - ``damping``: kv in N m s/rad.
    - ``torque``: largest torque in N m.
    - ``release``: release torque in N m.
    """

    actuator: int
    activation: int
    position: int
    speed: int
    stiffness: float
    damping: float
    torque: float
    release: float


class DriveServos:
    """The drive servos of a MuJoCo model, with limited integrators.

    ``model`` is the ``MjModel``, and ``data`` is the ``MjData``.  ``actuators`` are the MuJoCo
    indices of the drives.  By default, all servos with an integrator that turn a wheel are drives:
    the generated MJCF files give wheels, and nothing else, an ellipsoid that collides.  Call
    ``limit`` after every simulation step, or at least once per control cycle::

        servos = DriveServos(model, data)
        while data.time < 10.0:
            mujoco.mj_step(model, data)
            servos.limit()
    """

    def __init__(self, model: Any, data: Any, actuators: Iterable[int] | None = None) -> None:
        self._data = data
        if actuators is None:
            actuators = [i for i in range(model.nu) if _turns_wheel(model, i)]
        indices = [
            int(i)
            for i in actuators
            if model.actuator_actadr[i] >= 0 and model.actuator_biasprm[i, 1] < 0.0
        ]
        joints = [int(model.actuator_trnid[i, 0]) for i in indices]
        bodies = [int(model.jnt_bodyid[joint]) for joint in joints]
        roots = [int(model.body_rootid[body]) for body in bodies]
        # Views of the MuJoCo arrays.  Creating a view takes several times as long as reading it.
        self._ctrl, actuators = _part(data.ctrl, indices)
        self._act, activations = _part(data.act, [int(model.actuator_actadr[i]) for i in indices])
        self._qpos, positions = _part(data.qpos, [int(model.jnt_qposadr[j]) for j in joints])
        self._qvel, speeds = _part(data.qvel, [int(model.jnt_dofadr[j]) for j in joints])
        # Indices of the drives of the same robot, for each drive.
        self._robots = [[k for k, other in enumerate(roots) if other == root] for root in roots]
        self._servos = []
        for k, (i, body, root) in enumerate(zip(indices, bodies, roots, strict=True)):
            _, stiffness, damping = (-v for v in model.actuator_biasprm[i, :3].tolist())
            weight = float(model.body_subtreemass[root]) * GRAVITY
            self._servos.append(
                _Servo(
                    actuators[k],
                    activations[k],
                    positions[k],
                    speeds[k],
                    stiffness,
                    damping,
                    float(model.actuator_forcerange[i, 1]),
                    RELEASE_LOAD * weight * _radius(model, body) / roots.count(root),
                )
            )
        self._reset(float(data.time))

    def _reset(self, time: float) -> None:
        self._time = time
        self._commands = [0.0] * len(self._servos)
        """Last commanded speed (rad/s) of each drive servo."""
        self._stops = [-math.inf] * len(self._servos)
        """Time (s) of the last stop command of each drive servo while the robot was under a large
        load."""

    def limit(self) -> None:
        """Limits the set points of the drive servos in ``data``; see the module.

        The method does nothing while no simulated time passes.  After a reset of the simulated
        time, no drive servo is in its release time.
        """
        now = float(self._data.time)
        if now <= self._time:
            if now < self._time:
                self._reset(now)
            return
        self._time = now
        act: list[float] = self._act.tolist()
        ctrl: list[float] = self._ctrl.tolist()
        qpos: list[float] = self._qpos.tolist()
        qvel: list[float] = self._qvel.tolist()
        commands, stops = self._commands, self._stops
        changed = False
        for i, servo in enumerate(self._servos):
            actuator, activation, position, speed, kp, kv, limit, release = servo
            command = ctrl[actuator]
            damping = kv * qvel[speed]
            torque = kp * (act[activation] - qpos[position]) - damping
            if command != commands[i]:
                if command == 0.0 and not -release < torque < release:
                    for k in self._robots[i]:
                        stops[k] = now
                commands[i] = command
            if command == 0.0 and now < stops[i] + RELEASE_TIME:
                act[activation] = qpos[position]
            elif torque > limit:
                act[activation] = qpos[position] + (limit + damping) / kp
            elif torque < -limit:
                act[activation] = qpos[position] + (damping - limit) / kp
            else:
                continue
            changed = True
        if changed:
            self._act[:] = act


def _part(array: Any, indices: Sequence[int]) -> tuple[Any, list[int]]:
    """Returns the view of an array from the first to the last index, and the indices in the view.

    The arrays of a scene grow with its robots: to read them whole for each robot takes a time that
    grows with the square of the number of robots.
    """
    first, end = min(indices, default=0), max(indices, default=-1) + 1
    return array[first:end], [index - first for index in indices]


def _turns_wheel(model: Any, actuator: int) -> bool:
    """Checks whether an actuator turns a body with an ellipsoid that collides."""
    if model.actuator_trntype[actuator] != _JOINT:
        return False
    body = int(model.jnt_bodyid[model.actuator_trnid[actuator, 0]])
    return any(model.geom_type[geom] == _ELLIPSOID for geom in _colliding_geoms(model, body))


def _radius(model: Any, body: int) -> float:
    """Returns the radius (m) of a wheel: the largest extent of its colliding geoms."""
    return max(
        (float(model.geom_size[g].max()) for g in _colliding_geoms(model, body)), default=0.0
    )


def _colliding_geoms(model: Any, body: int) -> list[int]:
    first = int(model.body_geomadr[body])
    geoms = range(first, first + int(model.body_geomnum[body]))
    return [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]


# -- motors without power --------------------------------------------------------------------------

# A servo without power has the force range 0, which keeps its gains for other changes of the scene.
# The friction of the motor and its gear, and a closed brake, are Coulomb friction of the joint
# (``frictionloss`` of MuJoCo)::
#
#     frictionloss   C + B                   without power, with the back-driving torque B
#                    C + B + H               ... and with a brake that has closed, of the torque H
#                    C                       with power, as in the MJCF file
#
# MuJoCo's friction is soft: with its default impedance, a joint creeps under load (16 mm/s at a
# wheel on a slope of 15 degrees).  A joint without power has ``IMPEDANCE``, with which it stands.
#
# A servo overcomes the friction of its own gear, so the friction of a joint with power is
# unchanged.

IMPEDANCE: Final = 0.9999
"""Impedance of the friction of a joint without power (``solimp`` of MuJoCo)."""


def set_hard_friction(model: Any, dof: int, friction: float) -> None:
    """Sets the Coulomb friction (N or N m) of a degree of freedom, which then does not creep."""
    model.dof_frictionloss[dof] = friction
    model.dof_solimp[dof, :2] = IMPEDANCE


class _Motor(NamedTuple):
    """The MuJoCo indices and values of a motor.

    - ``actuator``, ``activation``, ``position``, ``dof``: indices in the arrays of MuJoCo, and in
      ``act``, ``qpos`` and ``qvel``; ``activation`` is negative for a servo without an integrator.
    - ``range``: smallest and largest torque with power in N m.
    - ``friction``, ``impedance``: friction of the joint with power in N m, and its impedance.
    """

    actuator: int
    activation: int
    position: int
    dof: int
    range: tuple[float, float]
    friction: float
    impedance: tuple[float, float]
    back_driving_torque: float
    brake: Brake | None


class MotorsWithoutPower:
    """The motors of one robot in a scene, with power at first.

    ``motors`` has (wheel index, true for steering, MuJoCo index of the actuator, index of the joint
    in ``qpos``, index in ``qvel``) of each motor.
    """

    def __init__(
        self, scene: MujocoScene, motors: Sequence[tuple[int, bool, int, int, int]], robot: Robot
    ) -> None:
        self._scene = scene
        self._motors: dict[tuple[int, bool], _Motor] = {}
        model = scene.model
        for i, steering, actuator, position, dof in motors:
            wheel = robot.wheels[i]
            part = robot.actuator_of((steering and wheel.steering_joint) or wheel.spin_joint)
            if part is not None:
                self._motors[i, steering] = _motor(model, part, actuator, position, dof)
        self._off: set[tuple[int, bool]] = set()
        self._closing: dict[tuple[int, bool], float] = {}
        """Time (s) at which each open brake of a motor without power closes."""

    def is_off(self, wheel: int, steering: bool) -> bool:
        return (wheel, steering) in self._off

    def advance(self, now: float) -> None:
        """Runs the scene until the time ``now`` (s), and closes brakes at their times."""
        while self._closing:
            key = min(self._closing, key=lambda key: self._closing[key])
            if self._closing[key] > now:
                break
            self._scene.advance(self._closing.pop(key))
            brake = self._motors[key].brake
            if brake is not None:
                self._scene.model.dof_frictionloss[self._motors[key].dof] += brake.torque
        self._scene.advance(now)

    def switch(self, wheel: int, steering: bool, on: bool, now: float) -> None:
        """Switches the power of a motor on or off."""
        key = (wheel, steering)
        if on is not (key in self._off):
            return
        self.advance(now)
        motor, model, data = self._motors[key], self._scene.model, self._scene.data
        if on:
            self._off.discard(key)
            self._closing.pop(key, None)
            model.actuator_forcerange[motor.actuator] = motor.range
            model.dof_frictionloss[motor.dof] = motor.friction
            model.dof_solimp[motor.dof, :2] = motor.impedance
            if motor.activation >= 0:  # hold the present position, not that of the loss of power
                data.act[motor.activation] = data.qpos[motor.position]
            return
        self._off.add(key)
        model.actuator_forcerange[motor.actuator] = 0.0
        set_hard_friction(model, motor.dof, motor.friction + motor.back_driving_torque)
        if motor.brake is not None:
            self._closing[key] = now + motor.brake.closing_time


def _motor(model: Any, part: Actuator, actuator: int, position: int, dof: int) -> _Motor:
    low, high = model.actuator_forcerange[actuator].tolist()
    least, most = model.dof_solimp[dof, :2].tolist()
    return _Motor(
        actuator,
        int(model.actuator_actadr[actuator]),
        position,
        dof,
        (low, high),
        float(model.dof_frictionloss[dof]),
        (least, most),
        part.back_driving_torque,
        part.brake,
    )
