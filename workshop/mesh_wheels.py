"""Meshes of wheels with radius 1 and width 1; the axis is y."""

from __future__ import annotations

import math

import numpy as np
from mesh_solids import (
    Meshes,
    Solid,
    along_y,
    around,
    bolt,
    cylinder,
    extrude,
    join,
    loft,
    revolve,
)


def agricultural_tyre(lugs: int) -> Solid:
    """Returns a carcass with chevron lugs, alternately on the left and on the right."""
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
    """Returns a bar from the middle of the tread to its shoulder, swept back."""
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
    """Returns the tyre of a passive wheel: three ribs around it, no lugs."""
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


def rim(seat: float) -> Solid:
    """Returns the barrel with a valve; ``seat`` is the radius of the tyre's bead."""
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
    valve = cylinder(0.015, 0.12, 6).turned("y", math.pi / 2).moved(x=seat - 0.09, z=0.26)
    return along_y(join([barrel, valve]))


def spokes(seat: float, count: int) -> Solid:
    """Returns the spokes and the centre, which is bolted to the hub."""
    spoke = extrude(
        [(0.11, 0.10), (-0.11, 0.10), (-0.075, seat - 0.02), (0.075, seat - 0.02)],
        -0.17,
        0.17,
        0.03,
    )
    centre = revolve([(0.20, -0.25), (0.23, -0.22), (0.23, 0.22), (0.20, 0.25)], 24)
    return along_y(join([around(spoke, count), centre]))


def wheel_bolts(circle: float, count: int) -> Solid:
    """Returns bolts and a cap on both faces of the rim's centre."""
    wheel_bolt = bolt(0.026, 0.06).moved(x=circle, z=0.24)
    cap = cylinder(0.07, 0.60, 16, 0.015)
    face = around(wheel_bolt, count)
    return along_y(join([face, face.turned("x", math.pi), cap]))


def passive_wheel() -> Meshes:
    """Returns the meshes of a wheel without a motor."""
    return {
        "tyre": ribbed_tyre(),
        "rim": rim(0.56),
        "spokes": spokes(0.56, 4),
        "bolts": wheel_bolts(0.15, 4),
    }


def greenhouse_wheel() -> Meshes:
    """Returns a wheel for floor and rails.

    The wheel for rails is a spool; its flanges have 1.26 times the rolling radius.
    """
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
