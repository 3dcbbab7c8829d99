"""Takes the torque from motors of a robot in a MuJoCo scene, and closes their brakes.

A servo without power has the force range 0, which keeps its gains for other changes of the scene.
The friction of the motor and its gear, and a closed brake, are Coulomb friction of the joint
(``frictionloss`` of MuJoCo)::

    frictionloss   C + B                   without power, with the back-driving torque B
                   C + B + H               ... and with a brake that has closed, of the torque H
                   C                       with power, as in the MJCF file

MuJoCo's friction is soft: with its default impedance, a joint creeps under load (16 mm/s at a wheel
on a slope of 15 degrees).  A joint without power has ``IMPEDANCE``, with which it stands.

A servo overcomes the friction of its own gear, so the friction of a joint with power is unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from thorvaldc.model import Actuator, Brake, Robot
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

IMPEDANCE = 0.9999
"""Impedance of the friction of a joint without power (``solimp`` of MuJoCo)."""


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
        model.dof_frictionloss[motor.dof] = motor.friction + motor.back_driving_torque
        model.dof_solimp[motor.dof, :2] = IMPEDANCE
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
