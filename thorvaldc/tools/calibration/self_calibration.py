"""Self-calibration: computes steering offsets and relative wheel radii from a joint log.

In each tick, a robot with N wheels gives 2 N measurements.  A wheel with the radius r (m) and the
wheel speed w (rad/s) measures the speed r w along the wheel and 0 across the wheel.  The rolling
row L and the side-slip row T of each wheel (see ``twist_fit``) relate the measured speeds to the
three unknowns of the twist.  The unknown parameters p of the calibration are the steering offsets
and the logarithms of the radius ratios.  Residual e for the twist that fits a tick best, with the
rows H of all wheels, the measured speeds z and the weights W:

    e(p) = (1 - H (H' W H)^-1 H' W) z

Gauss-Newton iterations minimise the sum of e' W e over all ticks.  A common scale of all wheel
radii does not change the minimum of the residuals.  The scale of the wheel radii is therefore 1
unless a measured distance determines the scale.

The standard deviations of the rolling speeds and of the wheel directions are estimated as variance
components.  At the start of the iterations, the rolling speeds have smaller standard deviations
than the wheel directions, relative to the defaults.  The wheel directions are less reliable,
because a steering motor can hold its wheel against the ground.  A wheel that its steering motor
holds against the ground slips sideways although its steering angle looks right.  Side slip that
lasts over many ticks counts as an unknown steering offset of each wheel.  If all steering angles
agree with the steering offsets in the robot file, the offsets are not determined, because the
steering motors may hold the wheels at wrong angles.

Ticks without motion of the robot are left out.  Ticks with wheel slip get a small weight (Geman and
McClure).  Measurement errors in successive ticks are correlated.  The random standard errors of the
parameters follow from the autocorrelation of the residuals (see ``calibration_log``).  The
systematic standard errors follow from the lasting part of the residuals.  For values that are not
settled, ``calibration_log`` plans the motions of a better log.

This module imports numpy.  To avoid a slow import of numpy, other modules import
``self_calibration`` only inside functions.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thorvaldc.diagnostics import Report, Span, plain
from thorvaldc.model import Robot
from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.run_time_parameters import Parameters
from thorvaldc.simulation.records.joint_csv import JointLog
from thorvaldc.tools.calibration import calibration_log, calibration_solver
from thorvaldc.tools.calibration.calibration_log import Array, Ticks
from thorvaldc.tools.calibration.calibration_solver import Solution, Solver

MotionPlan = tuple[calibration_log.PlannedMotion, ...] | None

MIN_MOVING_TIME = 5.0
"""The robot must move for at least this time (s) in a joint log."""

_FORCED = 3e-3
"""Smallest expected median difference between wheel speeds and their commands (relative).

If the median difference is smaller, speed controllers force the wheel speeds.
"""
_COARSE = 2.5
"""An estimate with more than this multiple of the standard error of a settled value is useless."""
_CONTRADICTION = 2.0
"""A coarse estimate contradicts the present value if they differ by this many standard errors."""
_LAGS = np.arange(0.0, 0.5, 0.005)
"""Candidates for the delay (s) between a command and the motion of the joint."""
_MIN_GROWTH = 0.5
"""Least relative growth of the driven distance per relative growth of the wheel radii."""
_DISTANCE_ERROR = 0.01
"""Standard deviation (m) of a measured distance: a tape between two marks on the ground."""
_SLIP = math.radians(0.1)
"""Smallest side slip angle (rad) of a wheel that a diagnostic reports."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """An estimated steering offset (rad) or radius ratio, with its standard errors.

    - ``random``: standard error from random errors.  A longer log reduces it.
    - ``systematic``: standard error from lasting errors, such as side slip.  A longer log does not
      reduce it.
    - ``determined``: ``True`` if the calibrated robot uses the estimate instead of its present
      value.
    - ``settled``: ``True`` if the standard error is small enough for odometry without visible
      drift.  An estimate that is not settled is determined if it contradicts the present value.
    - ``coarse``: ``True`` if the estimate is neither settled nor useless.
    """

    value: float
    random: float
    systematic: float
    determined: bool
    settled: bool
    coarse: bool

    @property
    def error(self) -> float:
        """Standard error from random and systematic errors together."""
        return math.hypot(self.random, self.systematic)


@dataclass(frozen=True, slots=True)
class WheelCalibration:
    """The estimated calibration of one wheel.

    - ``offset``: steering offset in rad, or ``None`` for a wheel without steering motor.  The
      steering offset is the position of the steering joint at which its encoder reads 0.
    - ``ratio``: ratio of the wheel radius to the radius in the robot file, or ``None`` for a wheel
      without encoder.  The mean of the logarithms of all radius ratios is 0.
    - ``radius``: wheel radius with the measured scale in m, or ``None`` for a wheel without
      encoder.
    - ``named``: name of the wheel radius in the robot file, or empty for the ordinary radius.
    - ``present_offset``: steering offset in the robot file, rad.
    """

    name: str
    offset: Estimate | None
    ratio: Estimate | None
    radius: float | None
    named: str
    present_offset: float


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """The calibration of all wheels in the order of the robot file, and the quality of the fit.

    - ``duration``: duration of the joint log, s.
    - ``moving``: time in which the robot moved, s.
    - ``scale``: factor of all wheel radii from a measured distance, or ``None`` without a measured
      distance.
    - ``rolling``: standard deviation of the rolling speed residuals in a tick, relative to the
      speed.
    - ``pointing``: standard deviation of the direction residuals in a tick, rad.
    - ``slip``: part of ``pointing`` that lasts over many ticks, at the worst wheel, rad.
    - ``offsets_kept``: ``True`` if the steering angles agree with the robot file.  Either the
      steering offsets in the robot file are right, or motors held the wheels at wrong angles.  The
      calibration does not change the steering offsets.
    - ``forced``: ``True`` if speed controllers kept the wheels at their commands.  With forced
      wheel speeds, the wheel radii are not changed.
    - ``iterations``: number of Gauss-Newton iterations.
    - ``correlation``: time constant (s) of the random errors, from the residuals.
    - ``remaining_errors``: standard deviations of the errors that last after the calibration, by
      the name of the field of ``Noise``.  Fields that the log does not determine are missing.
    - ``offset_plan``, ``ratio_plan``: motions that settle the open steering offsets and radius
      ratios, in addition to the log.  Empty without open values that a longer log can settle, and
      ``None`` if no motions of the robot settle them.
    """

    robot: str
    wheels: tuple[WheelCalibration, ...]
    duration: float
    moving: float
    scale: float | None
    rolling: float
    pointing: float
    slip: float
    offsets_kept: bool
    forced: bool
    iterations: int
    correlation: float
    remaining_errors: Mapping[str, float]
    offset_plan: MotionPlan
    ratio_plan: MotionPlan

    @property
    def determines_anything(self) -> bool:
        """``True`` if the joint log determines the scale, a steering offset or a radius ratio."""
        estimates = [e for w in self.wheels for e in (w.offset, w.ratio) if e is not None]
        return self.scale is not None or any(e.determined for e in estimates)


def calibrate(
    robot: Robot,
    log: JointLog,
    report: Report,
    distance: float | None = None,
    display: str = "",
    parameters: str | None = None,
) -> CalibrationResult | None:
    """Estimates the steering offsets and radii of the wheels from a joint log.

    - ``distance``: straight distance (m) between the positions of ``base_link`` at the first and
      the last line of the log.  The path of the robot between both positions may turn a little.
    - ``display``: name of the joint log in the source spans of diagnostics.
    - ``parameters``: name of the parameter set with the radii at the time of the log.  The name
      ``None`` selects the ordinary wheel radii.

    Adds errors to ``report`` and returns ``None`` if the joint log is not usable.  Raises
    ``DiagnosticError`` if the parameter set is unknown.
    """
    names = [""] * len(robot.wheels)
    if parameters is not None:
        radii = Parameters.from_robot(robot, parameters).radii
        name = next(s.radii for s in robot.parameter_sets if s.name == parameters) or ""
        names = [name if name in dict(wheel.radii) else "" for wheel in robot.wheels]
        wheels = zip(robot.wheels, radii, strict=True)
        robot = replace(robot, wheels=tuple(replace(w, radius=r) for w, r in wheels))
    # A joint log may contain any numbers, so results that are not finite are rejected at the end.
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
    moving = float(ticks.dt[ticks.moving].sum())
    if moving < MIN_MOVING_TIME:
        report.add(
            "joint-log-short",
            f"the wheels move for {moving:.3g} s of the log; "
            f"at least {MIN_MOVING_TIME:g} s are needed",
            span,
            hint="drive for a minute, with turns to both sides",
        )
        return None
    solver = Solver(robot, ticks.thinned())
    solution = solver.solve()
    if solution is None:
        report.add(
            "calibration-fit",
            "no offsets up to 45 deg and radius errors up to 20 % explain the log",
            span,
            hint="is it the log of this robot, on firm ground, in rad and rad/s?",
        )
        return None
    difference = _difference_from_commands(log, ticks)
    forced = difference is not None and difference < _FORCED
    wheels = _wheel_calibrations(robot, names, solution, forced)
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
        max(solution.sample_times) / 2.0,
        _remaining_errors(robot, solution, wheels, moving, distance),
        *_plans(robot, solver, solution, wheels, forced=forced),
    )
    _report_open_values(result, span, report)
    return result


def _difference_from_commands(log: JointLog, ticks: Ticks) -> float | None:
    """Returns the median relative difference between the wheel speeds and their commands.

    The wheel speed commands are delayed by the time that fits best.  Returns ``None`` if the joint
    log has no commands.
    """
    if not log.commands:
        return None
    middle = ((ticks.times[1:] + ticks.times[:-1]) / 2.0)[ticks.valid]
    speeds, commands = [], []
    for joint, values in log.commands.items():
        speeds.append(ticks.speeds[ticks.valid, ticks.wheel_of[joint]])
        commands.append(np.array(values[:-1])[ticks.valid])
    least_error, gains = math.inf, np.zeros(len(speeds))
    for lag in _LAGS:
        delayed = [np.interp(middle - lag, middle, command) for command in commands]
        error = float(float_sum(np.sum((a - b) ** 2) for a, b in zip(speeds, delayed, strict=True)))
        if error < least_error:
            least_error = error
            gains = np.array(
                [a @ b / max(b @ b, 1e-12) for a, b in zip(speeds, delayed, strict=True)]
            )
    return float(np.median(np.abs(gains - 1.0)))


# -- the result ---------------------------------------------------------------------------


def _wheel_calibrations(
    robot: Robot, names: Sequence[str], solution: Solution, forced: bool
) -> tuple[WheelCalibration, ...]:
    wheels: list[WheelCalibration] = []
    for i, wheel in enumerate(BaseGeometry.from_robot(robot).wheels):
        offset = ratio = radius = None
        present = calibration_solver.encoder_offset(robot, i)
        if wheel.steered:
            offset = _estimate(
                float(solution.offsets[i]),
                present,
                (float(solution.random.offsets[i]), float(solution.systematic.offsets[i])),
                calibration_solver.MAX_OFFSET_ERROR,
                usable=not solution.consistent,
            )
        if wheel.encoder and not wheel.swivel:
            value = math.exp(float(solution.ratios[i]))
            ratio = _estimate(
                value,
                1.0,
                (float(solution.random.ratios[i]), float(solution.systematic.ratios[i])),
                calibration_solver.MAX_RATIO_ERROR,
                usable=not forced,
            )
            radius = wheel.radius * (value if ratio.determined else 1.0)
        wheels.append(WheelCalibration(wheel.name, offset, ratio, radius, names[i], present))
    return tuple(wheels)


def _estimate(
    value: float, present: float, errors: tuple[float, float], limit: float, *, usable: bool
) -> Estimate:
    """Returns an estimate with its random and systematic standard errors.

    ``limit`` is the largest standard error of a settled value.  With ``usable`` = ``False`` the log
    repeats the commands of the driver, so that the estimate is not used.
    """
    error = math.hypot(*errors)
    settled = usable and error <= limit
    coarse = usable and limit < error <= _COARSE * limit
    contradicts = abs(value - present) > _CONTRADICTION * error
    return Estimate(value, *errors, settled or (coarse and contradicts), settled, coarse)


def _remaining_errors(
    robot: Robot,
    solution: Solution,
    wheels: Sequence[WheelCalibration],
    moving: float,
    distance: float | None,
) -> dict[str, float]:
    """Returns the errors that last after the calibration (see ``CalibrationResult``).

    The estimated ratios do not determine the common scale of the radii.  Without a measured
    distance, the scale keeps the error that the mean of all radii had before.  The log does not
    show the direction of fixed wheels.  Their direction and the steering zeros have one common
    standard deviation, so that the log determines it only for robots without fixed wheels.
    """
    errors: dict[str, float] = {}
    noise = Parameters.from_robot(robot, None).noise
    ratios = [wheel.ratio for wheel in wheels if wheel.ratio is not None]
    present_ratio, present_scale, _ = noise.lasting_errors
    if ratios and all(ratio.determined for ratio in ratios):
        errors["radius_error"] = _root_mean_square([ratio.error for ratio in ratios])
        errors["scale_error"] = math.hypot(present_scale, present_ratio / math.sqrt(len(ratios)))
    if distance is not None:
        random = solution.rolling * math.sqrt(solution.sample_times[0] / moving / len(ratios))
        errors["scale_error"] = math.hypot(_DISTANCE_ERROR / distance, random)
    offsets = [wheel.offset for wheel in wheels if wheel.offset is not None]
    fixed = any(wheel.fixed for wheel in BaseGeometry.from_robot(robot).wheels)
    if offsets and not fixed and all(offset.determined for offset in offsets):
        errors["steering_offset_error"] = _root_mean_square([offset.error for offset in offsets])
    return errors


def _root_mean_square(values: Sequence[float]) -> float:
    return math.hypot(*values) / math.sqrt(len(values))


def _plans(
    robot: Robot,
    solver: Solver,
    solution: Solution,
    wheels: Sequence[WheelCalibration],
    *,
    forced: bool,
) -> tuple[MotionPlan, MotionPlan]:
    """Returns the motions that settle the open offsets and ratios (see ``CalibrationResult``).

    Values that the log repeats from the commands have no plan, because no motions reveal them.
    """
    s = solver.turns.shape[1]
    parameters = len(solver.start)
    offset_rows = np.hstack([solver.turns, np.zeros((solver.n, parameters - s))])
    ratio_rows = np.zeros((solver.n, parameters))
    ratio_rows[solver.roll, s:] = solver.basis
    candidates: list[tuple[str, Array]] | None = None
    plans: list[MotionPlan] = []
    offsets = [None if solution.consistent else wheel.offset for wheel in wheels]
    ratios = [None if forced else wheel.ratio for wheel in wheels]
    for rows, estimates, systematic, limit in (
        (offset_rows, offsets, solution.systematic.offsets, calibration_solver.MAX_OFFSET_ERROR),
        (ratio_rows, ratios, solution.systematic.ratios, calibration_solver.MAX_RATIO_ERROR),
    ):
        open_wheels = [
            i
            for i, estimate in enumerate(estimates)
            if estimate is not None and not estimate.settled and systematic[i] < limit
        ]
        if not open_wheels:
            plans.append(())
            continue
        if candidates is None:
            candidates = [
                (motion.description, information)
                for motion in calibration_log.steady_motions(robot, solver.lever)
                for information in [
                    Solver(
                        robot, Ticks.steady(motion.speeds, motion.angles)
                    ).information_per_second(solution.factors, solution.sample_times)
                ]
                if np.all(np.isfinite(information))
            ]
        limits = limit**2 - np.square(systematic[open_wheels])
        plans.append(
            calibration_log.plan_motions(solution.covariance, rows[open_wheels], limits, candidates)
        )
    return plans[0], plans[1]


def _scale(
    robot: Robot,
    ticks: Ticks,
    solution: Solution,
    wheels: tuple[WheelCalibration, ...],
    distance: float,
    span: Span | None,
    report: Report,
) -> float | None:
    """Returns the factor of all radii for which the path ends are ``distance`` m apart.

    Newton's method computes the factor from the logarithms of the scale and the distance.  Adds an
    error to ``report`` and returns ``None`` if the joint log does not determine the factor.
    """
    if not bool(np.all(ticks.valid)):
        report.add(
            "calibration-distance",
            "the log has gaps: the distance that the robot drove in them is unknown",
            span,
            hint="give a distance for a log without gaps",
        )
        return None
    solver = Solver(robot, ticks)
    offsets = np.array([_offset_in_use(wheel) for wheel in wheels])
    ratios = np.array(
        [math.log(w.ratio.value) if w.ratio and w.ratio.determined else 0.0 for w in wheels]
    )

    def distance_of_ends(scale: float) -> float:
        return solver.ends_apart(offsets, ratios + math.log(scale), solution.factors)

    unscaled = distance_of_ends(1.0)
    scale, growth = 1.0, 1.0
    for _ in range(20):
        # A larger scale of the radii also increases the angle by which the robot turns.  On a path
        # that turns, the distance between the ends may therefore not grow with the scale.
        growth = (
            math.log(distance_of_ends(scale * 1.001) / distance_of_ends(scale * 0.999)) / 0.002
            if unscaled > 1.0
            else 0.0
        )
        if growth < _MIN_GROWTH:
            break
        step = math.log(distance / distance_of_ends(scale)) / growth
        scale *= math.exp(step)
        if abs(step) < 1e-9 or not 0.5 < scale < 2.0:
            break
    if growth < _MIN_GROWTH or abs(scale - 1.0) > calibration_solver.MAX_RATIO:
        hint = "give the straight distance of base_link between the log's first and last line"
        if growth < _MIN_GROWTH:
            hint = "drive straight on, 10 m or more: turns hide the scale"
        report.add(
            "calibration-distance",
            f"according to the wheels, the run ended {plain(unscaled, 4)} m from where it began; "
            f"{plain(distance, 4)} m were measured",
            span,
            hint=hint,
        )
        return None
    return scale


def _offset_in_use(wheel: WheelCalibration) -> float:
    """Returns the steering offset (rad) that the calibrated robot uses.

    Returns the estimated steering offset if the joint log determines the offset, or else the
    present steering offset.
    """
    offset = wheel.offset
    return offset.value if offset is not None and offset.determined else wheel.present_offset


def _report_open_values(result: CalibrationResult, span: Span | None, report: Report) -> None:
    slips = ""
    if result.slip > _SLIP:
        slips = f", while wheels slip sideways by {math.degrees(result.slip):.2g} deg"
    if result.offsets_kept:
        report.add(
            "calibration-steering",
            f"the steering angles agree with the offsets that the robot has{slips}: "
            "they are right, or motors held the wheels at them",
            span,
            hint="the offsets stay as they are",
        )
    else:
        offsets = [(w.name, w.offset) for w in result.wheels]
        limit = (math.degrees(calibration_solver.MAX_OFFSET_ERROR), "deg")
        scaled = {name: math.degrees(e.error) for name, e in offsets if e is not None}
        _report_unsettled(
            "steering offset", offsets, scaled, limit, slips, span, report, result.offset_plan
        )
    if result.forced:
        report.add(
            "calibration-forced",
            f"half of the wheels or more turned as commanded, within {_FORCED:.1%}: the log shows "
            "the set points of their speed controllers, not how the wheels roll",
            span,
            hint="the radii stay as they are; record with the drives' speed control off "
            "(`thorvaldc sim --open-loop`)",
        )
    else:
        ratios = [(w.name, w.ratio) for w in result.wheels]
        limit = (100.0 * calibration_solver.MAX_RATIO_ERROR, "%")
        scaled = {name: 100.0 * e.error for name, e in ratios if e is not None}
        _report_unsettled("radius", ratios, scaled, limit, "", span, report, result.ratio_plan)


def _report_unsettled(
    quantity: str,
    estimates: Iterable[tuple[str, Estimate | None]],
    errors: Mapping[str, float],
    limit: tuple[float, str],
    slips: str,
    span: Span | None,
    report: Report,
    plan: MotionPlan,
) -> None:
    """Reports the values of a quantity that are not settled, and the log that would settle them.

    ``errors`` are the standard errors of all values, in the unit of ``limit``.
    """
    unsettled = {name: e for name, e in estimates if e is not None and not e.settled}
    if not unsettled:
        return
    largest, unit = limit
    useless = [name for name, e in unsettled.items() if not e.coarse]
    coarse = [name for name, e in unsettled.items() if e.coarse]
    hints = []
    parts = []
    if useless:
        parts.append(f"does not determine the {quantity} of {', '.join(useless)}")
        hints.append("it stays as it is")
    if coarse:
        worst = max(errors[name] for name in coarse)
        parts.append(
            f"determines the {quantity} of {', '.join(coarse)} to +-{worst:.2g} {unit} only"
        )
    if plan is None:
        hints.append("no motions of this robot settle it without an external measurement")
    elif plan:
        motions = calibration_log.plan_text(plan)
        hints.append(f"a log with a further {motions} settles it (+-{largest:g} {unit})")
    else:
        hints.append("a longer log does not settle it: the errors last; use level, firm ground")
    report.add(
        "calibration-undetermined",
        f"the log {' and '.join(parts)}{slips}",
        span,
        hint="; ".join(hints),
    )
