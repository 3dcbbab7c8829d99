"""The support polygon of a robot, and the angles at which it tips over.

Tip-over angles. The robot is rigid but for the hinges of trailers, stands with its wheels on a
plane, and does not slide. Its support polygon is the convex hull of the contact points. The edge e
of the polygon has the outward normal n_e, and the centre of mass, at the height h above the plane,
has the horizontal distance d_e from it, positive inside. The plane is tilted by the angle a, so
that it falls in the horizontal direction u. In the frame of the plane, the weight W then has the
component W cos(a) into the plane and W sin(a) along u. The wheels push only, so the robot tips over
the edge e as soon as the moment about the edge is not positive:

    W cos(a) d_e - W sin(a) h (u . n_e) <= 0.

Tip-over angle in the direction u, over the first edge that the robot reaches:

    tan a(u) = min over edges with u . n_e > 0 of d_e / (h (u . n_e)).

The least angle of all directions is in the direction of a normal, where u . n_e = 1:
tan a_min = min d_e / h. A trailer acts at its hinge (``held_body``), where h is another one along x
and along y; that it may tip over by itself is not judged. A pendulum axle counts as a support below
its axis, and not at it: in MuJoCo, angles were up to 45 % larger for a base with two more wheels,
and up to 15 % smaller with four. The suspension, the tyres and loose loads lower the real angles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from thorvaldc.diagnostics import Span
from thorvaldc.model import Link, Robot, Vec3
from thorvaldc.model.spatial import clean
from thorvaldc.model.statics.ground_contacts import held_body
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.sums import float_sum

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


_SHORTEST_EDGE = 1e-9  # m
_LOWEST_HEIGHT = 1e-9  # m
_LEAST_PULL = 1e-9  # m


class Edge(NamedTuple):
    """An edge of the support polygon.

    - ``margin``: distance of the centre of mass from the edge in m, negative outside.
    - ``pull``: moments about the edge (m) of forces along x and y that equal the weight, outwards
      positive.
    """

    margin: float
    pull: Point


class Support(NamedTuple):
    """The support polygon of a robot and the centre of mass in m that it holds.

    ``edges`` is empty for a robot whose contact points do not span an area.
    """

    edges: tuple[Edge, ...]
    com: Vec3

    @property
    def margin(self) -> float:
        """The smallest margin in m, or minus infinity without a polygon."""
        return min((edge.margin for edge in self.edges), default=-math.inf)

    @property
    def stands(self) -> bool:
        """True if the centre of mass is above the inside of the support polygon."""
        return self.margin > 0.0

    def tip_over_angle(self, direction: float) -> float:
        """Return the angle in rad at which the robot tips over on a plane that falls in a
        direction (rad, from x to y), 0 for a robot that does not stand."""
        if not self.stands:
            return 0.0
        tangents = []
        for edge in self.edges:
            x, y = edge.pull
            moment = x * math.cos(direction) + y * math.sin(direction)
            if moment > _LEAST_PULL:
                tangents.append(edge.margin / moment)
        return math.atan(min(tangents, default=math.inf))

    def least_tip_over(self) -> tuple[float, float]:
        """Return the direction (rad, from x to y) of the smallest tip-over angle, and the angle in
        rad, 0 for a robot that does not stand. The direction is 0 without a polygon."""

        def tangent(edge: Edge) -> float:
            return clean(edge.margin / math.hypot(*edge.pull))

        if not self.edges:
            return 0.0, 0.0
        # Equal margins of a symmetric robot differ by rounding.
        edge = min(self.edges, key=tangent)
        x, y = edge.pull
        return math.atan2(y, x), math.atan2(max(edge.margin, 0.0), math.hypot(x, y))


def support_of(robot: Robot) -> Support:
    """Return the support polygon of a robot with all joints at position 0."""
    supports, (x, y, z), along = held_body(robot)
    hull = convex_hull(supports)
    if len(hull) < 3:
        return Support((), (x, y, z))
    edges = []
    for (ax, ay), (bx, by) in zip(hull, [*hull[1:], *hull[:1]], strict=True):
        length = math.hypot(bx - ax, by - ay)
        if length > _SHORTEST_EDGE:
            tx, ty = (bx - ax) / length, (by - ay) / length
            pull = ty * max(along, _LOWEST_HEIGHT), -tx * max(z, _LOWEST_HEIGHT)
            edges.append(Edge(tx * (y - ay) - ty * (x - ax), pull))
    return Support(tuple(edges), (x, y, z))


# -- where masses and wheels are ------------------------------------------------------------


def placed_masses(robot: Robot) -> list[tuple[Link, Vec3]]:
    """Return each link that has a mass, with its centre of mass in ``base_link`` in m, with all
    joints at position 0."""
    pose = tree_of(robot).pose
    return [
        (link, pose[link.name].apply(link.inertial.com))
        for link in robot.links
        if link.inertial is not None and link.name in pose
    ]


def outer_points(robot: Robot) -> list[tuple[Vec3, Span, str]]:
    """Return the centres of mass of all links and the front and rear of all wheels, in
    ``base_link`` in m, each with the source span and the name of its module."""
    points = [(com, link.span, link.module) for link, com in placed_masses(robot)]
    for wheel in robot.wheels:
        for side in (-1, 1):
            x = wheel.x + side * wheel.radius
            points.append(((x, wheel.y, wheel.radius), wheel.span, wheel.module))
    return points


def pulls_out(robot: Robot) -> Link:
    """Return the link that draws the centre of mass of the robot most away from the middle of the
    wheels: that of the largest moment in this direction."""
    contacts = [wheel.contact_point for wheel in robot.wheels]
    x, y = (float_sum(values) / len(contacts) for values in zip(*contacts, strict=True))
    out = (robot.inertial.com[0] - x, robot.inertial.com[1] - y)

    def moment(placed: tuple[Link, Vec3]) -> float:
        link, com = placed
        mass = link.inertial.mass if link.inertial is not None else 0.0
        return mass * ((com[0] - x) * out[0] + (com[1] - y) * out[1])

    return max(placed_masses(robot), key=moment)[0]
