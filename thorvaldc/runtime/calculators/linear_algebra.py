"""Linear algebra in plain Python for computations that run in every control cycle."""

from __future__ import annotations

from collections.abc import Iterable


def solve3(
    a11: float,
    a12: float,
    a13: float,
    a22: float,
    a23: float,
    a33: float,
    b1: float,
    b2: float,
    b3: float,
) -> tuple[float, float, float]:
    """Solves A x = b by cofactors, for a symmetric positive definite 3 x 3 matrix A."""
    c11 = a22 * a33 - a23 * a23
    c12 = a13 * a23 - a12 * a33
    c13 = a12 * a23 - a13 * a22
    c22 = a11 * a33 - a13 * a13
    c23 = a12 * a13 - a11 * a23
    c33 = a11 * a22 - a12 * a12
    inverse = 1.0 / (a11 * c11 + a12 * c12 + a13 * c13)
    return (
        (c11 * b1 + c12 * b2 + c13 * b3) * inverse,
        (c12 * b1 + c22 * b2 + c23 * b3) * inverse,
        (c13 * b1 + c23 * b2 + c33 * b3) * inverse,
    )


def least_squares3(
    rows: Iterable[tuple[float, float, float, float]], weight: float, angular_weight: float
) -> tuple[float, float, float]:
    """Returns the vector d that minimises sum (l d - v)^2 + weight (d1^2 + d2^2) +
    angular_weight d3^2.

    ``rows``: the rows (l1, l2, l3, v).
    """
    a11 = a22 = weight
    a33 = angular_weight
    a12 = a13 = a23 = b1 = b2 = b3 = 0.0
    for l1, l2, l3, value in rows:
        a11 += l1 * l1
        a12 += l1 * l2
        a13 += l1 * l3
        a22 += l2 * l2
        a23 += l2 * l3
        a33 += l3 * l3
        b1 += l1 * value
        b2 += l2 * value
        b3 += l3 * value
    return solve3(a11, a12, a13, a22, a23, a33, b1, b2, b3)
