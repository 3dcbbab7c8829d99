"""Linear algebra in plain Python for computations that run in every control cycle."""

from __future__ import annotations


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
