"""Reads records of runs back: the CSV files and MCAP files that ``record`` wrote."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.compiler.source.csv_table import TIME, read_table
from thorvaldc.compiler.source.ros_bag import (
    COMMANDED_TWIST,
    COMMANDS,
    JOINTS,
    LIMITED_TWIST,
    ODOM,
    TRUE_ODOM,
    TYPES,
    Bag,
    is_bag,
    read_bag,
)
from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Robot
from thorvaldc.model.scenario import GROUPS
from thorvaldc.model.spatial import matrix_to_rpy, quat_to_matrix
from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.se2 import ORIGIN, Pose2, Twist
from thorvaldc.simulation.drive_metrics import Sample
from thorvaldc.simulation.records.mcap_writer import joints_of
from thorvaldc.simulation.records.record_writer import columns

_NO_POSE = Pose2(math.nan, math.nan, math.nan)
_NO_TWIST = Twist(math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """A robot's part of a record: its samples, and what was asked of its joints with each.

    Of what is in none of ``groups`` there is nan, or ``None``.
    """

    groups: tuple[str, ...]
    samples: list[Sample]
    commands: list[JointCommands | None]


def read_record(
    path: Path, robots: Sequence[tuple[str, Robot]], report: Report
) -> dict[str, RecordedRun] | None:
    """The record of these robots, by name; ``None`` where it is at fault.

    ``path`` is an MCAP file, a folder of CSV files or the CSV file of one robot.  A
    record of one robot may have another name than ``robots`` gives it.  All that is wrong goes
    to ``report``.  Raises ``MissingPackageError`` where rosbags is wanted and missing.
    """
    display = str(path)
    if not path.exists():
        report.add("file-not-found", f"`{display}` does not exist", Span(display))
        return None
    if is_bag(path):
        found = _from_bag(path, display, robots, report)
    else:
        found = _from_csv(path, display, robots, report)
    if found is None or report.has_errors:
        return None
    for name, run in found.items():
        if not run.samples:
            report.add("record-unreadable", f"`{display}` holds nothing of {name}", Span(display))
            return None
    return found


# -- CSV ------------------------------------------------------------------------------


def _from_csv(
    path: Path, display: str, robots: Sequence[tuple[str, Robot]], report: Report
) -> dict[str, RecordedRun] | None:
    files: dict[str, Path] = {}
    if path.is_dir():
        there = sorted(file.stem for file in path.glob("*.csv"))
        for name, _ in robots:
            if name in there:
                files[name] = path / f"{name}.csv"
            elif len(robots) == len(there) == 1:
                files[name] = path / f"{there[0]}.csv"
            else:
                _tell_robot(name, there, display, report)
    elif len(robots) == 1:
        files = {robots[0][0]: path}
    else:
        report.add(
            "record-robot",
            f"`{display}` is the record of one robot, and there are {len(robots)}",
            Span(display),
            hint="name the folder that holds the records of all",
        )
    found: dict[str, RecordedRun] = {}
    for name, robot in robots:
        if name in files:
            run = _csv_run(files[name], robot, report)
            if run is not None:
                found[name] = run
    return found if len(found) == len(robots) else None


def _tell_robot(name: str, there: Iterable[str], display: str, report: Report) -> None:
    known = sorted(there)
    listed = ", ".join(known[:6]) + (" .." if len(known) > 6 else "")
    report.add(
        "record-robot",
        f"`{display}` has no robot {name}",
        Span(display),
        hint=did_you_mean(name, known, f"it has {listed}" if known else "it has none at all"),
    )


def _csv_run(path: Path, robot: Robot, report: Report) -> RecordedRun | None:
    display = str(path)
    table = read_table(path, display, report)
    if table is None:
        return None
    known = columns(robot, GROUPS)
    groups = tuple(g for g in GROUPS if any(c in table.columns for c in columns(robot, [g])[1:]))
    if not groups:
        report.add(
            "record-unreadable",
            f"`{display}` is no record: `{next(c for c in table.columns if c != TIME)}` is none of"
            " its columns",
            Span(display, 1, 1, 1, 1),
            hint="records are written by `thorvaldc sim --record`",
        )
        return None
    wrong = next((column for column in table.columns if column not in known), None)
    missing = next((c for c in columns(robot, groups) if c not in table.columns), None)
    if wrong is not None or missing is not None:
        of_another = "is it the record of another robot?"
        report.add(
            "record-robot",
            f"the record of {robot.name} has a column `{wrong}`"
            if wrong is not None
            else f"the record of {robot.name} has no column `{missing}`",
            table.span_of(wrong) if wrong is not None else Span(display, 1, 1, 1, 1),
            hint=of_another if wrong is None else did_you_mean(wrong, known, of_another),
        )
        return None
    run = RecordedRun(groups, [], [])
    for row in range(len(table)):

        def at(name: str, row: int = row) -> float:
            column = table.columns.get(name)
            return column[row] if column is not None else math.nan

        run.samples.append(_csv_sample(at, robot, "joints" in groups))
        run.commands.append(_csv_commands(at, robot) if "joints" in groups else None)
    return run


def _csv_sample(at: Callable[[str], float], robot: Robot, has_joints: bool) -> Sample:
    def twist(of: str) -> Twist:
        return Twist(at(f"{of}_vx"), at(f"{of}_vy"), at(f"{of}_wz"))

    def pose(of: str) -> Pose2:
        return Pose2(at(f"{of}_x"), at(f"{of}_y"), at(f"{of}_yaw"))

    joints = None
    if has_joints:
        wheels = robot.wheels
        joints = JointStates(
            at(TIME),
            [at(f"{w.spin_joint}_velocity") if w.driven else 0.0 for w in wheels],
            [at(f"{w.steering_joint}_position") if w.steered else 0.0 for w in wheels],
            [0.0] * len(wheels),
            [at(f"{w.spin_joint}_position") if w.driven else 0.0 for w in wheels],
        )
    return Sample(
        at(TIME),
        twist("asked"),
        twist("aimed"),
        twist("odometry"),
        twist("true"),
        pose("odometry"),
        pose("true"),
        joints,
        (at("true_z"), at("true_roll"), at("true_pitch")),
    )


def _csv_commands(at: Callable[[str], float], robot: Robot) -> JointCommands:
    return JointCommands(
        [at(f"{w.spin_joint}_command") if w.driven else 0.0 for w in robot.wheels],
        [at(f"{w.steering_joint}_command") if w.steered else 0.0 for w in robot.wheels],
    )


# -- MCAP -----------------------------------------------------------------------------


def _from_bag(
    path: Path, display: str, robots: Sequence[tuple[str, Robot]], report: Report
) -> dict[str, RecordedRun] | None:
    bag = read_bag(path, display, Span(display), _ours, report)
    if bag is None:
        return None
    there: dict[str, dict[str, str]] = {}  # topics by the names of their robots, then by kind
    for topic in bag.messages:
        for kind in TYPES:
            if topic.endswith(f"/{kind}") and not (
                kind == ODOM and topic.endswith(f"/{TRUE_ODOM}")
            ):
                there.setdefault(topic.removesuffix(f"/{kind}").strip("/"), {})[kind] = topic
    there = {name: kinds for name, kinds in there.items() if {ODOM, TRUE_ODOM} & set(kinds)}
    if not there:
        some = ", ".join(sorted(bag.topics)[:6]) or "none"
        report.add(
            "record-unreadable",
            f"`{display}` is no record of a run: it has no topic `{TRUE_ODOM}` or `{ODOM}`",
            Span(display),
            hint=f"its topics: {some}",
        )
        return None
    found: dict[str, RecordedRun] = {}
    for name, robot in robots:
        space = robot.namespace
        if space not in there and len(robots) == len(there) == 1:
            space = next(iter(there))
        if space not in there:
            _tell_robot(name, there, display, report)
            continue
        run = _BagRun(bag, there[space], space, robot, display).read(report)
        if run is not None:
            found[name] = run
    return found if len(found) == len(robots) else None


def _ours(topics: Mapping[str, str]) -> set[str]:
    of_robots = {
        topic
        for topic, type_ in topics.items()
        if any(topic.endswith(f"/{kind}") and type_ == TYPES[kind] for kind in TYPES)
    }
    return of_robots | ({"/tf_static"} & set(topics))


class _BagRun:
    """The messages of one robot of a bag, tick by tick."""

    def __init__(
        self, bag: Bag, topics: Mapping[str, str], space: str, robot: Robot, display: str
    ) -> None:
        self.by_time: dict[str, dict[float, Any]] = {
            kind: dict(bag.messages[topic]) for kind, topic in topics.items()
        }
        self.robot = robot
        self.display = display
        self.start = ORIGIN
        odom = f"{space}/odom" if space else "odom"
        for _, message in bag.messages.get("/tf_static", ()):
            for moved in message.transforms:
                if moved.child_frame_id == odom:
                    where = moved.transform
                    self.start = _pose(where.translation, where.rotation, 0.0)[0]

    def read(self, report: Report) -> RecordedRun | None:
        kinds = self.by_time
        groups = {"odometry": ODOM, "truth": TRUE_ODOM, "twist": COMMANDED_TWIST, "joints": JOINTS}
        has = tuple(group for group in GROUPS if groups[group] in kinds)
        if not self._joints_fit(report):
            return None
        run = RecordedRun(has, [], [])
        wanted = [groups[group] for group in has]
        last = next(reversed(kinds[wanted[0]]), None)
        turned = [0.0, 0.0]
        for time in kinds[wanted[0]]:
            if not all(time in kinds[kind] for kind in wanted):
                if time == last:
                    continue  # Ctrl-C came between two messages
                report.add(
                    "record-unreadable",
                    f"`{self.display}` is no record of a run: at {time:.9g} s it has not all of "
                    f"{', '.join(wanted)}",
                    Span(self.display),
                )
                return None
            run.samples.append(self._sample(time, turned))
            run.commands.append(self._commands(time))
        return run

    def _joints_fit(self, report: Report) -> bool:
        first = next(iter(self.by_time.get(JOINTS, {}).values()), None)
        if first is None:
            return True
        drives, steering = joints_of(self.robot)
        wanted = {*drives, *steering}
        names = list(first.name)
        other = next((name for name in names if name not in wanted), None)
        missing = next((name for name in (*drives, *steering) if name not in names), None)
        if other is not None or missing is not None:
            report.add(
                "record-robot",
                f"{self.robot.name} has no joint `{other}`, which `{self.display}` has"
                if other is not None
                else f"`{self.display}` has no joint `{missing}` of {self.robot.name}",
                Span(self.display),
                hint="is it the record of another robot?",
            )
            return False
        return True

    def _sample(self, time: float, turned: list[float]) -> Sample:
        estimated, pose, true, pose_true = _NO_TWIST, _NO_POSE, _NO_TWIST, _NO_POSE
        posture = (math.nan, math.nan, math.nan)
        message = self._at(ODOM, time)
        if message is not None:
            where = message.pose.pose
            local, _ = _pose(where.position, where.orientation, turned[0])
            turned[0] = local.yaw
            pose, estimated = self.start.moved(local), _twist(message.twist.twist)
        message = self._at(TRUE_ODOM, time)
        if message is not None:
            where = message.pose.pose
            pose_true, posture = _pose(where.position, where.orientation, turned[1])
            turned[1] = pose_true.yaw
            true = _twist(message.twist.twist)
        asked, aimed = (
            _twist(message.twist) if message is not None else _NO_TWIST
            for message in (self._at(COMMANDED_TWIST, time), self._at(LIMITED_TWIST, time))
        )
        joints = self._joints(time)
        return Sample(time, asked, aimed, estimated, true, pose, pose_true, joints, posture)

    def _joints(self, time: float) -> JointStates | None:
        message = self._at(JOINTS, time)
        if message is None:
            return None
        positions = dict(zip(message.name, message.position.tolist(), strict=False))
        speeds = dict(zip(message.name, message.velocity.tolist(), strict=False))
        spins = [w.spin_joint if w.driven else "" for w in self.robot.wheels]
        turns = [w.steering_joint or "" for w in self.robot.wheels]
        return JointStates(
            time,
            [speeds.get(name, 0.0) for name in spins],
            [positions.get(name, 0.0) for name in turns],
            [speeds.get(name, 0.0) for name in turns],
            [positions.get(name, 0.0) for name in spins],
        )

    def _commands(self, time: float) -> JointCommands | None:
        message = self._at(COMMANDS, time)
        if message is None:
            return None
        positions = dict(zip(message.name, message.position.tolist(), strict=False))
        speeds = dict(zip(message.name, message.velocity.tolist(), strict=False))
        return JointCommands(
            [speeds.get(w.spin_joint, 0.0) if w.driven else 0.0 for w in self.robot.wheels],
            [positions.get(w.steering_joint or "", 0.0) for w in self.robot.wheels],
        )

    def _at(self, kind: str, time: float) -> Any:
        return self.by_time[kind].get(time) if kind in self.by_time else None


def _twist(message: Any) -> Twist:
    return Twist(message.linear.x, message.linear.y, message.angular.z)


def _pose(
    position: Any, orientation: Any, before: float
) -> tuple[Pose2, tuple[float, float, float]]:
    """The pose in the plane, its yaw within half a turn of ``before``, and what is beside it."""
    q = orientation
    roll, pitch, yaw = matrix_to_rpy(quat_to_matrix((q.w, q.x, q.y, q.z)))
    yaw = before + math.remainder(yaw - before, math.tau)
    return Pose2(position.x, position.y, yaw), (position.z, roll, pitch)
