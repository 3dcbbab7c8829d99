"""Meshes of frames, battery enclosure and sensors."""

from __future__ import annotations

import math

import numpy as np
from mesh_drives import tube_clamp
from mesh_solids import (
    Meshes,
    Solid,
    along_x,
    block,
    bolt,
    cylinder,
    extrude,
    join,
    loft,
    revolve,
    rounded_rectangle,
    sweep,
)


def battery() -> Meshes:
    """Returns the enclosure: length 0.56 m, width 0.26 m, height 0.23 m; origin: bottom centre."""
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
    """Returns the clamps and end caps of a tube frame."""
    return {"clamp": tube_clamp(0.11, 0.10, 0.08), "end_cap": end_cap()}


def end_cap() -> Solid:
    """Returns the cap of a tube of radius 1 that ends at the origin; it points along x."""
    return along_x(revolve([(0.98, -0.10), (1.04, -0.02), (1.04, 0.10), (0.90, 0.22)], 24))


def portal() -> Meshes:
    """Returns the parts of a portal frame.

    The elbow has the bend radius 1 and the pipe radius 0.16.  It starts at the origin in
    direction z and ends at (1, 0, 1) in direction x.
    """
    angles = np.linspace(0.0, math.pi / 2, 9)
    path = np.column_stack([1.0 - np.cos(angles), np.zeros(9), np.sin(angles)])
    gusset = extrude(
        [(0.0, 0.0), (0.13, 0.0), (0.13, 0.02), (0.02, 0.13), (0.0, 0.13)], -0.003, 0.003
    )
    return {
        "elbow": sweep(path, 0.16, 16),
        "gusset": gusset.turned("x", math.pi / 2),
        "end_cap": end_cap(),
    }


def sheet_metal() -> Meshes:
    """Returns the body: length 1.0 m, width 0.36 m, height 0.24 m; origin: bottom centre."""
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
        for x in (-0.28, 0.03)
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


def sensor_hood() -> Meshes:
    """Returns a hood that is open below, centred at the origin, with eyes for its two rods."""
    outer = rounded_rectangle(0.30, 0.44, 0.03, 4)
    inner = rounded_rectangle(0.27, 0.41, 0.02, 4)
    top = rounded_rectangle(0.22, 0.36, 0.03, 4)
    rings = [
        (inner, 0.05),
        (inner, -0.12),
        (outer, -0.12),
        (outer, 0.07),
        (top, 0.12),
    ]
    shell = loft([np.array([(x, y, z) for x, y in outline]) for outline, z in rings])
    eye = cylinder(0.022, 0.03, 20, 0.004)
    lamp = revolve([(0.045, 0.03), (0.05, 0.0), (0.062, -0.02), (0.062, -0.03)], 28)
    return {
        "hood": join([shell, *(eye.moved(y=y, z=0.125) for y in (-0.16, 0.16))]),
        "lamp": lamp,
    }


def lidar() -> Meshes:
    """Returns a scanner whose laser plane is in the window, 0.085 m over the foot."""
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
    """Returns an antenna with a foot at z = 0 and a neck for a mast below."""
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
    """Returns a box on a base plate, with a plug and marks of the x and y axes."""
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
    """Returns a stereo camera on a stem; the lenses point along x."""
    body = extrude(rounded_rectangle(0.092, 0.026, 0.012, 4), -0.013, 0.013, 0.002)
    # The outline is in (y, z), extruded along x.
    body = body.turned("x", math.pi / 2).turned("z", math.pi / 2)
    lens = along_x(join([cylinder(0.009, 0.006, 20), cylinder(0.005, 0.008, 14)]))
    small = along_x(cylinder(0.005, 0.006, 14))
    stem = join(
        [
            cylinder(0.005, 0.030, 12).moved(z=-0.026),
            cylinder(0.014, 0.008, 20, 0.002).moved(z=-0.042),
        ]
    )
    return {
        "body": body,
        "stem": stem,
        "lens": join(
            [lens.moved(x=0.014), small.moved(x=0.014, y=0.032), small.moved(x=0.014, y=-0.032)]
        ),
    }
