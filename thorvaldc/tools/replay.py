"""Records played back: how the robots drove, and where they stood, without physics."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

from thorvaldc.model import Robot
from thorvaldc.model.spatial import quat_from_rpy
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.se2 import ZERO_TWIST, Pose2
from thorvaldc.simulation.control_loop import TIPPED, Sample
from thorvaldc.simulation.physics.mujoco_base import MujocoScene
from thorvaldc.simulation.records.recorded_run import RecordedRun
from thorvaldc.simulation.run_result import RobotResult, SimulationResult


def summary(
    robots: Sequence[tuple[str, Robot]], runs: Mapping[str, RecordedRun]
) -> SimulationResult:
    """How the recorded robots drove; what the record does not tell is nan."""
    end = max(run.samples[-1].time for run in runs.values())
    found = tuple(_run(name, robot, runs[name].samples) for name, robot in robots)
    return SimulationResult("record", end, end, math.nan, False, found)


def _run(name: str, robot: Robot, samples: Sequence[Sample]) -> RobotResult:
    first, last = samples[0], samples[-1]
    true = _from(last.pose_true, first.pose_true)
    estimated = _from(last.pose_estimated, first.pose_estimated)
    upright = [math.cos(s.posture[1]) * math.cos(s.posture[2]) for s in samples]
    tilt = math.acos(min(max(min(upright), -1.0), 1.0)) if all(map(math.isfinite, upright)) else 0.0
    return RobotResult(
        name=name,
        mass=robot.inertial.mass,
        wheels=len(robot.wheels),
        driven=sum(1 for w in robot.wheels if w.driven),
        steered=sum(1 for w in robot.wheels if w.steered),
        path_commanded=sum(a.limited.speed * (b.time - a.time) for a, b in pairwise(samples)),
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


def _from(pose: Pose2, start: Pose2) -> Pose2:
    """The pose as seen from the start; yaw not wrapped."""
    return pose.relative_to(start)


def _path(poses: Sequence[Pose2]) -> float:
    """The length of the way through the poses, each step an arc."""
    return sum(
        math.hypot(b.x - a.x, b.y - a.y) / se2.chord_over_arc(b.yaw - a.yaw)
        for a, b in pairwise(poses)
    )


class Replay:
    """Recorded robots in a scene of theirs, moved to where they were.

    They stand on the true path, or on the estimated one where that is all there is.  Wheels that no
    motor drives or steers keep still.
    """

    def __init__(
        self,
        scene: MujocoScene,
        robots: Sequence[tuple[str, Robot]],
        runs: Mapping[str, RecordedRun],
    ) -> None:
        """Raises ``DiagnosticError`` (``simulation-scene``) where the scene has other robots."""
        self.scene = scene
        self._puppets = [_Puppet(scene, robot, runs[name]) for name, robot in robots]
        self.end = max(run.samples[-1].time for run in runs.values())

    def show(self, time: float) -> None:
        """Move the robots to where they were at ``time`` (s)."""
        for puppet in self._puppets:
            puppet.show(time)
        self.scene.forward()

    def times(self, rate: float) -> Iterator[float]:
        """The times from 0 to the end, ``rate`` a second; the scene is at each in turn."""
        for number in range(int(self.end * rate + 1e-6) + 1):
            self.show(number / rate)
            yield number / rate


class _Puppet:
    def __init__(self, scene: MujocoScene, robot: Robot, run: RecordedRun) -> None:
        model = scene.model
        prefix = robot.prefix
        body = scene.index("body", prefix + robot.links[0].name, robot)
        self._base = int(model.jnt_qposadr[int(model.body_jntadr[body])])
        self._spin: list[tuple[int, int]] = []
        self._steering: list[tuple[int, int]] = []
        for i, wheel in enumerate(robot.wheels):
            for name, wanted, found in (
                (wheel.spin_joint, wheel.driven, self._spin),
                (wheel.steering_joint, wheel.steered, self._steering),
            ):
                if wanted and name is not None:
                    joint = scene.index("joint", prefix + name, robot)
                    found.append((i, int(model.jnt_qposadr[joint])))
        self._scene = scene
        self._samples = run.samples
        self._true = "truth" in run.groups
        self._next = 0

    def show(self, time: float) -> None:
        samples = self._samples
        if self._next and samples[self._next].time > time + 1e-9:
            self._next = 0
        while self._next + 1 < len(samples) and samples[self._next + 1].time <= time + 1e-9:
            self._next += 1
        sample = samples[self._next]
        pose = sample.pose_true if self._true else sample.pose_estimated
        z, roll, pitch = sample.posture if self._true else (0.0, 0.0, 0.0)
        place = (pose.x, pose.y, z, *quat_from_rpy(roll, pitch, pose.yaw))
        if all(map(math.isfinite, place)):
            self._scene.data.qpos[self._base : self._base + 7] = place
        if sample.joints is not None:
            self._turn(sample.joints)

    def _turn(self, joints: JointStates) -> None:
        position = self._scene.data.qpos
        for values, where in ((joints.positions, self._spin), (joints.angles, self._steering)):
            for i, address in where:
                if values is not None and math.isfinite(values[i]):
                    position[address] = values[i]
