"""Covariance of the twist for filters that take the errors of two twists as independent.

A filter such as robot_localization takes the errors of two twists as independent: after N twists
with the covariance Q at the period T, its pose has the covariance N T^2 Q.  The errors of a real
twist last.  The published covariance is therefore larger:

    F = (1 + r (coth(T / 2 tau) - 1)) Q + (2 c t / T) sum of k_b k_b'

Errors that last for some seconds: with a = exp(-T / tau) for tau = ``Noise.correlation``, they
have the autocorrelation a^n after n periods.  The variance of the sum of N errors with the
variance q is

    q (N + 2 sum over n of (N - n) a^n)  ->  N q (1 + a) / (1 - a) = N q coth(T / 2 tau).

For T << tau, the factor is 2 tau / T.  An error that lasts for the whole drive does not count as
one of some seconds too: r is the largest share of the variance of a speed or a direction that
does not last for the drive.  By default only that of a wheel at rest does not.

Errors that last for the whole drive: a wrong radius or steering zero with the standard deviation
1 causes the twist error k_b.  After t s of motion, the sum has the variance (t k_b / T)^2, which
grows with t^2; in a period it grows by 2 t k_b^2 / T.  With c = 1 the filter is thus right about
the yaw at all times.  Its error of the position is that of yaw errors which change, and is
smaller on a straight line than that of a constant one: with constant k_b, the mean of the squared
error in units of the filter's covariance, NEES/3, is 5/6 on a straight line, and 1/3 on circles,
where the error of the position stays bounded.  ``_DRIVE_ERROR_SHARE`` is between both: with
c = 0.6, NEES/3 is 1.4 and 0.6.

From ``_LONGEST_DRIVE`` on, the factor stays: a filter that also has GNSS shall not distrust the
wheels after an hour.  Without another sensor it says too little from then on.  The covariance of
the pose (``odometry``) is right at all times.
"""

from __future__ import annotations

import math
from typing import Final

from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimate, TwistEstimator
from thorvaldc.runtime.odometry import LOW_RANK_CORRELATION
from thorvaldc.runtime.se2 import Cov3

_DRIVE_ERROR_SHARE: Final = 0.6
"""Share c of the growth of the variance by errors that last for the whole drive."""
_LONGEST_DRIVE: Final = 60.0
"""Time (s) of motion from which the factor of errors that last for the whole drive stays."""
_UNDECIDED_TIME: Final = 60.0
"""Time constant (s) of the errors while the wheels do not tell whether they slide."""


def sum_of_autocorrelation(tau: float, period: float) -> float:
    """Returns the sum over all lags of exp(-|lag| period / tau): by this factor, a filter that
    takes the errors of two measurements as independent needs a larger variance.

    ``tau``: time constant of the errors (s); ``period``: time between two measurements (s).
    """
    return 1.0 / math.tanh(period / (2.0 * tau))


def filter_covariance(
    estimator: TwistEstimator,
    joints: JointStates | None,
    estimate: TwistEstimate,
    period: float,
    motion_time: float,
) -> Cov3:
    """Returns the covariance F of vx, vy and wz for filters, in SI units, as the module derives it.

    - ``joints``: joint states of the estimate, or ``None`` before the first ones.
    - ``period``: time (s) between two twists.
    - ``motion_time``: time (s) for which the robot has moved, see ``Odometry``.
    """
    if joints is None:
        return estimate.covariance
    noise = estimator.noise
    # The odometry has the same rule for directions that no wheel measures.
    tau, share = LOW_RANK_CORRELATION, 1.0
    if estimate.sliding:  # wheels of a healthy robot are suspect by chance, but do not slide
        tau = _UNDECIDED_TIME
    elif estimate.rank == 3:
        tau = noise.correlation
        radius, _, offset = noise.lasting_errors
        rolling, direction = noise.rolling, noise.direction
        vx, vy, wz = estimate.twist
        squared = vx * vx + vy * vy + estimator.length2 * wz * wz
        at_rest = max(noise.speed_floor / rolling, noise.slip_floor / direction)
        if squared:
            lasts = min(radius / rolling, offset / direction)
            share -= lasts * lasts * squared / (squared + at_rest * at_rest)
    factor = 1.0 + share * (sum_of_autocorrelation(tau, period) - 1.0) if tau else 1.0
    lasting = 2.0 * _DRIVE_ERROR_SHARE * min(motion_time, _LONGEST_DRIVE) / period
    xx = xy = xw = yy = yw = ww = 0.0
    for x, y, w in estimator.lasting_errors(joints, estimate, estimate.twist):
        xx += lasting * x * x
        xy += lasting * x * y
        xw += lasting * x * w
        yy += lasting * y * y
        yw += lasting * y * w
        ww += lasting * w * w
    return se2.combine(((xx, xy, xw), (xy, yy, yw), (xw, yw, ww)), estimate.covariance, factor)
