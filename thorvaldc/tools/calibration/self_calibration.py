"""Self-calibration: steering zero offsets and relative wheel radii from a joint log alone.

Per tick the wheels say more than the three numbers of the twist.  A wheel at
(x, y) that points along (c, s) and rolls at w tells that the ground passes
at r w along it and at 0 across it; the twist that agrees best is projected
out, and what is left over depends on the wheels' errors alone.  Those are
solved for by Gauss-Newton over all ticks.  Only the common scale of all radii
leaves nothing over: it stays, unless a measured distance fixes it.

How far rolling and pointing are to be trusted is estimated as well (the variance
components of the two kinds of rows), from where rolling is trusted more: a
steering motor holds its wheel also against the ground, and then wheels slip
sideways although their angles look right.  Slip that lasts is counted as an
unknown offset of each wheel.  Where all angles agree with the offsets that the
robot's file has already, they are taken to be held there, and say nothing.
Ticks at standstill do not count, and those with slip weigh little (weights of
Geman and McClure).  Standard errors are those of blocks of 1 s ("sandwich"), so
that errors that last for a while do not pass for many.

Numpy is imported with this module: import it where it is used.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Robot
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.driver_parameters import Parameters
from thorvaldc.simulation.records.joint_csv import JointLog
from thorvaldc.tools.calibration.calibration_solver import (
    LARGEST_RATIO,
    OFFSET_WANTED,
    RATIO_WANTED,
    Solution,
    Solver,
    encoder_offset,
)
from thorvaldc.tools.calibration.log_intervals import Ticks

SHORTEST = 5.0
"""Time (s) in motion that a log must have."""

_FORCED = 3e-3
"""Share by which half of the wheels differ from their commands where they give way at all."""
_LAGS = np.arange(0.0, 0.5, 0.005)
"""Times (s) by which joints may follow their commands."""
_GROWS = 0.5
"""How much, relatively, a distance must grow with the radii to tell their scale."""
_SLIP = math.radians(0.1)
"""Side slip (rad) that is worth a word."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with its standard error, and whether the log determines it."""

    value: float
    error: float
    determined: bool


@dataclass(frozen=True, slots=True)
class WheelCalibration:
    """What was found of a wheel.

    ``offset`` (rad): the joint's position where its encoder reads 0, ``None`` for
    a wheel that no motor steers.  ``ratio``: its radius over that of the robot's
    file, all ratios together leaving the common scale; ``radius`` (m) has the
    measured scale as well.  Both ``None`` for a wheel without encoder.  ``named`` is
    the name of that radius in the file, empty for the ordinary one.
    """

    name: str
    offset: Estimate | None
    ratio: Estimate | None
    radius: float | None
    named: str
    present_offset: float


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """The wheels in the robot's order, and how it was found.

    ``moving`` (s) of ``duration`` were in motion.  ``scale`` is by what the
    measured distance changed all radii (``None``: none was given).  ``rolling``
    (relative) and ``pointing`` (rad) are the sizes of what a tick leaves over,
    ``slip`` (rad) of the latter the part that lasts, at the worst wheel.  ``held``:
    the steering angles agree with the robot's file, which is right or is what
    motors held the wheels to; the offsets stay.  ``forced``: the drives turned as they
    were commanded, whatever their wheels; the radii stay.
    """

    robot: str
    wheels: tuple[WheelCalibration, ...]
    duration: float
    moving: float
    scale: float | None
    rolling: float
    pointing: float
    slip: float
    held: bool
    forced: bool
    iterations: int

    @property
    def tells(self) -> bool:
        """Whether anything is determined."""
        found = [e for w in self.wheels for e in (w.offset, w.ratio) if e is not None]
        return self.scale is not None or any(e.determined for e in found)


def calibrate(
    robot: Robot,
    log: JointLog,
    report: Report,
    distance: float | None = None,
    display: str = "",
    parameters: str | None = None,
) -> CalibrationResult | None:
    """Find the wheels' errors; ``None`` where the log tells nothing (reported).

    ``distance`` (m) is what was measured between where ``base_link`` stood at the
    log's first and last line, in a straight line.  The way between may turn a little.
    ``display`` is the log's name for spans; ``parameters`` the parameter set by whose
    radii the robot drove.  Raises ``DiagnosticError`` where the robot has no such set.
    """
    names = [""] * len(robot.wheels)
    if parameters is not None:
        radii = Parameters.from_robot(robot, parameters).radii
        name = next(s.radii for s in robot.parameter_sets if s.name == parameters) or ""
        names = [name if name in dict(wheel.radii) else "" for wheel in robot.wheels]
        wheels = zip(robot.wheels, radii, strict=True)
        robot = replace(robot, wheels=tuple(replace(w, radius=r) for w, r in wheels))
    # A log may hold any number; what comes of it is looked at in the end.
    with np.errstate(all="ignore"):
        return _calibrate(robot, names, log, report, distance, Span(display) if display else None)


def _calibrate(
    robot: Robot,
    names: Sequence[str],
    log: JointLog,
    report: Report,
    distance: float | None,
    span: Span | None,
) -> CalibrationResult | None:
    ticks = Ticks(robot, log)
    moving = float(ticks.dt[ticks.moves].sum())
    if moving < SHORTEST:
        report.add(
            "joint-log-short",
            f"the wheels move for {moving:.3g} s of the log; at least {SHORTEST:g} s are needed",
            span,
            hint="drive for a minute, with turns to both sides",
        )
        return None
    solution = Solver(robot, ticks.thinned()).solve()
    if solution is None:
        report.add(
            "calibration-fit",
            "no errors of the wheels, up to 45 deg and 20 %, explain the log",
            span,
            hint="is it the log of this robot, on firm ground, in rad and rad/s?",
        )
        return None
    apart = _from_commands(log, ticks)
    forced = apart is not None and apart < _FORCED
    wheels = _wheels(robot, names, solution, forced)
    scale = None
    if distance is not None:
        scale = _scale(robot, ticks, solution, wheels, distance, span, report)
        if scale is None:
            return None
        wheels = tuple(
            replace(w, radius=w.radius * scale) if w.radius is not None else w for w in wheels
        )
    result = CalibrationResult(
        robot.name,
        wheels,
        float(ticks.times[-1] - ticks.times[0]),
        moving,
        scale,
        solution.rolling,
        solution.pointing,
        solution.slip,
        solution.consistent,
        forced,
        solution.iterations,
    )
    _tell(result, span, report)
    return result


def _from_commands(log: JointLog, ticks: Ticks) -> float | None:
    """The share by which the wheels differ from their commands, their lag apart; the median's."""
    if not log.commands:
        return None
    middle = ((ticks.times[1:] + ticks.times[:-1]) / 2.0)[ticks.whole]
    speeds, commands = [], []
    for joint, asked in log.commands.items():
        speeds.append(ticks.speeds[ticks.whole, ticks.wheel_of[joint]])
        commands.append(np.array(asked[:-1])[ticks.whole])
    least, gains = math.inf, np.zeros(len(speeds))
    for lag in _LAGS:
        late = [np.interp(middle - lag, middle, command) for command in commands]
        error = float(sum(np.sum((a - b) ** 2) for a, b in zip(speeds, late, strict=True)))
        if error < least:
            least = error
            gains = np.array([a @ b / max(b @ b, 1e-12) for a, b in zip(speeds, late, strict=True)])
    return float(np.median(np.abs(gains - 1.0)))


# -- the result ---------------------------------------------------------------------------


def _wheels(
    robot: Robot, names: Sequence[str], solution: Solution, forced: bool
) -> tuple[WheelCalibration, ...]:
    wheels: list[WheelCalibration] = []
    for i, wheel in enumerate(BaseGeometry.from_robot(robot).wheels):
        offset = ratio = radius = None
        present = encoder_offset(robot, i)
        if wheel.steered:
            error = float(solution.offset_errors[i])
            determined = error <= OFFSET_WANTED and not solution.consistent
            offset = Estimate(float(solution.offsets[i]), error, determined)
        if wheel.encoder and not wheel.swivel:
            value = math.exp(float(solution.ratios[i]))
            error = float(solution.ratio_errors[i])
            ratio = Estimate(value, error, error <= RATIO_WANTED and not forced)
            radius = wheel.radius * (value if ratio.determined else 1.0)
        wheels.append(WheelCalibration(wheel.name, offset, ratio, radius, names[i], present))
    return tuple(wheels)


def _scale(
    robot: Robot,
    ticks: Ticks,
    solution: Solution,
    wheels: tuple[WheelCalibration, ...],
    distance: float,
    span: Span | None,
    report: Report,
) -> float | None:
    """By what all radii must change for the ends of the way to be ``distance`` m apart."""
    if not bool(np.all(ticks.whole)):
        report.add(
            "calibration-distance",
            "the log has gaps: how far the robot went in them is not known",
            span,
            hint="give a distance for a log without gaps",
        )
        return None
    solver = Solver(robot, ticks)
    offsets = np.array([_kept(wheel) for wheel in wheels])
    ratios = np.array(
        [math.log(w.ratio.value) if w.ratio and w.ratio.determined else 0.0 for w in wheels]
    )

    def apart(scale: float) -> float:
        return solver.ends_apart(offsets, ratios + math.log(scale), solution.factors)

    own = apart(1.0)
    scale, grows = 1.0, 1.0
    for _ in range(20):
        # Where the way turns, a larger scale turns it more: the ends need not move apart.
        grows = math.log(apart(scale * 1.001) / apart(scale * 0.999)) / 0.002 if own > 1.0 else 0.0
        if grows < _GROWS:
            break
        step = math.log(distance / apart(scale)) / grows
        scale *= math.exp(step)
        if abs(step) < 1e-9 or not 0.5 < scale < 2.0:
            break
    if grows < _GROWS or abs(scale - 1.0) > LARGEST_RATIO:
        hint = "give the straight distance of base_link between the log's first and last line"
        if grows < _GROWS:
            hint = "drive straight on, 10 m or more: turns hide the scale"
        report.add(
            "calibration-distance",
            f"by the wheels the run ended {own:.4g} m from where it began; "
            f"{distance:.4g} m were measured",
            span,
            hint=hint,
        )
        return None
    return scale


def _kept(wheel: WheelCalibration) -> float:
    """The offset (rad) with which the wheel goes on."""
    offset = wheel.offset
    return offset.value if offset is not None and offset.determined else wheel.present_offset


def _tell(result: CalibrationResult, span: Span | None, report: Report) -> None:
    def open_ones(estimates: Iterable[tuple[str, Estimate | None]]) -> str:
        return ", ".join(name for name, e in estimates if e is not None and not e.determined)

    slips = ""
    if result.slip > _SLIP:
        slips = f", while wheels slip sideways by {math.degrees(result.slip):.2g} deg"
    offsets = open_ones((w.name, w.offset) for w in result.wheels)
    if result.held:
        report.add(
            "calibration-steering",
            f"the steering angles agree with the offsets that the robot has{slips}: "
            "they are right, or motors held the wheels to them",
            span,
            hint="the offsets stay as they are",
        )
    elif offsets:
        report.add(
            "calibration-undetermined",
            f"the log does not determine the steering offset of {offsets}{slips}",
            span,
            hint="it stays as it is; drive turns about points near the robot, and sideways",
        )
    ratios = open_ones((w.name, w.ratio) for w in result.wheels)
    if result.forced:
        report.add(
            "calibration-forced",
            f"half of the wheels or more turned as commanded, within {_FORCED:.1%}: the log tells "
            "what their speed controllers held, not how the wheels roll",
            span,
            hint="the radii stay as they are; record with the drives' speed control off "
            "(`thorvaldc sim --open-loop`)",
        )
    elif ratios:
        report.add(
            "calibration-undetermined",
            f"the log does not determine the radius of {ratios}",
            span,
            hint="it stays as it is; that of a wheel shows where the others tell how it must roll",
        )
