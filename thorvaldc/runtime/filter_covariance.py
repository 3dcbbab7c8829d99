"""Covariance of the twist for filters that take the errors of the twists as independent.

A filter such as robot_localization sums twists to a pose, and takes the errors of two twists as
independent.  After N twists with the covariance Q at the period T, its pose has the covariance
N T^2 Q.  The errors of a real twist last.  The published covariance is therefore larger, so that
the sum has the right covariance:

    F = coth(T / 2 tau) Q + (2 tau_d / T) sum of k_b k_b'

Errors that last for some seconds: they have the covariance Q and, with a = exp(-T / tau) for
tau = ``Noise.correlation``, the autocorrelation a^n after n periods.  The variance of the sum of N
errors with the variance q is

    q (N + 2 sum over n of (N - n) a^n)  ->  N q (1 + a) / (1 - a) = N q coth(T / 2 tau).

For T << tau, the factor is 2 tau / T.  For tau = 0, the errors are white and the factor is 1.

Errors that last for the whole drive: a wrong radius or steering zero with the standard deviation 1
causes the twist error k_b.  After a drive of the duration D, the sum has the variance
(D k_b / T)^2, which grows with D^2.  The variance of D / T independent errors grows with D, so that
no factor is right for all D.  With the factor 2 tau_d / T, as if the errors lasted for tau_d, the
filter is right about the yaw for D = 2 tau_d.  For position and yaw together, with constant k_b and
S = integral of Ad(pose) dt, the mean of the squared error in units of the filter's covariance is

    NEES / 3 = tr((2 tau_d integral of Ad k k' Ad' dt)^-1 S k k' S') / 3 = c D / (2 tau_d)

with c = 2/3 on a straight line, where the errors of x and yaw add up and those of y do so by the
yaw, and c = 1/3 on circles, where only the yaw error adds up and the position error stays bounded.
(The matrix inequality of Cauchy and Schwarz gives c <= 1 for every path.)  D = 4 tau_d is between
both: NEES/3 is 4/3 on a straight line and 2/3 on circles.  ``DRIVE_ERROR_TIME`` gives these values
after 60 s.  After less time, the covariance of the filter is too large.  After much more time
without another sensor, it is too small.  ``LastingErrors`` has the right covariance of the pose at
all times.
"""

from __future__ import annotations

import math

from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators.twist_estimator import TwistEstimate, TwistEstimator
from thorvaldc.runtime.odometry import LOW_RANK_CORRELATION
from thorvaldc.runtime.se2 import Cov3

DRIVE_ERROR_TIME = 15.0
"""Time constant tau_d (s) of the errors that last for the whole drive: a quarter of 60 s."""


def filter_covariance(
    estimator: TwistEstimator, joints: JointStates | None, estimate: TwistEstimate, period: float
) -> Cov3:
    """Returns the covariance F of vx, vy and wz for filters, in SI units, as the module derives it.

    - ``joints``: joint states of the estimate, or ``None`` before the first ones.
    - ``period``: time (s) between two twists.
    """
    if joints is None:
        return estimate.covariance
    # The odometry has the same rule for directions that no wheel measures.
    tau = estimator.noise.correlation if estimate.rank == 3 else LOW_RANK_CORRELATION
    factor = 1.0 / math.tanh(period / (2.0 * tau)) if tau else 1.0
    lasting = 2.0 * DRIVE_ERROR_TIME / period
    xx = xy = xw = yy = yw = ww = 0.0
    for x, y, w in estimator.lasting_errors(joints, estimate, estimate.twist):
        xx += lasting * x * x
        xy += lasting * x * y
        xw += lasting * x * w
        yy += lasting * y * y
        yw += lasting * y * w
        ww += lasting * w * w
    return se2.combine(((xx, xy, xw), (xy, yy, yw), (xw, yw, ww)), estimate.covariance, factor)
