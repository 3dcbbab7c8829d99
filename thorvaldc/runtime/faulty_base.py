"""A base in MuJoCo with what is wrong with its wheels and the errors of its sensors."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Sequence
from typing import Any

from thorvaldc.model import Robot
from thorvaldc.model.scenario import Fault, Noise
from thorvaldc.runtime.base import JointCommands, JointStates
from thorvaldc.runtime.mujoco_base import MujocoBase, MujocoScene


class FaultyBase(MujocoBase):
    """The joints as they are told, with the faults that are in force.

    A wheel that is larger by some ratio rolls as one of the model's radius that turns
    faster by it.  ``actual`` are the joints as they are.  Faults of the scene (a motor, a
    wheel on ice) change its model; ``close`` takes that back.
    """

    def __init__(
        self,
        robot: Robot,
        scene: MujocoScene,
        faults: Sequence[Fault] = (),
        noise: Noise | None = None,
    ) -> None:
        super().__init__(robot, scene)
        self._faults = faults
        self._noise = noise if noise is not None and _any(noise) else None
        self._wheel = {wheel.name: i for i, wheel in enumerate(robot.wheels)}
        # Each robot of a scenario has errors of its own, the same in every process.
        seed = f"{noise.seed if noise is not None else 0} {robot.namespace}"
        self._chance = random.Random(hashlib.sha256(seed.encode()).digest())
        self._undo: dict[int, list[tuple[Any, Any, Any]]] = {}
        self._frozen: dict[int, tuple[float, float, float]] = {}
        self.actual = JointStates(0.0, [], [], [])

    def read(self, now: float) -> JointStates:
        for number, fault in enumerate(self._faults):
            self._switch(number, fault, fault.start <= now < fault.end)
        actual = self.actual = super().read(now)
        told = JointStates(
            actual.time,
            list(actual.speeds),
            list(actual.angles),
            list(actual.angle_rates),
            list(actual.positions or ()),
        )
        self._disturb(told, now)
        return told

    def write(self, commands: JointCommands, now: float) -> None:
        speeds, angles = list(commands.speeds), list(commands.angles)
        for fault in self._faults:
            if fault.start <= now < fault.end:
                i = self._wheel[fault.wheel]
                if fault.type == "radius_error":
                    speeds[i] *= 1.0 + fault.value
                elif fault.type == "steering_offset":
                    angles[i] += fault.value
        super().write(JointCommands(speeds, angles), now)

    def close(self) -> None:
        for number in list(self._undo):
            self._restore(number)

    # -- what the driver is told ----------------------------------------------------

    def _disturb(self, told: Any, now: float) -> None:
        noise, chance = self._noise, self._chance
        for number, fault in enumerate(self._faults):
            if not fault.start <= now < fault.end:
                self._frozen.pop(number, None)
                continue
            i = self._wheel[fault.wheel]
            if fault.type == "radius_error":
                told.speeds[i] /= 1.0 + fault.value
                told.positions[i] /= 1.0 + fault.value
            elif fault.type == "steering_offset":
                told.angles[i] -= fault.value
        if noise is not None:
            for i in range(len(told.speeds)):
                told.speeds[i] += chance.gauss(0.0, noise.wheel_speed)
                told.positions[i] += chance.gauss(0.0, noise.wheel_position)
                told.angles[i] += chance.gauss(0.0, noise.steering_angle)
        for number, fault in enumerate(self._faults):
            if fault.type == "encoder_frozen" and fault.start <= now < fault.end:
                i = self._wheel[fault.wheel]
                if fault.motor == "steering":
                    held = self._frozen.setdefault(number, (told.angles[i], 0.0, 0.0))
                    told.angles[i], told.angle_rates[i] = held[0], 0.0
                else:
                    held = self._frozen.setdefault(number, (told.positions[i], 0.0, 0.0))
                    told.positions[i], told.speeds[i] = held[0], 0.0

    # -- what changes in the scene ----------------------------------------------------

    def _switch(self, number: int, fault: Fault, active: bool) -> None:
        if active and number not in self._undo:
            self._undo[number] = []
            i = self._wheel[fault.wheel]
            if fault.type == "motor_lost":
                self._lose(number, i, fault.motor)
            elif fault.type == "ice":
                for geom in self._geoms(i):
                    friction = self.scene.model.geom_friction
                    ratio = fault.value / float(friction[geom, 0]) if friction[geom, 0] else 0.0
                    for part in (0, 1):  # sliding; spinning, which grows with it
                        self._set(number, friction, (geom, part), friction[geom, part] * ratio)
        elif not active and number in self._undo:
            self._restore(number)

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

    def _geoms(self, wheel: int) -> list[int]:
        """The scene's numbers of the geoms with which a wheel touches the ground."""
        robot, model = self.robot, self.scene.model
        prefix = f"{robot.namespace}/" if robot.namespace else ""
        body = self.scene.index("body", prefix + robot.wheels[wheel].link, robot)
        first = int(model.body_geomadr[body])
        return [
            geom
            for geom in range(first, first + int(model.body_geomnum[body]))
            if int(model.geom_contype[geom]) or int(model.geom_conaffinity[geom])
        ]


def _any(noise: Noise) -> bool:
    return max(noise.wheel_speed, noise.wheel_position, noise.steering_angle) > 0.0
