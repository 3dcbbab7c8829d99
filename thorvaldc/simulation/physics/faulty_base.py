"""A base in MuJoCo with what is wrong with its wheels and the errors of its sensors."""

from __future__ import annotations

import hashlib
import math
import random
from collections.abc import Sequence
from typing import Any

from thorvaldc.model import Robot, Zone
from thorvaldc.model.scenario import Fault, Noise
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.simulation.physics.hidden_errors import HiddenErrors
from thorvaldc.simulation.physics.mujoco_base import MujocoBase, MujocoScene

_HIDDEN = ("radius_error", "steering_offset")


class _Told:
    """Joint states that can be changed."""

    def __init__(self, actual: JointStates) -> None:
        self.speeds = list(actual.speeds)
        self.positions = list(actual.positions or ())
        self.angles = list(actual.angles)
        self.rates = list(actual.angle_rates)
        self.yaw_rate: float | None = None


class FaultyBase(MujocoBase):
    """The joints as they are told, with the faults that are in force.

    Wrong radii and steering offsets are the hidden errors of ``MujocoBase``, which come and
    go here.  ``actual`` are the joints as they are.  Faults of the scene (a motor, a wheel
    on ice) change its model; ``close`` takes that back.
    """

    def __init__(
        self,
        robot: Robot,
        scene: MujocoScene,
        faults: Sequence[Fault] = (),
        noise: Noise | None = None,
        zones: Sequence[Zone] = (),
    ) -> None:
        super().__init__(robot, scene)
        self._faults = faults
        self._noise = noise if noise is not None and _any(noise) else None
        self._has_gyro = any(sensor.type == "imu" for sensor in robot.sensors)
        self._encoders = _encoders(robot) if noise is not None and noise.encoder_counts else ()
        self._wheel = {wheel.name: i for i, wheel in enumerate(robot.wheels)}
        # Each robot of a scenario has errors of its own, the same in every process.
        seed = f"{noise.seed if noise is not None else 0} {robot.namespace}"
        self._chance = random.Random(hashlib.sha256(seed.encode()).digest())
        self._ground = _Ground(self, zones, [f for f in faults if f.type == "ice"])
        self._undo: dict[int, list[tuple[Any, Any, Any]]] = {}
        self._frozen: dict[int, float] = {}
        self._none = (self._ratios, self._offsets)
        self.actual = JointStates(0.0, [], [], [])

    def read(self, now: float) -> JointStates:
        for number, fault in enumerate(self._faults):
            self._switch(number, fault, fault.start <= now < fault.end)
        self._ground.switch(now)
        self._ratios, self._offsets = self._none
        actual = self.actual = super().read(now)
        errors = self._errors(now)
        if errors is None and self._noise is None and not self._faults:
            return actual
        told = _Told(actual)
        if errors is not None:
            self._ratios, self._offsets = errors.radius_ratios, errors.steering_offsets
            for i, ratio in enumerate(self._ratios):
                told.speeds[i] /= ratio
                told.positions[i] /= ratio
                told.angles[i] -= self._offsets[i]
        self._disturb(told, now)
        return JointStates(
            actual.time, told.speeds, told.angles, told.rates, told.positions, told.yaw_rate
        )

    def motors(self) -> list[int]:
        """The scene's numbers of the robot's actuators."""
        return [number for _, number in (*self._drive_motors, *self._steering_motors)]

    def close(self) -> None:
        self._ground.leave()
        for number in list(self._undo):
            self._restore(number)

    # -- what the driver is told ----------------------------------------------------

    def _errors(self, now: float) -> HiddenErrors | None:
        """The hidden errors in force."""
        wrong = [f for f in self._faults if f.type in _HIDDEN and f.start <= now < f.end]
        if not wrong:
            return None
        return HiddenErrors.of(
            self.robot,
            {f.wheel: 1.0 + f.value for f in wrong if f.type == "radius_error"},
            {f.wheel: f.value for f in wrong if f.type == "steering_offset"},
        )

    def _disturb(self, told: _Told, now: float) -> None:
        noise, chance = self._noise, self._chance
        if noise is not None:
            for i in range(len(told.speeds)):
                told.speeds[i] += chance.gauss(0.0, noise.wheel_speed)
                told.positions[i] += chance.gauss(0.0, noise.wheel_position)
                told.angles[i] += chance.gauss(0.0, noise.steering_angle)
            if noise.gyro is not None and self._has_gyro:
                rate = float(self.scene.data.qvel[self._base_velocity + 5])
                told.yaw_rate = rate + noise.gyro_bias + chance.gauss(0.0, noise.gyro)
            for i, steers, count, offset in self._encoders:
                values = told.angles if steers else told.positions
                values[i] = math.floor((values[i] - offset) / count) * count + offset
        for number, fault in enumerate(self._faults):
            if fault.type != "encoder_frozen":
                continue
            i = self._wheel[fault.wheel]
            values, rates = told.positions, told.speeds
            if fault.motor == "steering":
                values, rates = told.angles, told.rates
            if fault.start <= now < fault.end:
                values[i], rates[i] = self._frozen.setdefault(number, values[i]), 0.0
            else:
                self._frozen.pop(number, None)

    # -- what changes in the scene ----------------------------------------------------

    def _switch(self, number: int, fault: Fault, active: bool) -> None:
        if active and number not in self._undo:
            self._undo[number] = []
            i = self._wheel[fault.wheel]
            if fault.type == "motor_lost":
                self._lose(number, i, fault.motor)
        elif not active and number in self._undo:
            self._restore(number)
            if fault.type == "motor_lost" and fault.motor == "drive":
                self._hold(self._wheel[fault.wheel])

    def _set(self, number: int, where: Any, index: Any, value: float) -> None:
        self._undo[number].append((where, index, float(where[index])))
        where[index] = value

    def _restore(self, number: int) -> None:
        for where, index, value in reversed(self._undo.pop(number)):
            where[index] = value

    def _lose(self, number: int, wheel: int, motor: str) -> None:
        model = self.scene.model
        motors = self._steering_motors if motor == "steering" else self._drive_motors
        for i, actuator in motors:
            if i == wheel:
                for table in (model.actuator_gainprm, model.actuator_biasprm):
                    for k in range(3):
                        self._set(number, table, (actuator, k), 0.0)

    def _hold(self, wheel: int) -> None:
        """Let a drive that comes back go on from where its wheel is."""
        model, data = self.scene.model, self.scene.data
        position = {i: self._base + q for i, q, _ in self._spin}
        for i, actuator in self._drive_motors:
            if i == wheel and int(model.actuator_actadr[actuator]) >= 0:
                data.act[int(model.actuator_actadr[actuator])] = data.qpos[position[i]]


def _any(noise: Noise) -> bool:
    errors = max(noise.wheel_speed, noise.wheel_position, noise.steering_angle) > 0.0
    return errors or noise.gyro is not None or noise.encoder_counts


def _encoders(robot: Robot) -> tuple[tuple[int, bool, float, float], ...]:
    """Of each motor of a wheel: the wheel, whether it steers, rad a count, and its offset (rad).

    An encoder has four counts a pulse, before the gear.
    """
    found = []
    for i, wheel in enumerate(robot.wheels):
        for joint, steers in ((wheel.spin_joint, False), (wheel.steering_joint, True)):
            motor = robot.actuator_of(joint) if joint is not None else None
            if motor is not None:
                count = math.tau / (4.0 * motor.encoder_ppr * motor.gear_ratio)
                found.append((i, steers, count, motor.encoder_offset))
    return tuple(found)


class _Ground:
    """Friction and rolling resistance under each wheel: of zones, and of wheels on ice."""

    def __init__(self, base: FaultyBase, zones: Sequence[Zone], ice: Sequence[Fault]) -> None:
        self._zones = [_Place(z) for z in zones if not (z.friction is z.rolling_resistance is None)]
        self._ice = ice
        self._wheels: list[_Footing] = []
        if self._zones or ice:
            self._wheels = [_Footing(base, i) for i in range(len(base.robot.wheels))]

    def switch(self, now: float) -> None:
        for wheel in self._wheels:
            friction = resistance = None
            if self._zones:
                x, y = wheel.place()
                for place in self._zones:
                    dx, dy = x - place.x, y - place.y
                    if (
                        abs(place.cos * dx + place.sin * dy) <= place.half_x
                        and abs(place.cos * dy - place.sin * dx) <= place.half_y
                    ):
                        friction, resistance = place.zone.friction, place.zone.rolling_resistance
            for fault in self._ice:
                if fault.wheel == wheel.name and fault.start <= now < fault.end:
                    friction = fault.value
            wheel.put(friction, resistance)

    def leave(self) -> None:
        for wheel in self._wheels:
            wheel.put(None, None)


class _Place:
    """A zone as plain numbers, which each wheel asks at each tick."""

    def __init__(self, zone: Zone) -> None:
        self.zone = zone
        self.x, self.y, _ = zone.pose.xyz
        yaw = zone.pose.rpy()[2]
        self.cos, self.sin = math.cos(yaw), math.sin(yaw)
        self.half_x, self.half_y = (edge / 2 for edge in zone.size)


class _Footing:
    """What a wheel has to do with the ground in the scene's model."""

    def __init__(self, base: FaultyBase, number: int) -> None:
        robot, scene = base.robot, base.scene
        wheel = robot.wheels[number]
        prefix = robot.prefix
        joint = scene.index("joint", prefix + wheel.spin_joint, robot)
        model = scene.model
        # What its joint turns: the wheel's own link may be welded to that.
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
        self._own = [model.geom_friction[geom].copy() for geom in self._geoms]
        self._loss = float(model.dof_frictionloss[self._dof])
        self._load_radius = wheel.load * wheel.radius
        self._resistance = wheel.rolling_resistance
        self._now: tuple[float | None, float | None] = (None, None)

    def place(self) -> tuple[float, float]:
        """Where it was at the last step, m."""
        x, y, _ = self._data.xpos[self._body].tolist()
        return x, y

    def put(self, friction: float | None, resistance: float | None) -> None:
        """Coefficients under it; ``None``: its own."""
        if (friction, resistance) == self._now:
            return
        self._now = (friction, resistance)
        for geom, own in zip(self._geoms, self._own, strict=True):
            # Of spinning, friction grows with that of sliding.
            ratio = 1.0 if friction is None else friction / own[0] if own[0] else 0.0
            self._model.geom_friction[geom, :2] = own[:2] * ratio
        more = 0.0 if resistance is None else resistance - self._resistance
        self._model.dof_frictionloss[self._dof] = max(self._loss + more * self._load_radius, 0.0)
