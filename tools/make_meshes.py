"""Writes the library's meshes: ``python tools/make_meshes.py [--check]``.

Each module's meshes go to ``modules/<type>/meshes/``.  ``--check`` writes nothing
and exits with 1 where a file differs from what would be written.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mesh_solids import (
    Solid,
    around,
    block,
    bolt,
    coil,
    cylinder,
    extrude,
    join,
    loft,
    rectangle,
    revolve,
    rounded_rectangle,
    sweep,
    to_stl,
)

MODULES = Path(__file__).resolve().parent.parent / "modules"
Meshes = dict[str, Solid]

ALONG_Y = -math.pi / 2  # turns z onto y, about x


def along_y(solid: Solid) -> Solid:
    return solid.turned("x", ALONG_Y)


def along_x(solid: Solid) -> Solid:
    return solid.turned("y", math.pi / 2)


# -- wheels: radius 1 and width 1, about y ------------------------------------------


def agricultural_tyre(lugs: int) -> Solid:
    """A carcass with chevron lugs, alternately to the left and the right."""
    carcass = revolve(
        [
            (0.52, -0.40),
            (0.60, -0.47),
            (0.76, -0.50),
            (0.87, -0.44),
            (0.915, -0.25),
            (0.925, 0.0),
            (0.915, 0.25),
            (0.87, 0.44),
            (0.76, 0.50),
            (0.60, 0.47),
            (0.52, 0.40),
        ],
        40,
        closed=True,
    )
    return join(
        [
            along_y(carcass),
            around(_lug(1.0), lugs, "y"),
            around(_lug(-1.0), lugs, "y", math.pi / lugs),
        ]
    )


def _lug(side: float) -> Solid:
    """A bar from the middle of the tread to its shoulder, swept back."""
    rings = []
    #        across, sweep, inner radius, outer radius, half width at the foot and at the top
    for across, angle, inner, outer, foot, top in (
        (-0.06, 0.00, 0.90, 1.000, 0.060, 0.040),
        (0.14, 0.12, 0.90, 1.000, 0.062, 0.042),
        (0.32, 0.24, 0.87, 0.985, 0.068, 0.048),
        (0.47, 0.33, 0.82, 0.955, 0.075, 0.056),
        (0.50, 0.36, 0.74, 0.860, 0.070, 0.056),
    ):
        ring = [
            (r * math.sin(angle + d), side * across, r * math.cos(angle + d))
            for r, d in ((inner, -foot), (outer, -top), (outer, top), (inner, foot))
        ]
        rings.append(np.array(ring))
    return loft(rings)


def ribbed_tyre() -> Solid:
    """A passive wheel's tyre: three ribs around, no lugs."""
    return along_y(
        revolve(
            [
                (0.58, -0.38),
                (0.70, -0.48),
                (0.88, -0.46),
                (0.97, -0.34),
                (0.98, -0.16),
                (0.955, -0.13),
                (0.955, -0.11),
                (1.0, -0.08),
                (1.0, 0.08),
                (0.955, 0.11),
                (0.955, 0.13),
                (0.98, 0.16),
                (0.97, 0.34),
                (0.88, 0.46),
                (0.70, 0.48),
                (0.58, 0.38),
            ],
            40,
            closed=True,
        )
    )


def rim(seat: float, spokes: int) -> Solid:
    """Barrel, spokes and centre, with a valve; ``seat`` is the radius of the tyre's bead."""
    barrel = revolve(
        [
            (seat + 0.05, -0.42),
            (seat + 0.05, -0.38),
            (seat + 0.005, -0.33),
            (seat + 0.005, 0.33),
            (seat + 0.05, 0.38),
            (seat + 0.05, 0.42),
            (seat - 0.01, 0.42),
            (seat - 0.05, 0.30),
            (seat - 0.05, -0.30),
            (seat - 0.01, -0.42),
        ],
        36,
        closed=True,
    )
    spoke = extrude(
        [(0.11, 0.10), (-0.11, 0.10), (-0.075, seat - 0.02), (0.075, seat - 0.02)],
        -0.17,
        0.17,
        0.03,
    )
    centre = revolve([(0.20, -0.25), (0.23, -0.22), (0.23, 0.22), (0.20, 0.25)], 24)
    valve = cylinder(0.015, 0.12, 6).turned("y", math.pi / 2).moved(x=seat - 0.09, z=0.26)
    return along_y(join([barrel, around(spoke, spokes), centre, valve]))


def wheel_bolts(circle: float, count: int) -> Solid:
    """Bolts and a cap on both faces of the rim's centre."""
    one = bolt(0.026, 0.06).moved(x=circle, z=0.24)
    cap = cylinder(0.07, 0.60, 16, 0.015)
    face = around(one, count)
    return along_y(join([face, face.turned("x", math.pi), cap]))


def passive_wheel() -> Meshes:
    return {"tyre": ribbed_tyre(), "rim": rim(0.56, 4), "bolts": wheel_bolts(0.15, 4)}


def greenhouse_wheel() -> Meshes:
    """The floor's tyre; the rail's wheel is a spool with flanges of 1.3 times its radius."""
    tyre = along_y(
        revolve(
            [
                (0.70, -0.46),
                (0.93, -0.48),
                (0.99, -0.36),
                (1.0, 0.0),
                (0.99, 0.36),
                (0.93, 0.48),
                (0.70, 0.46),
            ],
            44,
            closed=True,
        )
    )
    disc = revolve(
        [(0.72, -0.40), (0.66, -0.40), (0.60, -0.16), (0.60, 0.16), (0.66, 0.40), (0.72, 0.40)], 36
    )
    holes = around(cylinder(0.10, 0.34, 12).moved(x=0.42), 6)
    spool = revolve(
        [
            (1.22, -0.50),
            (1.26, -0.47),
            (1.26, -0.43),
            (1.02, -0.30),
            (1.0, 0.0),
            (1.02, 0.30),
            (1.26, 0.43),
            (1.26, 0.47),
            (1.22, 0.50),
        ],
        40,
    )
    face = around(bolt(0.09, 0.06).moved(x=0.62, z=0.49), 5)
    bolts = join([face, face.turned("x", math.pi), cylinder(0.28, 1.12, 16, 0.03)])
    return {
        "floor_tyre": tyre,
        "floor_disc": along_y(disc),
        "floor_marks": along_y(holes),
        "rail_wheel": along_y(spool),
        "rail_bolts": along_y(bolts),
    }


# -- motors and gears -----------------------------------------------------------------


def finned_motor(radius: float, length: float, fins: int) -> Solid:
    """A motor along z, its gear side at z = 0, with cooling fins and a cable gland."""
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
    """A stepped round case along z, centred, with bolted covers."""
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
    """Two halves with a gap at the tube's middle and four bolts; for tubes along x or y."""
    half = block(x, y, z / 2 - 0.003, 0.010)
    shift = z / 4 + 0.0015
    parts = [half.moved(z=shift), half.moved(z=-shift)]
    for sx in (-1, 1):
        for sy in (-1, 1):
            px, py = sx * (x / 2 - 0.013), sy * (y / 2 - 0.013)
            parts.append(bolt(0.007, 0.006).moved(px, py, z / 2))
            parts.append(cylinder(0.004, 0.008, 8).moved(px, py))
    return join(parts)


# -- modules --------------------------------------------------------------------------


def drive() -> Meshes:
    """Column: height 1 downwards, scaled along z.  Arm: length 1 along y, scaled."""
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
    # Outline in (y, z); extruded along x.
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
    # Where the worm's shaft enters, along y.
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
    """Spring and damper stand along z from 0; the plate lies in y = 0, the carriage reaches to y = 0."""
    outline = [
        (0.070, -0.085), (0.070, 0.120), (0.050, 0.185), (-0.050, 0.185), (-0.070, 0.120), (-0.070, -0.085),
        (-0.055, -0.100), (0.055, -0.100),
    ]  # fmt: skip
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
    """Arm: height 1 downwards; with a trail it leans back by 1; thickness along y."""
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
    made = {
        "arm": arm,
        "crown": crown,
        "head": head,
        "clamp": tube_clamp(0.09, 0.09, 0.08),
        **passive_wheel(),
    }
    return made


def battery() -> Meshes:
    """Length 0.56, width 0.26, height 0.23; the bottom's middle is the origin."""
    length, width, height = 0.56, 0.26, 0.23
    seam = 0.175
    box = extrude(rounded_rectangle(length - 0.012, width - 0.012, 0.030, 4), 0.0, seam, 0.008)
    ribs = [
        block(0.022, width, 0.115, 0.004).moved(x=x, z=0.080)
        for x in (-0.225, -0.150, 0.150, 0.225)
    ]
    ribs += [block(length, 0.020, 0.115, 0.004).moved(y=y, z=0.080) for y in (-0.075, 0.075)]
    rings = [
        (0.000, seam - 0.004, 0.030),
        (0.000, seam + 0.022, 0.030),
        (0.014, seam + 0.040, 0.030),
        (0.030, height - 0.006, 0.026),
        (0.040, height, 0.022),
    ]
    lid = loft(
        [
            np.array(
                [
                    (x, y, z)
                    for x, y in rounded_rectangle(length - 2 * inset, width - 2 * inset, radius, 4)
                ]
            )
            for inset, z, radius in rings
        ]
    )
    panel = extrude(rounded_rectangle(0.30, 0.12, 0.02, 3), height - 0.002, height + 0.004, 0.002)
    latch = join(
        [
            block(0.036, 0.010, 0.052, 0.003).moved(z=seam - 0.010),
            block(0.044, 0.014, 0.014, 0.003).moved(z=seam + 0.012),
        ]
    )
    latches = join([latch.moved(x, y) for x in (-0.19, 0.19) for y in (-width / 2, width / 2)])
    bow = np.array(
        [
            (0.0, -0.062, 0.0),
            (0.022, -0.060, 0.0),
            (0.034, -0.048, 0.0),
            (0.036, 0.0, 0.0),
            (0.034, 0.048, 0.0),
            (0.022, 0.060, 0.0),
            (0.0, 0.062, 0.0),
        ]
    )
    handle = sweep(bow, 0.008, 8).moved(x=length / 2 - 0.008, z=0.115)
    sockets = [
        along_x(cylinder(0.016, 0.024, 16, 0.003)).moved(x=length / 2, y=y, z=0.045)
        for y in (-0.055, 0.0, 0.055)
    ]
    return {
        "box": join([box, *ribs]),
        "lid": join([lid, panel]),
        "latches": latches,
        "handles": join([handle, handle.turned("z", math.pi), *sockets]),
        "clamp": tube_clamp(0.080, 0.080, 0.080),
        "bracket": join(
            [
                block(0.070, 0.200, 0.012, 0.003).moved(z=-0.006),
                block(0.050, 0.066, 0.040, 0.003).moved(z=-0.026),
            ]
        ),
        "stop_base": cylinder(0.030, 0.036, 8, 0.004).moved(z=0.018),
        "stop_button": revolve(
            [(0.014, 0.030), (0.014, 0.046), (0.024, 0.050), (0.024, 0.058), (0.018, 0.064)], 20
        ),
    }


def frame_clamps() -> Meshes:
    return {"clamp": tube_clamp(0.11, 0.10, 0.08), "end_cap": _end_cap()}


def _end_cap() -> Solid:
    """For a tube of radius 1, at the origin, outwards along x."""
    return along_x(revolve([(0.98, -0.10), (1.04, -0.02), (1.04, 0.10), (0.90, 0.22)], 24))


def portal() -> Meshes:
    """Elbow: a quarter bend of radius 1 from (0, 0, 0) upwards to (1, 0, 1) forwards; pipe of 0.16."""
    angles = np.linspace(0.0, math.pi / 2, 9)
    path = np.column_stack([1.0 - np.cos(angles), np.zeros(9), np.sin(angles)])
    gusset = extrude(
        [(0.0, 0.0), (0.13, 0.0), (0.13, 0.02), (0.02, 0.13), (0.0, 0.13)], -0.003, 0.003
    )
    return {
        "elbow": sweep(path, 0.16, 16),
        "gusset": gusset.turned("x", math.pi / 2),
        "end_cap": _end_cap(),
        "plate": join(
            [
                block(0.09, 0.09, 0.010, 0.003),
                around(bolt(0.006, 0.006).moved(x=0.045, z=0.005), 4, start=math.pi / 4),
            ]
        ),
    }


def sheet_metal() -> Meshes:
    """Length 1.0, width 0.36, height 0.24; the bottom's middle is the origin."""
    length, width, height = 1.0, 0.36, 0.24

    def ring(z: float, front: float, rear: float, side: float, radius: float) -> np.ndarray:
        x0, x1 = -length / 2 + rear, length / 2 - front
        flat = rounded_rectangle(x1 - x0, width - 2 * side, radius, 4)
        return np.array([(x + (x0 + x1) / 2, y, z) for x, y in flat])

    body = loft(
        [
            ring(0.0, 0.05, 0.03, 0.012, 0.030),
            ring(0.012, 0.03, 0.012, 0.0, 0.030),
            ring(0.135, 0.0, 0.0, 0.0, 0.030),
            ring(0.150, 0.0, 0.0, 0.0, 0.030),
            ring(0.215, 0.065, 0.012, 0.004, 0.030),
            ring(0.233, 0.085, 0.02, 0.010, 0.028),
            ring(height, 0.105, 0.03, 0.022, 0.022),
        ]
    )
    skirt = extrude(rounded_rectangle(length + 0.006, width + 0.006, 0.032, 4), 0.136, 0.149, 0.003)
    deck = extrude(rounded_rectangle(0.62, 0.27, 0.03, 4), height - 0.002, height + 0.012, 0.004)
    slots = [
        block(0.006, 0.24, 0.007, 0.0).moved(x=length / 2, z=z) for z in (0.05, 0.068, 0.086, 0.104)
    ]
    side_panels = [
        block(0.30, 0.006, 0.085, 0.002).moved(x=x, y=y, z=0.075)
        for x in (-0.28, 0.02)
        for y in (-width / 2, width / 2)
    ]
    screws = [
        bolt(0.006, 0.005).moved(sx * 0.285, sy * 0.11, height + 0.012)
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    lamp = along_x(cylinder(0.022, 0.012, 20, 0.003))
    return {
        "body": body,
        "trim": join([skirt, *slots, *side_panels]),
        "deck": join([deck, *screws]),
        "lamps": join([lamp.moved(length / 2 - 0.030, y, 0.180).moved() for y in (-0.13, 0.13)]),
    }


def lidar() -> Meshes:
    base = join(
        [
            extrude(rounded_rectangle(0.100, 0.100, 0.018, 3), 0.0, 0.050, 0.004),
            along_x(cylinder(0.010, 0.030, 12)).moved(x=-0.055, z=0.020),
            block(0.050, 0.070, 0.030, 0.004).moved(z=-0.005),
        ]
    )
    head = join(
        [
            cylinder(0.046, 0.012, 32, 0.003).moved(z=0.114),
            cylinder(0.046, 0.014, 32, 0.002).moved(z=0.056),
        ]
    )
    return {"base": join([base, head]), "window": cylinder(0.042, 0.046, 32).moved(z=0.085)}


def gnss() -> Meshes:
    dome = revolve(
        [
            (0.060, 0.0),
            (0.074, 0.004),
            (0.076, 0.016),
            (0.074, 0.026),
            (0.064, 0.042),
            (0.044, 0.054),
            (0.018, 0.060),
        ],
        32,
    )
    foot = join(
        [
            cylinder(0.030, 0.010, 24, 0.002).moved(z=0.005),
            cylinder(0.017, 0.030, 16).moved(z=0.018),
        ]
    )
    return {"dome": dome, "foot": foot, "neck": cylinder(0.016, 0.030, 16, 0.002).moved(z=-0.012)}


def imu() -> Meshes:
    box = join(
        [
            block(0.046, 0.058, 0.022, 0.003).moved(z=0.013),
            block(0.062, 0.040, 0.005, 0.001).moved(z=0.0025),
        ]
    )
    plug = join(
        [
            along_x(cylinder(0.006, 0.012, 12)).moved(x=-0.028, z=0.013),
            block(0.012, 0.002, 0.001).moved(x=0.008, z=0.0245),
            block(0.002, 0.012, 0.001).moved(x=0.003, y=0.006, z=0.0245),
        ]
    )
    return {"box": box, "plug": plug}


def camera() -> Meshes:
    body = extrude(rounded_rectangle(0.092, 0.026, 0.012, 4), -0.013, 0.013, 0.002)
    # Outline in (y, z); along x.
    body = body.turned("x", math.pi / 2).turned("z", math.pi / 2)
    lens = along_x(join([cylinder(0.009, 0.006, 20), cylinder(0.005, 0.008, 14)]))
    small = along_x(cylinder(0.005, 0.006, 14))
    return {
        "body": body,
        "lens": join(
            [lens.moved(x=0.014), small.moved(x=0.014, y=0.032), small.moved(x=0.014, y=-0.032)]
        ),
    }


LIBRARY: dict[str, Callable[[], Meshes]] = {
    "wheel/agri_200": lambda: {
        "tyre": agricultural_tyre(14),
        "rim": rim(0.52, 6),
        "bolts": wheel_bolts(0.155, 6),
    },
    "wheel/greenhouse_double": greenhouse_wheel,
    "wheel/passive": passive_wheel,
    "drive/standard": drive,
    "steering/standard": steering,
    "suspension/standard": suspension,
    "caster/swivel": lambda: caster(True),
    "caster/fixed": lambda: caster(False),
    "battery/enclosure": battery,
    "frame/tube_rectangular": frame_clamps,
    "frame/tube": lambda: {"end_cap": _end_cap()},
    "frame/corner": lambda: {"clamp": tube_clamp(0.1, 0.1, 0.08).scaled(10.0, 10.0, 10.0)},
    "frame/portal": portal,
    "frame/sheet_metal": sheet_metal,
    "sensor/lidar_2d": lidar,
    "sensor/gnss_antenna": gnss,
    "sensor/imu": imu,
    "sensor/camera": camera,
}


def make_all() -> dict[str, bytes]:
    """Every mesh file by its path under ``modules/``."""
    return {
        f"{module}/meshes/{name}.stl": to_stl(solid)
        for module, make in LIBRARY.items()
        for name, solid in make().items()
    }


def main(arguments: list[str]) -> int:
    """Write the meshes, or compare them with what is there."""
    stale = 0
    for path, data in make_all().items():
        file = MODULES / path
        if file.is_file() and file.read_bytes() == data:
            continue
        stale += 1
        print(path, len(data))
        if "--check" not in arguments:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
    return 1 if stale and "--check" in arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
