"""What all simulated sensors have: the scene that they see, their rate, their random errors."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from thorvaldc.model import Robot, Sensor
from thorvaldc.model.scenario import SensorSettings
from thorvaldc.model.sensor_numbers import sensor_numbers
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene, SceneFiles

Array = Any
"""Array of numpy.  Its shape is in the documentation."""


class Message(SimpleNamespace):
    """A ROS 2 message, whose fields are attributes: ``message.header.stamp.sec``.

    A field is a number, a text, a message, a list of messages, a tuple for an array of fixed
    length, or an array of numpy.  ``ros_type`` is the type, such as ``sensor_msgs/msg/Imu``.
    """

    def __init__(self, ros_type: str, **fields: Any) -> None:
        super().__init__(**fields)
        self.ros_type, self._fields = ros_type, fields

    def build(self, class_of: Callable[[str], Any], array: Callable[[Any], Any]) -> Any:
        """Returns an object of the class ``class_of(ros_type)``, of rclpy or the library rosbags.

        ``array`` converts tuples and arrays of numpy.
        """

        def converted(field: Any) -> Any:
            if isinstance(field, list):
                return [converted(item) for item in field]
            if isinstance(field, Message):
                return field.build(class_of, array)
            return array(field) if isinstance(field, tuple | np.ndarray) else field

        return class_of(self.ros_type)(**{n: converted(v) for n, v in self._fields.items()})


class SeenScene:
    """A second scene of the same files for the sensors, with the poses of the simulated one.

    After a step, the arrays of MuJoCo have the poses at the beginning of the step, and the physics
    needs no visual shapes.  With a scene of their own, sensors do not change the motion of a run.

    - ``level``: (3, 3) rotation from the frame of the scene to east, north and up.  The frame of a
      scene on a slope is the plane of the slope, with a tilted gravity.
    """

    def __init__(self, simulated: MujocoScene, files: SceneFiles, *, visuals: bool) -> None:
        self.scene, self._simulated = MujocoScene(files, visuals=visuals), simulated
        self.model, self.data = self.scene.model, self.scene.data
        # No ray shall hit the visible plates of zones, a millimetre above the ground.
        self.model.geom_group[(self.model.geom_bodyid == 0) & (self.model.geom_group == 2)] = 1
        # The smallest rotation that turns the direction u against gravity into the z axis: with
        # v = u x z and c = u . z, Rodrigues' formula is I + [v] + [v]^2 / (1 + c).
        x, y, z = (-self.model.opt.gravity / np.linalg.norm(self.model.opt.gravity)).tolist()
        skew = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
        self.level = np.eye(3) + skew + skew @ skew / (1.0 + z)

    def update(self) -> None:
        """Takes the joint positions and velocities of the simulated scene at its present time."""
        model, data, simulated = self.model, self.data, self._simulated
        data.qpos[:], data.qvel[:] = simulated.data.qpos, simulated.data.qvel
        data.time = simulated.time
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)


class SimulatedSensor:
    """A sensor of a robot in a scene.

    - ``name``, ``frame``: with the name space of the robot, such as ``r1/lidar``.
    - ``period``: time between two measurements in s.
    - ``active``: false if nobody needs the measurements.
    - ``latest``: last message of a run, or ``None``.
    """

    def __init__(
        self, robot: Robot, sensor: Sensor, seen: SeenScene, settings: SensorSettings
    ) -> None:
        self.robot, self.sensor, self.seen, self.settings = robot, sensor, seen, settings
        self.name, self.frame = robot.prefix + sensor.name, robot.prefix + sensor.link
        self.numbers = sensor_numbers(sensor)
        self.period = max(1.0 / self.numbers["rate"], seen.scene.timestep)
        self.active = True
        self._site = seen.scene.index("site", self.name, robot)
        self._base = seen.scene.index("body", robot.prefix + robot.links[0].name, robot)
        self.reset()

    def reset(self) -> None:
        """Begins a run: equal runs have equal errors."""
        # SHA-256, because the function hash() of a text differs between processes.
        digest = hashlib.sha256(f"{self.settings.noise.seed} {self.name}".encode()).digest()
        self.random = np.random.default_rng(int.from_bytes(digest))
        self.latest: Message | None = None
        self._slow: Array | None = None
        self._slow_time = 0.0

    def measure(self) -> list[Message]:
        """Returns the messages of a measurement of the seen scene, with the errors."""
        raise NotImplementedError

    def pose(self) -> tuple[Array, Array]:
        """Returns the position (3) in m and the rotation (3, 3) of the frame in the scene."""
        data = self.seen.data
        return data.site_xpos[self._site].copy(), data.site_xmat[self._site].reshape(3, 3).copy()

    def mount(self) -> tuple[float, ...]:
        """Returns the pose of the frame in ``base_link``: position in m, quaternion x, y, z, w."""
        position, rotation = self.pose()
        base = self.seen.data.xmat[self._base].reshape(3, 3)
        w, *vector = quaternion(base.T @ rotation)
        return (*(base.T @ (position - self.seen.data.xpos[self._base])).tolist(), *vector, w)

    def _errors(self, deviation: float, count: int) -> Array:
        """Returns ``count`` independent normal errors, scaled by the settings."""
        return self.random.normal(0.0, deviation * self.settings.errors, count)

    def _slow_errors(self, deviation: float, correlation_time: float) -> Array:
        """Returns the present errors (3) of a first-order Gauss-Markov process.

        After the time t, an error is exp(-t/T) of its old value plus a new error, with the
        correlation time T; its standard deviation stays ``deviation``.
        """
        kept = math.exp((self._slow_time - self.seen.data.time) / correlation_time)
        if self._slow is None:
            self._slow, kept = np.zeros(3), 0.0
        new = self._errors(deviation * math.sqrt(1.0 - kept * kept), 3)
        self._slow, self._slow_time = kept * self._slow + new, self.seen.data.time
        return self._slow

    def _message(self, kind: str, **fields: Any) -> Message:
        """Returns a message of the package sensor_msgs with its header."""
        seconds, nanoseconds = divmod(round(self.seen.data.time * 1e9), 1_000_000_000)
        stamp = Message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        header = Message("std_msgs/msg/Header", stamp=stamp, frame_id=self.frame)
        return Message(f"sensor_msgs/msg/{kind}", header=header, **fields)


def quaternion(rotation: Array) -> list[float]:
    """Returns the quaternion w, x, y, z of a rotation (3, 3)."""
    result = np.empty(4)
    mujoco.mju_mat2Quat(result, rotation.ravel())
    return [float(value) for value in result]


def diagonal(variance: float) -> tuple[float, ...]:
    """Returns a covariance (9) with three equal variances."""
    return (variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance)
