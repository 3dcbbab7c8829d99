"""A MuJoCo base with injected faults, sensor noise and ground zones."""

from __future__ import annotations

import hashlib
import math
import random
from collections.abc import Sequence
from typing import Any, Final

from thorvaldc.model import Robot, Zone
from thorvaldc.model.scenario import Noise, WheelFault
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.physics.sim_base import WheelErrors

# -- ground zones and ice --------------------------------------------------------------------------


class GroundZones:
    """Sets the friction and rolling resistance of each wheel from the zone under the wheel.

    The ground zone under the centre of a wheel determines the friction and the rolling resistance
    of the wheel.  If ground zones overlap, the last ground zone in the YAML file applies.  An
    active ``ice`` fault of a wheel overrides the friction of the zone.
    """

    def __init__(
        self, robot: Robot, scene: MujocoScene, zones: Sequence[Zone], ice: Sequence[WheelFault]
    ) -> None:
        self._zones = [
            _Rectangle(zone)
            for zone in zones
            if not (zone.friction is zone.rolling_resistance is None)
        ]
        self._ice = ice
        self._wheels: list[_WheelGround] = []
        if self._zones or ice:
            self._wheels = [_WheelGround(robot, scene, i) for i in range(len(robot.wheels))]

    def update(self, now: float) -> None:
        """Sets the coefficients of all wheels for the current positions of the wheels.

        The ``ice`` faults that are active at the time ``now`` (s) apply.
        """
        for wheel in self._wheels:
            friction = resistance = None
            if self._zones:
                x, y = wheel.position()
                for rectangle in self._zones:
                    if rectangle.contains(x, y):
                        friction = rectangle.zone.friction
                        resistance = rectangle.zone.rolling_resistance
            for fault in self._ice:
                if fault.wheel == wheel.name and fault.start <= now < fault.end:
                    friction = fault.value
            wheel.apply(friction, resistance)

    def restore(self) -> None:
        """Restores the original friction and rolling resistance of all wheels."""
        for wheel in self._wheels:
            wheel.apply(None, None)


class _Rectangle:
    """The rectangle on the ground that a ground zone covers.

    The sine and cosine of the yaw angle of the ground zone are computed only once.
    """

    def __init__(self, zone: Zone) -> None:
        self.zone = zone
        self._x, self._y, _ = zone.pose.xyz
        yaw = zone.pose.rpy()[2]
        self._cos, self._sin = math.cos(yaw), math.sin(yaw)
        self._half_x, self._half_y = (edge / 2 for edge in zone.size)

    def contains(self, x: float, y: float) -> bool:
        """Returns true if the point (``x``, ``y``) in m is inside the ground zone."""
        dx, dy = x - self._x, y - self._y
        return (
            abs(self._cos * dx + self._sin * dy) <= self._half_x
            and abs(self._cos * dy - self._sin * dx) <= self._half_y
        )


class _WheelGround:
    """The entries of the MuJoCo model that describe the contact of one wheel with the ground.

    Rolling resistance is modelled as a friction loss (N m) of the spin joint.  The friction loss
    is the coefficient of rolling resistance times the wheel load at rest (N) times the wheel
    radius (m).
    """

    def __init__(self, robot: Robot, scene: MujocoScene, number: int) -> None:
        wheel = robot.wheels[number]
        joint = scene.index("joint", robot.prefix + wheel.spin_joint, robot)
        model = scene.model
        # The body of the wheel is found by the spin joint, because MuJoCo may have fused the wheel
        # link into another body.
        self._body = int(model.jnt_bodyid[joint])
        self._dof = int(model.jnt_dofadr[joint])
        first = int(model.body_geomadr[self._body])
        self._geoms = [
            geom
            for geom in range(first, first + int(model.body_geomnum[self._body]))
            if int(model.geom_contype[geom]) or int(model.geom_conaffinity[geom])
        ]
        self.name = wheel.name
        self._data, self._model = scene.data, model
        self._own_frictions = [model.geom_friction[geom].copy() for geom in self._geoms]
        self._own_loss = float(model.dof_frictionloss[self._dof])
        self._load_radius = wheel.load * wheel.radius
        self._own_resistance = wheel.rolling_resistance
        self._applied: tuple[float | None, float | None] = (None, None)

    def position(self) -> tuple[float, float]:
        """Returns the position (x, y) in m of the wheel at the last simulation step."""
        x, y, _ = self._data.xpos[self._body].tolist()
        return x, y

    def apply(self, friction: float | None, resistance: float | None) -> None:
        """Sets the coefficients of friction and rolling resistance of the wheel.

        If a coefficient is ``None``, the original coefficient of the wheel applies.
        """
        if (friction, resistance) == self._applied:
            return
        self._applied = (friction, resistance)
        for geom, own in zip(self._geoms, self._own_frictions, strict=True):
            # The coefficient of torsional friction (m) is mu * width / 4, with the coefficient of
            # sliding friction mu and the wheel width.  The torsional friction is thus proportional
            # to the coefficient of sliding friction mu.
            ratio = 1.0 if friction is None else friction / own[0] if own[0] else 0.0
            self._model.geom_friction[geom, :2] = own[:2] * ratio
        added = 0.0 if resistance is None else resistance - self._own_resistance
        loss = self._own_loss + added * self._load_radius
        self._model.dof_frictionloss[self._dof] = max(loss, 0.0)


_WHEEL_ERRORS: Final = ("radius_error", "steering_offset")


class _Readings:
    """Joint states as lists, so that noise and injected faults can change the values."""

    def __init__(self, joints: JointStates) -> None:
        self.speeds = list(joints.speeds)
        self.positions = list(joints.positions or ())
        self.angles = list(joints.angles)
        self.rates = list(joints.angle_rates)
        self.yaw_rate: float | None = None


class ScenarioBase(MujocoBase):
    """A MuJoCo base with the injected faults and the sensor noise of a scenario.

    The method ``read`` returns joint states with sensor noise and with the active injected
    faults.  An injected fault with a wrong wheel radius or a wrong steering offset uses the
    ``WheelErrors`` of ``MujocoBase`` while the fault is active.  A failed motor and a wheel on ice
    are changes of the MuJoCo model.  The method ``close`` restores the MuJoCo model.
    """

    def __init__(
        self,
        robot: Robot,
        scene: MujocoScene,
        faults: Sequence[WheelFault] = (),
        noise: Noise | None = None,
        zones: Sequence[Zone] = (),
        *,
        open_loop: bool = False,
    ) -> None:
        super().__init__(robot, scene, open_loop=open_loop)
        self._faults = faults
        self._noise = noise if noise is not None and _is_noisy(noise) else None
        self.is_noisy = self._noise is not None
        self._has_gyro = any(sensor.type == "imu" for sensor in robot.sensors)
        self._encoders = _encoders(robot) if noise is not None and noise.encoder_counts else ()
        self._wheel_index = {wheel.name: i for i, wheel in enumerate(robot.wheels)}
        # Each robot of a scenario has a separate random number generator.  The seed must be equal
        # in every process.  The function hash() of a text differs between processes, but SHA-256
        # does not.
        seed = f"{noise.seed if noise is not None else 0} {robot.namespace}"
        self._random = random.Random(hashlib.sha256(seed.encode()).digest())
        self._ground = GroundZones(robot, scene, zones, [f for f in faults if f.type == "ice"])
        # By the number of the injected fault: (array, index, value) of each entry of the MuJoCo
        # model that the end of the fault restores.
        self._saved: dict[int, list[tuple[Any, Any, Any]]] = {}
        self._frozen: dict[int, float] = {}
        self._no_errors = (self._ratios, self._offsets)
        self._changed_for = -math.inf

    def change_scene(self, now: float) -> None:
        if now == self._changed_for:
            return  # the wheels may have moved since
        self._changed_for = now
        for number, fault in enumerate(self._faults):
            self._switch(number, fault, fault.start <= now < fault.end)
        self._ground.update(now)

    def read(self, now: float) -> JointStates:
        self._ratios, self._offsets = self._no_errors
        joints = super().read(now)
        errors = self._active_wheel_errors(now)
        if errors is None and self._noise is None and not self._faults:
            return joints
        readings = _Readings(joints)
        if errors is not None:
            self._ratios, self._offsets = errors.radius_ratios, errors.steering_offsets
            for i, ratio in enumerate(self._ratios):
                readings.speeds[i] /= ratio
                readings.positions[i] /= ratio
                readings.angles[i] -= self._offsets[i]
        self._disturb(readings, now)
        return JointStates(
            joints.time,
            readings.speeds,
            readings.angles,
            readings.rates,
            readings.positions,
            readings.yaw_rate,
        )

    def motors(self) -> list[int]:
        """Returns the MuJoCo indices of all actuators of the robot."""
        return [actuator for _, actuator in (*self._drive_motors, *self._steering_motors)]

    def close(self) -> None:
        """Removes all injected faults and ground zones from the MuJoCo model."""
        self._ground.restore()
        for number in list(self._saved):
            self._restore(number)

    # -- readings of the driver -------------------------------------------------------

    def _active_wheel_errors(self, now: float) -> WheelErrors | None:
        active = [f for f in self._faults if f.type in _WHEEL_ERRORS and f.start <= now < f.end]
        if not active:
            return None
        return WheelErrors.by_name(
            self.robot,
            {f.wheel: 1.0 + f.value for f in active if f.type == "radius_error"},
            {f.wheel: f.value for f in active if f.type == "steering_offset"},
        )

    def _disturb(self, readings: _Readings, now: float) -> None:
        """Adds the sensor noise and the encoder faults to joint readings.

        The function adds random noise, rounds the positions down to encoder counts, and repeats
        the last reading of an encoder with an active ``encoder_frozen`` fault.
        """
        noise, gauss = self._noise, self._random.gauss
        if noise is not None:
            for i in range(len(readings.speeds)):
                readings.speeds[i] += gauss(0.0, noise.wheel_speed)
                readings.positions[i] += gauss(0.0, noise.wheel_position)
                readings.angles[i] += gauss(0.0, noise.steering_angle)
            if noise.gyro is not None and self._has_gyro:
                rate = float(self.scene.data.qvel[self._base_velocity + 5])
                readings.yaw_rate = rate + noise.gyro_bias + gauss(0.0, noise.gyro)
            for i, is_steering, count, offset in self._encoders:
                values = readings.angles if is_steering else readings.positions
                values[i] = math.floor((values[i] - offset) / count) * count + offset
        for number, fault in enumerate(self._faults):
            if fault.type != "encoder_frozen":
                continue
            i = self._wheel_index[fault.wheel]
            values, rates = readings.positions, readings.speeds
            if fault.motor == "steering":
                values, rates = readings.angles, readings.rates
            if fault.start <= now < fault.end:
                values[i], rates[i] = self._frozen.setdefault(number, values[i]), 0.0
            else:
                self._frozen.pop(number, None)

    # -- changes of the scene ---------------------------------------------------------

    def _switch(self, number: int, fault: WheelFault, active: bool) -> None:
        """Starts or ends an injected fault that changes the MuJoCo model."""
        if active and number not in self._saved:
            self._saved[number] = []
            if fault.type == "motor_lost":
                self._disable_motor(number, self._wheel_index[fault.wheel], fault.motor)
        elif not active and number in self._saved:
            self._restore(number)
            if fault.type == "motor_lost" and fault.motor == "drive":
                self._reset_drive_set_point(self._wheel_index[fault.wheel])

    def _set(self, number: int, array: Any, index: Any, value: float) -> None:
        self._saved[number].append((array, index, float(array[index])))
        array[index] = value

    def _restore(self, number: int) -> None:
        saved: list[tuple[Any, Any, float]] = self._saved.pop(number)
        for array, index, value in saved[::-1]:
            array[index] = value

    def _disable_motor(self, number: int, wheel: int, motor: str) -> None:
        """Sets the gains of the servo of a motor to zero, so that the joint turns freely."""
        model = self.scene.model
        motors = self._steering_motors if motor == "steering" else self._drive_motors
        for i, actuator in motors:
            if i == wheel:
                for array in (model.actuator_gainprm, model.actuator_biasprm):
                    for k in range(3):
                        self._set(number, array, (actuator, k), 0.0)

    def _reset_drive_set_point(self, wheel: int) -> None:
        """Sets the position set point of a drive to the present position of the wheel.

        The drive servos (``intvelocity``) integrate the commanded speed to a position set point.
        While the motor is lost, the wheel does not follow the set point.  Without a reset of the
        set point, the wheel would catch up with the set point when the motor works again.
        """
        model, data = self.scene.model, self.scene.data
        addresses = {i: self._base + q for i, q, _ in self.spin_joints}
        for i, actuator in self._drive_motors:
            if i == wheel and int(model.actuator_actadr[actuator]) >= 0:
                data.act[int(model.actuator_actadr[actuator])] = data.qpos[addresses[i]]


def _is_noisy(noise: Noise) -> bool:
    deviations = (noise.wheel_speed, noise.wheel_position, noise.steering_angle)
    return max(deviations) > 0.0 or noise.gyro is not None or noise.encoder_counts


def _encoders(robot: Robot) -> tuple[tuple[int, bool, float, float], ...]:
    """Returns (wheel, is_steering, rad per count, offset in rad) of each motor's encoder.

    A quadrature encoder has four counts per pulse.  The encoder is on the motor side of the gear.
    """
    encoders = []
    for i, wheel in enumerate(robot.wheels):
        for joint, is_steering in ((wheel.spin_joint, False), (wheel.steering_joint, True)):
            motor = robot.actuator_of(joint) if joint is not None else None
            if motor is not None:
                count = math.tau / (4.0 * motor.encoder_ppr * motor.gear_ratio)
                encoders.append((i, is_steering, count, motor.encoder_offset))
    return tuple(encoders)
