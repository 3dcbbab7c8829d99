"""Linear programs with a feasible origin, solved by the simplex method.

    maximise c . x   subject to   A x <= b,  x >= 0,   with b >= 0.

The origin is feasible, so that the method starts there and needs no first phase. Bland's rule
chooses the pivots: the method ends for every input.
"""

from __future__ import annotations

from collections.abc import Sequence

_ZERO = 1e-11


def maximize(
    objective: Sequence[float], rows: Sequence[Sequence[float]], bounds: Sequence[float]
) -> tuple[list[float], list[float]]:
    """Return the solution x and the multiplier of each row.

    The multipliers y >= 0 satisfy A^T y >= c, with equality where x > 0, and y = 0 for a row that
    is not tight. The problem must be bounded; a direction without a bound is not followed.

    - ``objective``: c.
    - ``rows``, ``bounds``: A and b; negative elements of b count as 0.
    """
    n, m = len(objective), len(rows)
    table = [
        [*row, *(1.0 if i == k else 0.0 for k in range(m)), max(bound, 0.0)]
        for i, (row, bound) in enumerate(zip(rows, bounds, strict=True))
    ]
    costs = [*objective, *[0.0] * m, 0.0]
    basis = list(range(n, n + m))
    unbounded: set[int] = set()
    while True:
        entering = next(
            (j for j in range(n + m) if costs[j] > _ZERO and j not in unbounded),
            None,
        )
        if entering is None:
            break
        leaving, least = None, 0.0
        for i, row in enumerate(table):
            if row[entering] > _ZERO:
                ratio = row[-1] / row[entering]
                if leaving is None or (ratio, basis[i]) < (least, basis[leaving]):
                    leaving, least = i, ratio
        if leaving is None:
            unbounded.add(entering)
            continue
        pivot_row = [value / table[leaving][entering] for value in table[leaving]]
        table[leaving] = pivot_row
        for row in (*table[:leaving], *table[leaving + 1 :], costs):
            factor = row[entering]
            if factor != 0.0:
                for j, value in enumerate(pivot_row):
                    row[j] -= factor * value
        basis[leaving] = entering
    solution = [0.0] * (n + m)
    for i, j in enumerate(basis):
        solution[j] = table[i][-1]
    return solution[:n], [-cost for cost in costs[n : n + m]]
