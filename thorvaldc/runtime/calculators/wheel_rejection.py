"""Which wheels are wrong: the explanations of a misfit, and how likely each is."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from thorvaldc.runtime.calculators.twist_fit import (
    TEST_ROLL,
    USE_ROLL,
    USE_SIDE,
    Fit,
    Reading,
    chi_squares,
    misfit,
    test,
)

_LIKELY = 6.63
"""Chi-square (one degree of freedom, 1 %) up to which a part of a wrong wheel is believed."""
_NEGLIGIBLE = 9.2
"""Difference of costs from which an explanation (then less than 1 %) is left out."""
_HALVES = 3
"""How many of the likeliest wheels are tried as one of two that are wrong."""


class Explanation(NamedTuple):
    """A fit without the wheels at some places among the readings, or without parts of them.

    ``cost``: minus twice the logarithm of its likelihood; the misfit of what is used, a
    price for the first wheel that is wrong, twice that for the second (a fault beside
    a fault must be as much rarer again).  ``others``: the largest D of the right ones,
    in gates.
    """

    places: tuple[int, ...]
    readings: list[Reading]
    found: Fit
    cost: float
    others: float


class Rejection:
    """Looks for the wheels that are wrong; at most ``faulty`` (0 to 2) of them.

    ``gates``: the D (see ``chi_squares``) that each reading may have; ``price``: that of
    a wheel of which a part is wrong.  ``fresh`` fits readings from nothing, ``again`` from a
    twist: what wrong wheels did to the weights of the others shall not outlast them.
    """

    def __init__(
        self,
        gates: Sequence[float],
        price: float,
        faulty: int,
        fresh: Callable[[list[Reading]], Fit],
        again: Callable[[list[Reading], Fit], Fit],
    ) -> None:
        self._gates = gates
        self._price = price
        self._faulty = faulty
        self._fresh = fresh
        self._again = again

    def explanations(self, readings: list[Reading], found: Fit) -> list[Explanation]:
        """All that are not negligible, the likeliest first.

        ``found`` is the fit of all readings, some of which are beyond their gates;
        that all are right is one explanation.  Empty where nothing explains them.
        """
        whole = self._explanation((), readings, found)
        singles = self._more(whole)
        singles.sort(key=_cost)
        every = [whole, *singles]
        if singles and self._faulty > 1 and min(every, key=_cost).others > 1.0:
            for rank, half in enumerate(singles[:_HALVES]):
                every += self._more(half, [s.places[0] for s in singles[:rank]])
        every.sort(key=_cost)
        if every[0].others > 2.0:  # twice the gate: its probability squared
            return []
        likely = [e for e in every if e.cost - every[0].cost < _NEGLIGIBLE]
        return [
            e._replace(found=self._again(e.readings, e.found)) if e.places else e for e in likely
        ]

    def _more(self, before: Explanation, done: Sequence[int] = ()) -> list[Explanation]:
        """All with one wrong wheel more, but for those that are ``done``."""
        result: list[Explanation] = []
        if len(before.places) >= self._faulty:
            return result
        for k, line in enumerate(before.found.lines):
            if k in before.places or k in done or not test(before.found, line).spare:
                continue
            places = (*before.places, k)
            left = [_using(r, 0) if j in places else r for j, r in enumerate(before.readings)]
            result.append(self._explanation(places, left, self._fresh(left)))
        return result

    def _explanation(
        self, places: tuple[int, ...], readings: list[Reading], found: Fit
    ) -> Explanation:
        others = 0.0
        for k, d in enumerate(chi_squares(found)):
            if k not in places:
                others = max(others, d / self._gates[k])
        cost = misfit(found)
        readings, current = [*readings], found
        for n, k in enumerate(places, 1):
            cost += n * self._price
            if not readings[k][0] & TEST_ROLL:
                continue
            # The speed or the direction may still agree; both are seldom wrong.
            parts = test(current, current.lines[k])
            least = min(parts.roll, parts.side)
            cost += min(least, _LIKELY)
            if least < _LIKELY:
                readings[k] = _using(readings[k], USE_ROLL if parts.roll == least else USE_SIDE)
                if n < len(places):
                    current = self._again(readings, current)
        return Explanation(places, readings, found, cost, others)


def mixture(explanations: Sequence[Explanation]) -> tuple[Fit, float]:
    """Mean and covariance over the explanations; the probability of the first.

    A wheel that is only likely to be wrong is only likely to be left out.
    """
    first = explanations[0]
    if len(explanations) == 1:
        return first.found, 1.0
    weights = [math.exp((first.cost - e.cost) / 2.0) for e in explanations]
    total = sum(weights)
    shares = [weight / total for weight in weights]
    fits = [e.found for e in explanations]
    vx = sum(p * f.vx for p, f in zip(shares, fits, strict=True))
    vy = sum(p * f.vy for p, f in zip(shares, fits, strict=True))
    wz = sum(p * f.wz for p, f in zip(shares, fits, strict=True))
    p11 = p12 = p13 = p22 = p23 = p33 = 0.0
    for p, f in zip(shares, fits, strict=True):
        dx, dy, dw = f.vx - vx, f.vy - vy, f.wz - wz
        p11 += p * (f.p11 + dx * dx)
        p12 += p * (f.p12 + dx * dy)
        p13 += p * (f.p13 + dx * dw)
        p22 += p * (f.p22 + dy * dy)
        p23 += p * (f.p23 + dy * dw)
        p33 += p * (f.p33 + dw * dw)
    return Fit(vx, vy, wz, p11, p12, p13, p22, p23, p33, first.found.lines), shares[0]


def _cost(explanation: Explanation) -> float:
    return explanation.cost


def _using(reading: Reading, bits: int) -> Reading:
    return (reading[0] & ~(USE_ROLL | USE_SIDE) | bits, *reading[1:])
