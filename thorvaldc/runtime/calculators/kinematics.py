"""The bare geometry of a robot's wheels: no limits, no memory, no errors.

For those who plan, sweep or learn and ask one state at a time; a robot is driven by a
``BaseCalculator``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.runtime.calculators.unrolled import compiled, scaled

Floats = tuple[float, ...]


class Kinematics:
    """Wheels that are driven and steered, or driven and fixed; casters besides say nothing.

    ``inverse(vx, vy, wz)``: the wheels' speeds (rad/s, forwards where steered) and
    steering angles (rad, without limits) for a twist of ``base_link``, one entry for each wheel.

    ``least_squares(speeds, angles)``: the twist nearest to the wheels' velocities, all
    weighing alike.  About the wheels' centre turning and translation come apart: with
    velocities u at x', y' from it, wz = sum(x' u_y - y' u_x) / sum(x'^2 + y'^2).

    Both are straight-line code with the robot's numbers in it.
    """

    inverse: Callable[[float, float, float], tuple[Floats, Floats]]
    least_squares: Callable[[Sequence[float], Sequence[float]], tuple[float, float, float]]

    def __init__(self, geometry: BaseGeometry) -> None:
        """Raises ``ValueError`` for wheels of other kinds.

        What a wheel without encoder says depends on its angle, and one behind its axis
        points past its velocity.
        """
        holding = [w for w in geometry.wheels if not w.swivel]
        if not holding or any(not w.driven or w.trail or w.lateral for w in holding):
            raise ValueError("every wheel must be driven, and stand under its steering axis")
        self.inverse = compiled(_inverse_text(geometry), "inverse")
        self.least_squares = compiled(_least_squares_text(geometry), "least_squares")


def _inverse_text(geometry: BaseGeometry) -> str:
    lines = ["def inverse(vx, vy, wz):"]
    speeds, angles = [], []
    for i, w in enumerate(geometry.wheels):
        speed = angle = "0.0"
        if w.steered:
            lines.append(f"    x{i} = {scaled((1.0, -w.y), ('vx', 'wz'))}")
            lines.append(f"    y{i} = {scaled((1.0, w.x), ('vy', 'wz'))}")
            speed = f"sqrt(x{i} * x{i} + y{i} * y{i}) * {1.0 / w.radius!r}"
            angle = scaled((w.sign, -w.sign * w.heading), (f"atan2(y{i}, x{i})", "1.0"))
        elif not w.swivel:
            speed = scaled([v / w.radius for v in w.rows(0.0)[0]], ("vx", "vy", "wz"))
        speeds.append(speed)
        angles.append(angle)
    lines.append(f"    return ({', '.join(speeds)},), ({', '.join(angles)},)\n")
    return "\n".join(lines)


def _least_squares_text(geometry: BaseGeometry) -> str:
    count = range(len(geometry.wheels))
    holding = [(i, w) for i, w in enumerate(geometry.wheels) if not w.swivel]
    n = len(holding)
    xm, ym = sum(w.x for _, w in holding) / n, sum(w.y for _, w in holding) / n
    size = sum((w.x - xm) ** 2 + (w.y - ym) ** 2 for _, w in holding)
    lever = 1.0 / size if size > 1e-12 else 0.0
    lines = [
        "def least_squares(speeds, angles):",
        f"    {', '.join(f'v{i}' for i in count)}, = speeds",
        f"    {', '.join(f'a{i}' for i in count)}, = angles",
    ]
    for i, w in holding:
        c, s = repr(math.cos(w.heading)), repr(math.sin(w.heading))
        if w.steered:
            lines.append(f"    a{i} = {scaled((w.heading, w.sign), ('1.0', f'a{i}'))}")
            c, s = f"cos(a{i})", f"sin(a{i})"
        lines += [
            f"    v{i} = {w.radius!r} * v{i}",
            f"    x{i} = v{i} * {c}",
            f"    y{i} = v{i} * {s}",
        ]
    turns = [((w.x - xm) * lever, f"y{i}") for i, w in holding]
    turns += [((ym - w.y) * lever, f"x{i}") for i, w in holding]
    lines += [
        f"    wz = {scaled([f for f, _ in turns], [t for _, t in turns])}",
        f"    x = ({' + '.join(f'x{i}' for i, _ in holding)}) * {1.0 / n!r}",
        f"    y = ({' + '.join(f'y{i}' for i, _ in holding)}) * {1.0 / n!r}",
        f"    return {scaled((1.0, ym), ('x', 'wz'))}, {scaled((1.0, -xm), ('y', 'wz'))}, wz\n",
    ]
    return "\n".join(lines)
