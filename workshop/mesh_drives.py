"""Meshes of drive, steering and suspension modules and of casters."""

from __future__ import annotations

import math

from mesh_solids import (
    ALONG_Y,
    Meshes,
    Solid,
    along_x,
    along_y,
    around,
    block,
    bolt,
    coil,
    cylinder,
    extrude,
    join,
    rectangle,
    revolve,
)
from mesh_wheels import passive_wheel


def finned_motor(radius: float, length: float, fins: int) -> Solid:
    """Returns a motor along z, with the gear side at z = 0, cooling fins and a cable gland."""
    outline = []
    inner = radius * 0.86
    for i in range(fins):
        for offset, r in ((-0.30, inner), (-0.22, radius), (0.22, radius), (0.30, inner)):
            angle = 2 * math.pi * (i + offset) / fins
            outline.append((r * math.cos(angle), r * math.sin(angle)))
    body = extrude(outline, 0.16 * length, 0.80 * length)
    front = cylinder(radius * 1.02, 0.16 * length, 28, 0.003).moved(z=0.08 * length)
    back = revolve(
        [
            (radius * 0.98, 0.80 * length),
            (radius * 0.98, 0.90 * length),
            (radius * 0.80, length),
        ],
        28,
    )
    box = block(radius * 0.9, radius * 0.5, 0.30 * length, 0.004)
    gland = along_x(cylinder(0.010, 0.030, 10))
    return join(
        [
            body,
            front,
            back,
            box.moved(y=radius * 1.05, z=0.72 * length),
            gland.moved(x=radius * 0.55, y=radius * 1.08, z=0.72 * length),
        ]
    )


def gear_housing(radius: float, length: float) -> Solid:
    """Returns a stepped round case along z, centred at the origin, with bolted covers."""
    h = length / 2
    case = revolve(
        [
            (radius * 0.80, -h),
            (radius * 0.84, -h + 0.004),
            (radius * 0.84, -h + 0.014),
            (radius, -h + 0.018),
            (radius, -h + 0.032),
            (radius * 0.92, -h + 0.036),
            (radius * 0.92, h - 0.020),
            (radius, h - 0.016),
            (radius, h - 0.004),
            (radius * 0.96, h),
        ],
        32,
    )
    ring = around(bolt(0.005, 0.005).moved(x=radius * 0.88, z=h), 8)
    return join([case, ring])


def tube_clamp(x: float, y: float, z: float) -> Solid:
    """Returns a clamp for a tube along x or y: two halves, a gap at the tube, four bolts."""
    half = block(x, y, z / 2 - 0.003, 0.010)
    shift = z / 4 + 0.0015
    parts = [half.moved(z=shift), half.moved(z=-shift)]
    for sx in (-1, 1):
        for sy in (-1, 1):
            px, py = sx * (x / 2 - 0.013), sy * (y / 2 - 0.013)
            parts.append(bolt(0.007, 0.006).moved(px, py, z / 2))
            parts.append(cylinder(0.004, 0.008, 8).moved(px, py))
    return join(parts)


def drive() -> Meshes:
    """Returns the drive.

    The module scales the column (height 1, downwards) along z, and the arm (length 1) along y.
    """
    column = extrude(rectangle(0.100, 0.050, 0.012), -1.0, 0.0)
    rib = extrude(rectangle(0.030, 0.058, 0.004), -0.93, -0.12)
    arm = extrude(rectangle(0.110, 0.034, 0.010), 0.0, 1.0).turned("x", ALONG_Y)
    arm_rib = extrude(rectangle(0.036, 0.042, 0.004), 0.12, 0.90).turned("x", ALONG_Y)
    elbow = extrude(
        [(0.030, -0.095), (0.030, 0.010), (0.018, 0.021), (-0.052, 0.021), (-0.052, -0.014)],
        -0.060,
        0.060,
        0.008,
    )
    # The outline is in (y, z), extruded along x.
    elbow = elbow.turned("x", math.pi / 2).turned("z", math.pi / 2)
    disc = join(
        [
            cylinder(0.062, 0.018, 32, 0.003),
            around(bolt(0.006, 0.005).moved(x=0.048, z=0.009), 6),
        ]
    )
    shoe = extrude(
        [(0.052, 0.06), (-0.052, 0.06)]
        + [
            (0.072 * math.cos(a), 0.072 * math.sin(a))
            for a in (math.pi + math.pi * i / 12 for i in range(13))
        ],
        -0.028,
        0.028,
        0.005,
    ).turned("x", math.pi / 2)
    hub = join(
        [
            revolve(
                [(0.050, -0.006), (0.054, -0.002), (0.054, 0.006), (0.032, 0.012), (0.026, 0.030)],
                28,
            ),
            around(bolt(0.005, 0.006).moved(x=0.042, z=0.005), 5),
        ]
    )
    return {
        "column": join([column, rib]),
        "arm": join([arm, arm_rib]),
        "elbow": elbow,
        "flange": disc,
        "shoe": shoe,
        "gear": along_y(gear_housing(0.072, 0.056)),
        "motor": along_y(finned_motor(0.052, 0.120, 20)),
        "hub": along_y(hub),
        "clamp": tube_clamp(0.10, 0.10, 0.09),
    }


def steering() -> Meshes:
    """Returns the steering module: a worm gear with its motor along y, and a flange below."""
    case = revolve(
        [
            (0.050, -0.140),
            (0.066, -0.137),
            (0.070, -0.132),
            (0.070, -0.118),
            (0.060, -0.112),
            (0.060, -0.074),
            (0.066, -0.068),
            (0.066, -0.056),
            (0.052, -0.050),
            (0.046, -0.040),
        ],
        36,
    )
    # The shaft of the worm enters here, along y.
    snout = along_y(cylinder(0.044, 0.070, 24, 0.004)).moved(y=0.052, z=-0.092)
    saddle = block(0.092, 0.092, 0.016, 0.004).moved(z=-0.050)
    rib = extrude(
        [(0.0, -0.13), (0.068, -0.125), (0.066, -0.055), (0.0, -0.05)], -0.005, 0.005
    ).turned("x", math.pi / 2)
    case_bolts = around(bolt(0.0045, 0.005).moved(x=0.0645, z=-0.118), 8, start=math.pi / 8)
    flange = join(
        [
            revolve([(0.056, -0.020), (0.060, -0.016), (0.060, -0.006), (0.048, 0.0)], 32),
            around(bolt(0.005, 0.005).turned("x", math.pi).moved(x=0.050, z=-0.016), 8),
        ]
    )
    return {
        "housing": join([case, snout, saddle, around(rib, 3, start=math.pi), case_bolts]),
        "motor": along_y(finned_motor(0.046, 0.130, 18)),
        "flange": flange,
        "clamp": tube_clamp(0.10, 0.10, 0.09),
        "bracket": join(
            [
                block(1.0, 0.080, 0.050, 0.008),
                block(1.0, 0.030, 0.070, 0.004),
            ]
        ),
    }


def suspension() -> Meshes:
    """Returns the suspension.

    Spring and damper are along z, from z = 0.  The plate is in the plane y = 0; the rails are
    on its +y side.
    """
    half = [(0.055, -0.100), (0.070, -0.085), (0.070, 0.120), (0.050, 0.185)]
    outline = half + [(-x, z) for x, z in reversed(half)]
    plate = extrude(outline, -0.008, 0.008, 0.003).turned("x", math.pi / 2)
    rail = along_x(along_x(block(0.016, 0.016, 0.250, 0.003)))
    rails = join([rail.moved(x, 0.014, 0.040) for x in (-0.050, 0.050)])
    bracket = block(0.052, 0.060, 0.016, 0.004).moved(y=0.034, z=0.172)
    wagon = block(0.030, 0.026, 0.085, 0.004)
    carriage = join(
        [
            block(0.132, 0.018, 0.110, 0.004).moved(y=0.006),
            wagon.moved(x=-0.050, y=-0.008),
            wagon.moved(x=0.050, y=-0.008),
        ]
    )
    return {
        "plate": join([plate, bracket]),
        "rails": rails,
        "clamp": tube_clamp(0.12, 0.09, 0.09),
        "carriage": carriage,
        "arm": block(0.090, 1.0, 0.070, 0.010),
        "spring": coil(0.024, 0.0042, 0.120, 6),
        "damper": join(
            [
                cylinder(0.015, 0.080, 20, 0.002).moved(z=0.085),
                cylinder(0.029, 0.008, 20, 0.002).moved(z=0.122),
            ]
        ),
        "rod": join(
            [
                cylinder(0.006, 0.110, 12).moved(z=0.055),
                cylinder(0.029, 0.008, 20, 0.002).moved(z=0.002),
                along_x(cylinder(0.011, 0.044, 14)).moved(z=-0.010),
            ]
        ),
    }


def caster(trail: bool) -> Meshes:
    """Returns a caster.

    The arm has the height 1, downwards; with ``trail`` it leans back by 1.  Its thickness is
    along y.
    """
    if trail:
        outline = [(0.35, 0.0), (0.32, -0.12), (-0.66, -0.86), (-0.72, -1.0)]
        outline += [(-1.0, -1.10), (-1.28, -1.0), (-1.25, -0.86), (-0.95, -0.25), (-0.85, 0.0)]
    else:
        outline = [(0.034, 0.0), (0.030, -0.3), (0.022, -0.95), (0.015, -1.04)]
        outline += [(-x, z) for x, z in reversed(outline)]
    arm = extrude(outline, -0.004, 0.004).turned("x", math.pi / 2)
    crown = join(
        [
            block(0.10 if trail else 0.08, 1.0, 0.014, 0.004),
        ]
    )
    head = revolve(
        [(0.030, -0.012), (0.040, -0.008), (0.040, 0.010), (0.030, 0.018), (0.030, 0.030)], 24
    )
    return {
        "arm": arm,
        "crown": crown,
        "head": head,
        "clamp": tube_clamp(0.09, 0.09, 0.08),
        **passive_wheel(),
    }
