"""Recorded runs: read again, shown in a scene without physics, and summed up as results."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

from thorvaldc.cli import exits, run_outputs
from thorvaldc.cli.diagnostic_output import message, print_json, report_of, show_report, table_width
from thorvaldc.compiler.pipeline import emit
from thorvaldc.compiler.result import Compilation
from thorvaldc.diagnostics import DiagnosticError, Report, Span
from thorvaldc.model import Fleet, Robot, robots_by_name
from thorvaldc.model.spatial import quat_from_rpy
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.se2 import ZERO_TWIST, Pose2
from thorvaldc.simulation import control_loop, simulation_result
from thorvaldc.simulation.control_loop import Sample
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.records.record_reader import read_record
from thorvaldc.simulation.records.recorder import RecordedRun


def summary(
    robots: Sequence[tuple[str, Robot]], runs: Mapping[str, RecordedRun]
) -> simulation_result.SimulationResult:
    """Returns the result of a recorded run.

    Each result that needs data outside the record is nan.
    """
    end = max(run.samples[-1].time for run in runs.values())
    results = tuple(_result(name, robot, runs[name].samples) for name, robot in robots)
    return simulation_result.SimulationResult("record", end, end, math.nan, False, results)


def _result(name: str, robot: Robot, samples: Sequence[Sample]) -> simulation_result.RobotResult:
    first, last = samples[0], samples[-1]
    true = last.pose_true.relative_to(first.pose_true)
    estimated = last.pose_estimated.relative_to(first.pose_estimated)
    # In one pass, because a sample is made from the record whenever it is read.  The cosine of the
    # tilt angle is the vertical component of the z axis of `base_link`, which is
    # cos(roll) cos(pitch).
    uprightness = [math.cos(first.posture[1]) * math.cos(first.posture[2])]
    commanded, by_truth, by_odometry = 0.0, 0.0, 0.0
    for a, b in pairwise(samples):
        uprightness.append(math.cos(b.posture[1]) * math.cos(b.posture[2]))
        commanded += a.limited.speed * (b.time - a.time)
        by_truth += _arc(a.pose_true, b.pose_true)
        by_odometry += _arc(a.pose_estimated, b.pose_estimated)
    tilt = 0.0
    if all(map(math.isfinite, uprightness)):
        tilt = math.acos(min(max(min(uprightness), -1.0), 1.0))
    return simulation_result.RobotResult(
        name=name,
        mass=robot.inertial.mass,
        wheels=len(robot.wheels),
        driven=sum(1 for w in robot.wheels if w.driven),
        steered=sum(1 for w in robot.wheels if w.steered),
        path_commanded=commanded,
        path_true=by_truth,
        path_odometry=by_odometry,
        end_error=math.hypot(true.x - estimated.x, true.y - estimated.y),
        yaw_error=abs(true.yaw - estimated.yaw),
        pose_true=true,
        pose_odometry=estimated,
        largest_tilt=tilt,
        infeasible=ZERO_TWIST,
        unreachable=(),
        tipped=math.cos(tilt) < control_loop.TIPPED,
    )


def _arc(a: Pose2, b: Pose2) -> float:
    """Returns the length (m) of the arc between two poses."""
    return math.hypot(b.x - a.x, b.y - a.y) / se2.chord_over_arc(b.yaw - a.yaw)


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


PLOTTED_GROUPS = ("odometry", "truth")


def read_replay_record(
    path: Path, robots: Sequence[tuple[str, Robot]], report: Report, *, for_plot: bool = False
) -> dict[str, RecordedRun] | None:
    """Returns the recorded runs by robot name.

    A replay requires the group ``odometry`` or the group ``truth`` in the record.  A plot requires
    the group ``odometry`` and the group ``truth`` in the record.  If the record is invalid or a
    group is missing, the function adds errors to ``report`` and returns ``None``.
    """
    runs = read_record(path, robots, report)
    if runs is None:
        return None
    for name, run in runs.items():
        missing = [group for group in PLOTTED_GROUPS if group not in run.groups]
        if for_plot and missing:
            report.add(
                "record-incomplete",
                f"`{path}` has no {' and no '.join(missing)} of {name}; --plot needs "
                f"{' and '.join(PLOTTED_GROUPS)}",
                Span(str(path)),
            )
        if len(missing) == len(PLOTTED_GROUPS):
            report.add(
                "record-incomplete",
                f"`{path}` has neither odometry nor truth of {name}",
                Span(str(path)),
                hint="name one of them in `record: {what: ..}`, or leave `what` out",
            )
    return None if report.has_errors else runs


def text_sources(path: Path) -> dict[str, Path]:
    """Returns the CSV files of a record by the file names in the diagnostics.

    The report uses the CSV files to show excerpts.
    """
    files = sorted(path.glob("*.csv")) if path.is_dir() else [path]
    return {str(file): file for file in files if file.suffix == ".csv"}


def replay_run(
    compilation: Compilation,
    model: Robot | Fleet,
    source: str,
    pictures: run_outputs.RunOutputs,
    record: str,
    json: bool,
) -> int:
    """Prints the result of a recorded run, draws its plot and video, and returns the exit status.

    - ``source``: path of the record.
    - ``record``: path for a copy of the record in another format, or empty for no copy.
    """
    robots = [*robots_by_name(model).items()]
    runs, status = _read_record(source, robots, for_plot=bool(pictures.plot))
    if runs is None:
        return status
    pictures.check_installation()
    files = None
    try:
        scenes = None
        if pictures.video:
            report = Report()
            files = emit(model, ["mjcf"], report)
            scenes = Replay(MujocoScene(files), robots, runs).scenes
        pictures.take_record({name: run.samples for name, run in runs.items()}, scenes)
    except DiagnosticError as error:
        return show_report(compilation.located(report_of(error)), compilation.sources)
    result = summary(robots, runs)
    if json:
        print_json(result.as_json())
    else:
        print(simulation_result.result_table([result], table_width()))
    if record:
        _convert_record(record, robots, runs)
    pictures.write(model, robots, files)
    return status


def arrangement(
    model: Robot | Fleet, source: str, time: float
) -> Callable[[MujocoScene], None] | None:
    """Returns a function that moves the robots of a MuJoCo scene to their recorded poses at
    ``time`` (s).

    For a time after the end of the record, the robots move to their last recorded poses. If the
    record of the run has errors, the function prints the errors and returns ``None``.
    """
    robots = [*robots_by_name(model).items()]
    runs, _ = _read_record(source, robots, for_plot=False)
    if runs is None:
        return None
    recorded_runs = runs

    def arrange(scene: MujocoScene) -> None:
        replay = Replay(scene, robots, recorded_runs)
        replay.show(min(time, replay.end))

    return arrange


def _read_record(
    source: str, robots: run_outputs.Robots, *, for_plot: bool
) -> tuple[dict[str, RecordedRun] | None, int]:
    """Returns the recorded runs by robot name, and the exit status for the diagnostics of the
    record."""
    report = Report()
    with exits.write_errors(source):
        runs = read_replay_record(Path(source), robots, report, for_plot=for_plot)
    return runs, show_report(report, text_sources(Path(source)))


def _convert_record(
    record: str, robots: run_outputs.Robots, runs: Mapping[str, RecordedRun]
) -> None:
    groups: Sequence[str] = next(iter(runs.values())).groups
    with ExitStack() as stack:
        for recorder in run_outputs.open_recorders(record, robots, groups, 0.0, stack):
            for name, sample, commands in _by_time(runs):
                recorder.record(name, sample, commands)
    message(run_outputs.record_summary(record, robots))


def _by_time(
    runs: Mapping[str, RecordedRun],
) -> Iterator[tuple[str, Sample, JointCommands | None]]:
    """Yields the recorded samples of all robots, sorted by time."""

    def ticks(name: str) -> Iterator[tuple[str, Sample, JointCommands | None]]:
        run = runs[name]
        return ((name, *tick) for tick in zip(run.samples, run.commands, strict=True))

    return heapq.merge(*map(ticks, runs), key=lambda tick: tick[1].time)
