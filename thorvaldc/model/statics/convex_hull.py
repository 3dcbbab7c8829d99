"""Computes convex hulls in the plane, and whether two of them overlap."""

from __future__ import annotations

import math
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


def overlap(hull: Sequence[Point], other: Sequence[Point]) -> tuple[float, Point] | None:
    """Returns the shortest move of ``other`` after which two convex polygons do not overlap.

    The result is the distance (m) and the direction (unit vector), or ``None`` if the polygons do
    not overlap.  The shortest move is along the normal of an edge of one of the polygons.
    """
    best: tuple[float, Point] | None = None
    for corners, sign in ((hull, 1.0), (other, -1.0)):
        for (ax, ay), (bx, by) in zip(corners, [*corners[1:], *corners[:1]], strict=True):
            length = math.hypot(bx - ax, by - ay)
            if length == 0.0:
                continue
            nx, ny = (by - ay) / length, (ax - bx) / length  # outwards
            opposite = other if corners is hull else hull
            depth = -min((x - ax) * nx + (y - ay) * ny for x, y in opposite)
            if depth <= 0.0:
                return None
            if best is None or depth < best[0]:
                best = depth, (sign * nx, sign * ny)
    return best
