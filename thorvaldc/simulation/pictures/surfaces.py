"""Surfaces of the visual shapes of a robot as arrays, and their outlines seen from above."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from thorvaldc.model import Pose, Robot, Shape
from thorvaldc.simulation.pictures.triangles import shape_triangles

Points = npt.NDArray[np.float64]
Faces = npt.NDArray[np.int64]
_DIRECTIONS = 48
"""Number of directions in which an outline has a corner."""


def surface(robot: Robot, shape: Shape) -> tuple[Points, Faces]:
    """Returns the vertices and triangles of the surface of a visual shape.

    The vertices (m) are in the frame of the shape, with the array shape (n, 3).  Each triangle has
    three vertex indices, with the array shape (m, 3).
    """
    points, triangles = shape_triangles(robot, shape)
    return np.array(points, dtype=np.float64), np.array(triangles, dtype=np.int64)


def outline_from_above(robot: Robot, shape: Shape, pose: Pose) -> tuple[Points, float]:
    """Returns the approximate convex outline of a shape, seen from above, and its highest z (m).

    ``pose``: the frame of the shape in the frame of the outline, with the array shape (n, 2) in m.
    """
    local, _ = surface(robot, shape)
    turned = np.array([pose.rotate(e) for e in ((1, 0, 0), (0, 1, 0), (0, 0, 1))])
    points = local @ turned + np.asarray(pose.xyz)
    outline = convex(points[:, :2])
    return outline, float(points[:, 2].max())


def convex(points: Points) -> Points:
    """Returns an approximate convex hull of points, with the array shape (n, 2).

    The corners of the hull are the furthest points in each of ``_DIRECTIONS`` directions.
    """
    angles = np.arange(_DIRECTIONS) * math.tau / _DIRECTIONS
    furthest = np.argmax(points @ np.array([np.cos(angles), np.sin(angles)]), axis=0)
    outline: Points = points[furthest]
    return outline
