from __future__ import annotations

import math

from thorvaldc.model.sums import float_sum


def test_each_addition_is_rounded() -> None:
    assert float_sum([0.1] * 10) == 0.9999999999999999  # `sum` of Python 3.12 and fsum: 1.0
    assert float_sum([]) == 0.0


def test_sums_that_are_not_finite_are_values() -> None:
    assert float_sum([1e308, 1e308]) == math.inf
    assert math.isnan(float_sum([math.inf, -math.inf]))
