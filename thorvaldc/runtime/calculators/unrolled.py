"""The estimate of one robot as straight-line code, for ticks in which no wheel is suspected.

Loops over wheels, tuples per wheel and what is the same in every tick take Python
nearly half the time of an estimate.  Here the loops of ``TwistEstimator`` and
``fit`` are written out with the robot's numbers in them, each operation as
there and in the same order: the results are equal to the last bit.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from thorvaldc.runtime.calculators.twist_fit import STILL, UNTESTABLE, Squares
from thorvaldc.runtime.se2 import Twist

Estimate = Callable[[Sequence[float], Sequence[float]], Any]
"""From the speeds and angles of all wheels to a ``TwistEstimate``; ``None`` where the estimate
needs a closer look."""


class UnrolledWheel(NamedTuple):
    """A wheel with an encoder: its contact (m, from the centre) does not depend on its angle.

    ``place``: its number among the robot's wheels; ``gate``: the chi-square beyond which
    it is suspected.
    """

    place: int
    heading: float
    sign: float
    cos: float
    sin: float
    x: float
    y: float
    radius: float
    turns: bool
    gate: float


_JOINTS = (("v", "speeds"), ("a", "angles"))
_TURNED = """\
    direction = {direction}
    c{i} = cos(direction)
    s{i} = sin(direction)
"""
_FIXED = """\
    c{i} = {cos}
    s{i} = {sin}
"""
_READING = """\
    z{i} = {radius} * v{place}
    zx{i} = c{i} * z{i}
    zy{i} = s{i} * z{i}
"""
_FIRST = """\
    b1 = {zx}
    b2 = {zy}
    b3 = {turn}
    vx = {vx}
    vy = {vy}
    wz = {wz}
"""
_VARIANCES = """\
    c = c{i}
    s = s{i}
    ux = vx - wz * {y}
    uy = vy + wz * {x}
    a2 = ux * ux + uy * uy
    v_l = {ratio2} * a2 + {floor2}
    v_t = {angle2} * a2 + {slip2}
"""
_ARC = """\
    across = c * uy - s * ux
    t2 = across * across
    if t2 < 0.25 * a2 - {still}:
        k = sqrt(a2) if c * ux + s * uy > 0.0 else -sqrt(a2)
        c = ux / k
        s = uy / k
        z_t = -(across * (1.0 + t2 / (6.0 * a2)))
        mx{i} = c * z{i} - s * z_t
        my{i} = s * z{i} + c * z_t
    else:
        mx{i} = c * z{i}
        my{i} = s * z{i}
"""
_STRAIGHT = """\
    mx{i} = zx{i}
    my{i} = zy{i}
"""
_INFORMATION = """\
    w_t = 1.0 / v_t
    k = 1.0 / v_l - w_t
    kc = k * c
    w11_{i} = w_t + kc * c
    w12_{i} = kc * s
    w22_{i} = w_t + k * s * s
    tx{i} = w12_{i} * {x} - w11_{i} * {y}
    ty{i} = w22_{i} * {x} - w12_{i} * {y}
    gx{i} = w11_{i} * mx{i} + w12_{i} * my{i}
    gy{i} = w12_{i} * mx{i} + w22_{i} * my{i}
    least{i} = {untestable} * v_l * v_t
    k = v_l - v_t
    kc = k * c
    v11_{i} = v_t + kc * c
    v12_{i} = kc * s
    v22_{i} = v_t + k * s * s
"""
_SOLUTION = """\
    a11 = {w11}
    a12 = {w12}
    a13 = {tx}
    a22 = {w22}
    a23 = {ty}
    a33 = {lever}
    b1 = {gx}
    b2 = {gy}
    b3 = {torque}
    p11 = a22 * a33 - a23 * a23
    p12 = a13 * a23 - a12 * a33
    p13 = a12 * a23 - a13 * a22
    d = 1.0 / (a11 * p11 + a12 * p12 + a13 * p13)
    p11 = p11 * d
    p12 = p12 * d
    p13 = p13 * d
    p22 = (a11 * a33 - a13 * a13) * d
    p23 = (a12 * a13 - a11 * a23) * d
    p33 = (a11 * a22 - a12 * a12) * d
    vx = p11 * b1 + p12 * b2 + p13 * b3
    vy = p12 * b1 + p22 * b2 + p23 * b3
    wz = p13 * b1 + p23 * b2 + p33 * b3
"""
_TEST = """\
    s11 = v11_{i} - p11 - {y} * ({y} * p33 - 2.0 * p13)
    s12 = v12_{i} - p12 - {x} * p13 + {y} * (p23 + {x} * p33)
    s22 = v22_{i} - p22 - {x} * ({x} * p33 + 2.0 * p23)
    det = s11 * s22 - s12 * s12
    if not det > least{i}:
        return None
    rx = mx{i} - vx + wz * {y}
    ry = my{i} - vy - wz * {x}
    d{i} = ((s22 * rx - 2.0 * s12 * ry) * rx + s11 * ry * ry) / det
    if not d{i} <= {gate}:
        return None
"""
_RETURN = """\
    vx = vx + {ym} * wz
    vy = vy - {xm} * wz
    p11, p12, p22 = (
        p11 + 2.0 * {ym} * p13 + {ym} * {ym} * p33,
        p12 + {ym} * p23 - {xm} * p13 - {xm} * {ym} * p33,
        p22 - 2.0 * {xm} * p23 + {xm} * {xm} * p33,
    )
    p13 = p13 + {ym} * p33
    p23 = p23 - {xm} * p33
"""
_RESULT = """\
    return new(
        Result,
        (
            new(Twist, (vx, vy, wz)),
            ((p11, p12, p13), (p12, p22, p23), (p13, p23, p33)),
            3,
            ({tests},),
            (),
        ),
    )
"""


@functools.lru_cache(maxsize=64)  # a hundred copies would not stay in a processor's cache
def unrolled(
    wheels: tuple[UnrolledWheel, ...],
    count: int,
    inverse: tuple[float, ...],
    centre: tuple[float, float],
    noise: Squares,
    result: type,
) -> Estimate:
    """The estimate for these wheels of a robot of ``count`` (the others swivel).

    ``inverse``: the upper half of the inverse of the normal matrix with equal
    weights, about ``centre``; ``result`` is the class ``TwistEstimate``.
    """
    ratio2, angle2, floor2, slip2, _, _ = noise
    places: dict[str, Any] = {
        "ratio2": ratio2, "angle2": angle2, "floor2": floor2, "slip2": slip2,
        "still": STILL, "untestable": UNTESTABLE, "xm": centre[0], "ym": centre[1],
    }  # fmt: skip
    q11, q12, q13, q22, q23, q33 = inverse
    rows = {"vx": (q11, q12, q13), "vy": (q12, q22, q23), "wz": (q13, q23, q33)}
    places |= {name: scaled(row, ("b1", "b2", "b3")) for name, row in rows.items()}
    n = range(len(wheels))
    # Repeated by `_sum` for every wheel.
    sums = {
        "zx": "zx{i}", "zy": "zy{i}", "turn": "(zy{i} * {x} - zx{i} * {y})",
        "w11": "w11_{i}", "w12": "w12_{i}", "w22": "w22_{i}", "tx": "tx{i}", "ty": "ty{i}",
        "lever": "(ty{i} * {x} - tx{i} * {y})", "gx": "gx{i}", "gy": "gy{i}",
        "torque": "(gy{i} * {x} - gx{i} * {y})",
    }  # fmt: skip
    of = [
        {
            **places,
            **w._asdict(),
            "i": i,
            "direction": scaled((w.heading, w.sign), ("1.0", f"a{w.place}")),
        }
        for i, w in enumerate(wheels)
    ]
    whole = {**places, **{name: _sum(text, of) for name, text in sums.items()}}
    text = ["def estimate(speeds, angles):\n"]
    text += [f"    {', '.join(f'{a}{i}' for i in range(count))}, = {b}\n" for a, b in _JOINTS]
    for i in n:
        text.append(_fill(_TURNED if wheels[i].turns else _FIXED, of[i]))
        text.append(_fill(_READING, of[i]))
    text.append(_fill(_FIRST, whole))
    for i in n:
        text += [_fill(_VARIANCES, of[i]), _fill(_ARC if wheels[i].turns else _STRAIGHT, of[i])]
        text.append(_fill(_INFORMATION, of[i]))
    text.append(_fill(_SOLUTION, whole))
    text += [_fill(_TEST, of[i]) for i in n]
    if any(centre):
        text.append(_fill(_RETURN, whole))
    tests = ["0.0"] * count
    for i in n:
        tests[wheels[i].place] = f"d{i}"
    text.append(_RESULT.format(tests=", ".join(tests)))
    made: Estimate = compiled(
        "".join(text), "estimate", new=tuple.__new__, Twist=Twist, Result=result
    )
    return made


def compiled(text: str, name: str, **names: Any) -> Any:
    """The function of that name that the text defines; it knows some of ``math`` and ``names``."""
    for known in ("atan2", "cos", "inf", "sin", "sqrt"):
        names[known] = getattr(math, known)
    exec(text, names)
    return names[name]


def _fill(text: str, values: dict[str, Any]) -> str:
    return text.format_map(
        {
            key: value if isinstance(value, str) else f"({value!r})" if value < 0 else repr(value)
            for key, value in values.items()
        }
    )


def scaled(factors: Sequence[float], terms: Sequence[str]) -> str:
    """Their sum of products, without what is zero and what is multiplied by one."""
    parts = [
        term if factor == 1.0 else repr(factor) if term == "1.0" else f"{factor!r} * {term}"
        for factor, term in zip(factors, terms, strict=True)
        if factor != 0.0
    ]
    return " + ".join(parts) or "0.0"


def _sum(text: str, of: Iterable[dict[str, Any]]) -> str:
    return " + ".join(_fill(text, values) for values in of)
