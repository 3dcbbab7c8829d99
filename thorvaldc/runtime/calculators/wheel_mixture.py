"""Hypotheses about the causes of wheels that disagree, and their mixture.

``wheel_causes`` finds the hypotheses, and explains the mixture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.calculators.twist_fit import Fit, Measurement

_MIN_PROBABILITY: Final = 0.6
"""Least probability at which a single wrong wheel is named: it exceeds all others clearly."""
_SURE: Final = 0.97
"""Least probability at which wheels are named if several are wrong, or if they may slide."""


class Hypothesis(NamedTuple):
    """Causes of the wheels, and the fit of the twist that follows from the causes.

    - ``wrong``: indices of the measurements of wrong wheels and of wheels with wrong encoders.
    - ``sliding``: indices of the measurements of wheels that turn as commanded, but slide.
    - ``fit``: fitted twist.
    - ``cost``: cost, by the formula in the documentation of the module ``wheel_causes``.
    - ``worst_ratio``: largest quotient of chi-square and gate of the healthy wheels.  A wheel whose
      chi-square is larger than its gate disagrees with the other wheels.
    - ``least_weight``: least weight in the covariance.
    - ``others``: fit without all measurements of the wrong wheels.
    - ``measurements``: all measurements with the uses that the fit makes of them.
    - ``doubted``: indices of the measurements of wheels that may be a little wrong, all of which
      the fit uses.
    """

    wrong: tuple[int, ...]
    sliding: tuple[int, ...]
    fit: Fit
    cost: float
    worst_ratio: float
    least_weight: float
    others: Fit
    measurements: list[Measurement]
    doubted: tuple[int, ...] = ()


class Mixture(NamedTuple):
    """Mixture of the likely hypotheses.

    - ``fit``: mean twist and covariance.
    - ``left_out``: indices of the measurements of wheels that are clearly wrong.
    - ``suspects``: indices of the measurements of wheels that may be wrong.
    - ``sliding``: indices of the measurements of wheels that may slide.
    """

    fit: Fit
    left_out: tuple[int, ...]
    suspects: tuple[int, ...]
    sliding: tuple[int, ...]


def mixture(hypotheses: Sequence[Hypothesis], *, as_measured: bool) -> Mixture:
    """Returns the mixture of the hypotheses.

    - ``hypotheses``: the most likely first, or, with ``as_measured``, that all wheels are healthy.
    - ``as_measured``: ``True`` if the wheels agree, so that the mean is the first fit.

    With the probabilities p_i, means xi_i and covariances P_i of the hypotheses, the mixture has
    the mean xi = sum p_i xi_i and the covariance of ``covering``.
    """
    best = hypotheses[0]
    # The first fit of wheels that are not tested, because they skid, may have a large misfit.
    least = min(h.cost for h in hypotheses)
    weights = [math.exp((least - h.cost) / 2.0) for h in hypotheses]
    total = float_sum(weights)
    probabilities = [weight / total for weight in weights]
    fits = [h.fit for h in hypotheses]
    vx = float_sum(p * f.vx for p, f in zip(probabilities, fits, strict=True))
    vy = float_sum(p * f.vy for p, f in zip(probabilities, fits, strict=True))
    wz = float_sum(p * f.wz for p, f in zip(probabilities, fits, strict=True))
    mean = best.fit if as_measured else best.fit._replace(vx=vx, vy=vy, wz=wz)
    at_least = [max(p, h.least_weight) for p, h in zip(probabilities, hypotheses, strict=True)]
    mean = covering(mean, at_least, fits)
    sliding = {k for h in hypotheses for k in h.sliding}
    # Nothing is left out on the word of a motor that turns as commanded.
    needed = _SURE if sliding or len(best.wrong) > 1 else _MIN_PROBABILITY
    if best.wrong and probabilities[0] > needed:
        return Mixture(mean, best.wrong, (), ())
    suspects = tuple({k for h in hypotheses for k in (*h.wrong, *h.doubted)})
    return Mixture(mean, (), suspects, tuple(sliding))


def covering(mean: Fit, weights: Sequence[float], fits: Sequence[Fit]) -> Fit:
    """Returns ``mean`` with the covariance sum min(4 w_i, 1) P_i + w_i (xi_i - xi) (xi_i - xi)'.

    A mixture has the weights w_i for P_i too.  They count more here, because the true hypothesis
    may be one of small weight.
    """
    vx, vy, wz = mean[:3]
    p11 = p12 = p13 = p22 = p23 = p33 = 0.0
    for p, f in zip(weights, fits, strict=True):
        dx, dy, dw = f.vx - vx, f.vy - vy, f.wz - wz
        k = min(4.0 * p, 1.0)
        p11 += k * f.p11 + p * dx * dx
        p12 += k * f.p12 + p * dx * dy
        p13 += k * f.p13 + p * dx * dw
        p22 += k * f.p22 + p * dy * dy
        p23 += k * f.p23 + p * dy * dw
        p33 += k * f.p33 + p * dw * dw
    return Fit(vx, vy, wz, p11, p12, p13, p22, p23, p33, mean.measurements)


def with_covariance(fit: Fit, factor: float) -> Fit:
    """Returns ``fit`` with its covariance multiplied by ``factor``."""
    vx, vy, wz, p11, p12, p13, p22, p23, p33, rest = fit
    p11, p12, p13 = factor * p11, factor * p12, factor * p13
    return Fit(vx, vy, wz, p11, p12, p13, factor * p22, factor * p23, factor * p33, rest)
