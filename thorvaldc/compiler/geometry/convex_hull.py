"""Computes convex hulls in the plane, and whether two of them overlap."""

from __future__ import annotations

from collections.abc import Sequence

Point = tuple[float, float]
"""Coordinates x and y (m)."""


def convex_hull(points: Sequence[Point]) -> list[Point]:
    """Returns the corners of the convex hull of points in the plane, counter-clockwise.

    Points on the edges of the convex hull are left out.  The convex hull is computed with Andrew's
    monotone chain algorithm.
    """
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return ordered

    def half_hull(source: list[Point]) -> list[Point]:
        chain: list[Point] = []
        for p in source:
            while len(chain) >= 2:
                (ax, ay), (bx, by) = chain[-2], chain[-1]
                if (bx - ax) * (p[1] - ay) - (by - ay) * (p[0] - ax) > 1e-12:
                    break
                chain.pop()
            chain.append(p)
        return chain[:-1]

    return half_hull(ordered) + half_hull(ordered[::-1])


def separates(hull: Sequence[Point], other: Sequence[Point]) -> bool:
    """Returns whether an edge of ``hull`` has all points of ``other`` on its outer side.

    Two convex polygons do not overlap if an edge of one of them separates them (separating axis
    theorem).  ``hull``: corners of a convex polygon, counter-clockwise.
    """
    for (ax, ay), (bx, by) in zip(hull, [*hull[1:], *hull[:1]], strict=True):
        if all((bx - ax) * (y - ay) - (by - ay) * (x - ax) <= 0.0 for x, y in other):
            return True
    return False
