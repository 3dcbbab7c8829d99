"""Random robots of twelve families, for the study of steering limits (``bench.following``)."""

from __future__ import annotations

import functools
import math
import random
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from bench.figure import EXAMPLE

if TYPE_CHECKING:
    from thorvaldc.model import Robot

RECTANGLE = [(0.55, 0.45), (0.55, -0.45), (-0.55, 0.45), (-0.55, -0.45)]


class Family(NamedTuple):
    """Random choices for the robots of a family.

    - ``limit``: steering limit (rad) to both sides, or ``None`` for unlimited steering.
    - ``layout``: ``car`` (steered front wheels, fixed rear wheels), ``rectangle`` (four steered
      wheels) or ``random`` (three to six steered wheels at random positions).
    - ``trail``, ``lateral``: largest offset (m) of a contact point from its steering axis.
    - ``mixed_radii``: each wheel has its own radius.
    - ``casters``: the robot also has swivelling wheels.
    """

    limit: float | None
    layout: str
    trail: float = 0.0
    lateral: float = 0.0
    mixed_radii: bool = False
    casters: bool = False


FAMILIES = {
    "car, +-35 deg": Family(math.radians(35), "car"),
    "car, +-40 deg, casters": Family(math.radians(40), "car", 0.0, 0.1, True, True),
    "car, +-60 deg, trail": Family(math.radians(60), "car", 0.12, 0.0, True),
    "rectangle, +-40 deg": Family(math.radians(40), "rectangle"),
    "rectangle, +-60 deg, offsets": Family(math.radians(60), "rectangle", 0.08, 0.12, True),
    "rectangle, +-90 deg": Family(math.radians(90), "rectangle"),
    "random, +-35 deg, offsets": Family(math.radians(35), "random", 0.08, 0.1, True),
    "random, +-90 deg, trail": Family(math.radians(90), "random", 0.1, 0.0, False, True),
    "random, +-120 deg, trail": Family(math.radians(120), "random", 0.1, 0.1, True),
    "random, +-180 deg": Family(math.radians(180), "random", 0.0, 0.1, True, True),
    "random, +-180 deg, trail": Family(math.radians(180), "random", 0.12, 0.1, True),
    "random, unlimited, trail": Family(None, "random", 0.12, 0.12, True, True),
}


class _Place(NamedTuple):
    x: float
    y: float
    kind: str


def random_robot(family: Family, rng: random.Random) -> Robot:
    """Returns a robot of ``family`` with ideal joints; only the data of its base is meaningful."""
    return _robot(_places(family, rng), family, rng)


def _places(family: Family, rng: random.Random) -> list[_Place]:
    length, width = rng.uniform(0.3, 1.2), rng.uniform(0.3, 0.9)
    if family.layout == "car":
        # The fixed axle is not always at the same distance behind base_link.
        rear = -length + rng.choice([0.0, rng.uniform(-0.2, 0.2)])
        places = [_Place(length, y, "steered") for y in (width, -width)]
        places += [_Place(rear, y, rng.choice(["fixed", "passive"])) for y in (width, -width)]
    elif family.layout == "rectangle":
        places = [
            _Place(length * (x > 0 or -1), width * (y > 0 or -1), "steered") for x, y in RECTANGLE
        ]
    else:
        places = []
        while len(places) < rng.randint(3, 6):
            x, y = rng.uniform(-1.2, 1.2), rng.uniform(-1.0, 1.0)
            if all(math.hypot(x - p.x, y - p.y) > 0.3 for p in places):
                places.append(
                    _Place(
                        x, y, "steered" if len(places) < 3 else rng.choice(["steered", "turned"])
                    )
                )
    if family.casters:
        places += [_Place(rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0), "swivel")]
    return places


@functools.cache
def _template() -> Robot:
    from thorvaldc.compiler.pipeline import compile_file
    from thorvaldc.model import Robot

    model = compile_file(EXAMPLE).model
    assert isinstance(model, Robot)
    return model


def _robot(places: list[_Place], family: Family, rng: random.Random) -> Robot:
    template = _template()
    example_wheel = template.wheels[0]
    assert example_wheel.steering_joint is not None
    spin = template.actuator_of(example_wheel.spin_joint)
    steering = template.actuator_of(example_wheel.steering_joint)
    assert spin is not None
    assert steering is not None
    spin_joint = template.joint(example_wheel.spin_joint)
    steering_joint = replace(
        template.joint(example_wheel.steering_joint),
        lower=None if family.limit is None else -family.limit,
        upper=family.limit,
    )
    wheels, joints, actuators = [], [], []
    for i, place in enumerate(places):
        turns = place.kind in ("steered", "turned")
        driven = place.kind in ("steered", "fixed")
        offsets = (
            rng.uniform(-family.trail, family.trail),
            rng.uniform(-family.lateral, family.lateral),
        )
        wheels.append(
            replace(
                example_wheel,
                name=f"w{i}",
                spin_joint=f"w{i}_spin",
                steering_joint=f"w{i}_steering" if turns else None,
                swivel_joint=f"w{i}_swivel" if place.kind == "swivel" else None,
                driven=driven,
                x=place.x,
                y=place.y,
                heading=0.0,
                steering_sign=rng.choice([1.0, -1.0]) if turns else 1.0,
                trail=offsets[0] if turns else 0.0,
                lateral_offset=offsets[1] if turns else 0.0,
                radius=rng.choice([0.1, 0.2, 0.35]) if family.mixed_radii else 0.2,
            )
        )
        joints.append(replace(spin_joint, name=f"w{i}_spin"))
        if turns:
            joints.append(replace(steering_joint, name=f"w{i}_steering"))
            actuators.append(replace(steering, name=f"w{i}_steering", joint=f"w{i}_steering"))
        if driven:
            actuators.append(replace(spin, name=f"w{i}_spin", joint=f"w{i}_spin"))
    return replace(template, wheels=tuple(wheels), joints=tuple(joints), actuators=tuple(actuators))
