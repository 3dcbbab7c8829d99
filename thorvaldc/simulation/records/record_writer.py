"""Records of runs: what takes the samples of robots, and CSV files of them."""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol, TextIO

from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.simulation.drive_metrics import Meter, Sample, Watch


class Recorder(Protocol):
    """What takes the samples of a run, each robot's in order of time.

    ``commands`` are what the driver asked of the joints (``None``: nothing yet).  ``close``
    may be called twice.
    """

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None: ...

    def close(self) -> None: ...


def recording(recorders: Sequence[Recorder]) -> Watch:
    """What hands a run's ticks to the recorders."""

    def watch(meter: Meter) -> None:
        sample, command = meter.sample(), meter.driver.state.command
        for recorder in recorders:
            recorder.record(meter.name, sample, None if command is None else command.joints)

    return watch


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """An ``OSError`` of the block tells the file's name."""
    try:
        yield
    except OSError as fault:
        number = fault.errno or 0
        raise OSError(number, fault.strerror or os.strerror(number), str(path)) from None


class Pace:
    """Which samples are recorded: of each robot one in ``every`` s, all of them for 0."""

    def __init__(self, every: float) -> None:
        self._every = every
        self._next: dict[str, float] = {}

    def due(self, robot: str, time: float) -> bool:
        if self._every <= 0.0:
            return True
        if time < self._next.get(robot, 0.0) - 1e-9:
            return False
        self._next[robot] = (int((time + 1e-9) / self._every) + 1) * self._every
        return True


class Digest:
    """A hash of every number of a run: equal for runs that are equal to the last bit."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None:
        numbers = _numbers(sample, commands)
        self._hash.update(robot.encode() + struct.pack(f"<{len(numbers)}d", *numbers))

    def close(self) -> None:
        return

    def hexdigest(self) -> str:
        return self._hash.hexdigest()


def _numbers(sample: Sample, commands: JointCommands | None) -> list[float]:
    numbers = [
        sample.time,
        *sample.asked,
        *sample.aimed,
        *sample.estimated,
        *sample.true,
        *sample.pose_estimated,
        *sample.pose_true,
    ]
    joints = sample.joints
    if joints is not None:
        numbers += [*joints.speeds, *joints.angles, *joints.angle_rates, *(joints.positions or ())]
        if joints.yaw_rate is not None:
            numbers.append(joints.yaw_rate)
    if commands is not None:
        numbers += [*commands.speeds, *commands.angles]
    return numbers


_TWIST = ("vx", "vy", "wz")
_POSE = ("x", "y", "yaw")
_POSTURE = ("z", "roll", "pitch")


class CsvRecorder:
    """One CSV file for each robot; SI units, a line a sample.

    ``where`` is a folder, for ``<robot>.csv``, or of one robot a file ``*.csv``.

    ``groups`` are groups of columns: ``odometry``, ``truth``, ``twist`` (asked for
    and aimed at) and ``joints`` (by name; positions and velocities, then commands).
    """

    def __init__(
        self,
        where: Path,
        robots: Sequence[tuple[str, Robot]],
        groups: Sequence[str],
        every: float = 0.0,
    ) -> None:
        """Makes the folder and opens the files.  Raises ``OSError`` where that fails."""
        self._groups = groups
        self._pace = Pace(every)
        self._files: dict[str, TextIO] = {}
        self._robots = dict(robots)
        folder, file = (where.parent, where.name) if where.suffix == ".csv" else (where, "")
        if not file:
            folder.mkdir(parents=True, exist_ok=True)
        self._paths = {name: folder / (file or f"{name}.csv") for name in self._robots}
        try:
            for name, path in self._paths.items():
                with naming(path):
                    stream = path.open("w", encoding="utf-8", newline="\n")
                    self._files[name] = stream
                    stream.write(",".join(columns(self._robots[name], groups)) + "\n")
                    stream.flush()
        except OSError:
            with contextlib.suppress(OSError):
                self.close()
            raise

    def record(self, robot: str, sample: Sample, commands: JointCommands | None) -> None:
        if not self._pace.due(robot, sample.time):
            return
        values = _values(self._robots[robot], sample, commands, self._groups)
        with naming(self._paths[robot]):
            self._files[robot].write(",".join(map(_text, values)) + "\n")

    def close(self) -> None:
        fault: OSError | None = None
        while self._files:
            name, stream = self._files.popitem()
            try:
                with naming(self._paths[name]):
                    stream.close()
            except OSError as found:
                fault = found
        if fault is not None:
            raise fault


def columns(robot: Robot, groups: Sequence[str]) -> list[str]:
    """Names of the columns of a robot's record."""
    found = ["time"]
    if "odometry" in groups:
        found += [f"odometry_{part}" for part in (*_POSE, *_TWIST)]
    if "truth" in groups:
        found += [f"true_{part}" for part in (*_POSE, *_TWIST, *_POSTURE)]
    if "twist" in groups:
        found += [f"{what}_{part}" for what in ("asked", "aimed") for part in _TWIST]
    if "joints" in groups:
        for wheel in robot.wheels:
            if wheel.driven:
                joint = wheel.spin_joint
                found += [f"{joint}_position", f"{joint}_velocity", f"{joint}_command"]
            if wheel.steering_joint is not None:
                found += [f"{wheel.steering_joint}_position", f"{wheel.steering_joint}_command"]
    return found


def _values(
    robot: Robot, sample: Sample, commands: JointCommands | None, groups: Sequence[str]
) -> Iterator[float]:
    yield sample.time
    if "odometry" in groups:
        yield from sample.pose_estimated
        yield from sample.estimated
    if "truth" in groups:
        yield from sample.pose_true
        yield from sample.true
        yield from sample.posture
    if "twist" in groups:
        yield from sample.asked
        yield from sample.aimed
    if "joints" in groups:
        joints, still = sample.joints, [math.nan] * len(robot.wheels)
        positions = (joints.positions if joints is not None else None) or still
        speeds, angles = (joints.speeds, joints.angles) if joints is not None else (still, still)
        for i, wheel in enumerate(robot.wheels):
            if wheel.driven:
                yield positions[i]
                yield speeds[i]
                yield commands.speeds[i] if commands is not None else math.nan
            if wheel.steered:
                yield angles[i]
                yield commands.angles[i] if commands is not None else math.nan


def _text(value: float) -> str:
    """Nine digits; nothing where there is no number."""
    return f"{value:.9g}" if math.isfinite(value) else ""
