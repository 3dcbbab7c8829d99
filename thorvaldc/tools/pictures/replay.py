"""Replays recorded runs without physics, and computes the results of recorded runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

from thorvaldc.model import Robot
from thorvaldc.model.spatial import float_sum, quat_from_rpy
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.se2 import ZERO_TWIST, Pose2
from thorvaldc.simulation.control_loop import TIPPED, RobotResult, Sample, SimulationResult
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.records.recorder import RecordedRun


def summary(
    robots: Sequence[tuple[str, Robot]], runs: Mapping[str, RecordedRun]
) -> SimulationResult:
    """Returns the result of a recorded run.

    Each result that needs data outside the record is nan.
    """
    end = max(run.samples[-1].time for run in runs.values())
    results = tuple(_result(name, robot, runs[name].samples) for name, robot in robots)
    return SimulationResult("record", end, end, math.nan, False, results)


def _result(name: str, robot: Robot, samples: Sequence[Sample]) -> RobotResult:
    first, last = samples[0], samples[-1]
    true = last.pose_true.relative_to(first.pose_true)
    estimated = last.pose_estimated.relative_to(first.pose_estimated)
    # The cosine of the tilt angle is the vertical component of the z axis of `base_link`, which is
    # cos(roll) cos(pitch).
    uprightness = [math.cos(s.posture[1]) * math.cos(s.posture[2]) for s in samples]
    tilt = 0.0
    if all(map(math.isfinite, uprightness)):
        tilt = math.acos(min(max(min(uprightness), -1.0), 1.0))
    return RobotResult(
        name=name,
        mass=robot.inertial.mass,
        wheels=len(robot.wheels),
        driven=sum(1 for w in robot.wheels if w.driven),
        steered=sum(1 for w in robot.wheels if w.steered),
        path_commanded=float_sum(a.limited.speed * (b.time - a.time) for a, b in pairwise(samples)),
        path_true=_path([s.pose_true for s in samples]),
        path_odometry=_path([s.pose_estimated for s in samples]),
        end_error=math.hypot(true.x - estimated.x, true.y - estimated.y),
        yaw_error=abs(true.yaw - estimated.yaw),
        pose_true=true,
        pose_odometry=estimated,
        largest_tilt=tilt,
        infeasible=ZERO_TWIST,
        unreachable=(),
        tipped=math.cos(tilt) < TIPPED,
    )


def _path(poses: Sequence[Pose2]) -> float:
    """Returns the length (m) of the path through the poses.

    The path between two successive poses is assumed to be an arc.
    """
    return float_sum(
        math.hypot(b.x - a.x, b.y - a.y) / se2.chord_over_arc(b.yaw - a.yaw)
        for a, b in pairwise(poses)
    )


class Replay:
    """Moves the robots of a scene to the recorded poses and joint positions.

    The robots move to the true poses, or to the estimated poses if the record has no true poses.
    Joints without a motor are not recorded, and the replay does not move joints without a motor.
    """

    def __init__(
        self,
        scene: MujocoScene,
        robots: Sequence[tuple[str, Robot]],
        runs: Mapping[str, RecordedRun],
    ) -> None:
        """Finds the joints of the recorded robots in the scene.

        Raises ``DiagnosticError`` (``simulation-scene``) if the scene does not contain a recorded
        robot.
        """
        self.scene = scene
        self._robots = [_ReplayedRobot(scene, robot, runs[name]) for name, robot in robots]
        self.end = max(run.samples[-1].time for run in runs.values())

    def show(self, time: float) -> None:
        """Moves each robot to the last recorded sample at or before ``time`` (s)."""
        for robot in self._robots:
            robot.show(time)
        self.scene.forward()

    def scenes(self, rate: float) -> Iterator[MujocoScene]:
        """Replays the record with ``rate`` steps per second.

        In each step, the method moves the robots to the recorded samples at the time of the step
        and then yields the scene.
        """
        for number in range(int(self.end * rate + 1e-6) + 1):
            self.show(number / rate)
            yield self.scene


class _ReplayedRobot:
    """The recorded samples of one robot, and the addresses of the robot's joints in the scene."""

    def __init__(self, scene: MujocoScene, robot: Robot, run: RecordedRun) -> None:
        model = scene.model
        prefix = robot.prefix
        body = scene.index("body", prefix + robot.links[0].name, robot)
        self._base = int(model.jnt_qposadr[int(model.body_jntadr[body])])
        self._spin: list[tuple[int, int]] = []
        self._steering: list[tuple[int, int]] = []
        for i, wheel in enumerate(robot.wheels):
            for name, is_recorded, addresses in (
                (wheel.spin_joint, wheel.driven, self._spin),
                (wheel.steering_joint, wheel.steered, self._steering),
            ):
                if is_recorded and name is not None:
                    joint = scene.index("joint", prefix + name, robot)
                    addresses.append((i, int(model.jnt_qposadr[joint])))
        self._scene = scene
        self._samples = run.samples
        self._has_truth = "truth" in run.groups
        self._index = 0

    def show(self, time: float) -> None:
        samples = self._samples
        # The search starts at the sample of the last call, because the times of successive calls
        # usually increase.
        if self._index and samples[self._index].time > time + 1e-9:
            self._index = 0
        while self._index + 1 < len(samples) and samples[self._index + 1].time <= time + 1e-9:
            self._index += 1
        sample = samples[self._index]
        pose = sample.pose_true if self._has_truth else sample.pose_estimated
        z, roll, pitch = sample.posture if self._has_truth else (0.0, 0.0, 0.0)
        position = (pose.x, pose.y, z, *quat_from_rpy(roll, pitch, pose.yaw))
        if all(map(math.isfinite, position)):
            self._scene.data.qpos[self._base : self._base + 7] = position
        if sample.joints is not None:
            self._set_joints(sample.joints)

    def _set_joints(self, joints: JointStates) -> None:
        qpos = self._scene.data.qpos
        for values, addresses in ((joints.positions, self._spin), (joints.angles, self._steering)):
            for i, address in addresses:
                if values is not None and math.isfinite(values[i]):
                    qpos[address] = values[i]
