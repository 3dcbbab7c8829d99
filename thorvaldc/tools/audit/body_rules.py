"""Rules about masses, inertias, sizes and units of bodies and joints."""

from __future__ import annotations

import math
from collections.abc import Iterator

from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.plain_numbers import plain
from thorvaldc.model import Inertial
from thorvaldc.model.float_sum import float_sum
from thorvaldc.tools.audit.audit_facts import Body, Description, Evidence, SolidShape
from thorvaldc.tools.audit.mesh_sizes import MeshSizes, mesh_path, mesh_shapes

# Rounded inertias of thin bodies may break the triangle inequality a little.
TOLERANCE = 0.01
# Osmium has 22 590 kg/m^3; the air in a closed box of sheet metal makes 5 kg/m^3 possible.
MAX_DENSITY, MIN_DENSITY = 30_000.0, 1.0
MAX_LENGTH = 20.0  # m
MAX_ANGLE = 4.0 * math.pi + 0.01  # rad; larger limits of joints are probably degrees


def _bodies(evidence: Evidence) -> Iterator[tuple[Description, Body]]:
    for description in evidence.descriptions:
        for body in description.bodies.values():
            yield description, body


def _moving(description: Description) -> set[str]:
    """Returns the bodies that move against their parent and carry no fixed body with a mass."""
    moving = {
        joint.child for joint in description.joints.values() if joint.kind not in ("fixed", "free")
    }
    carrying = {
        joint.parent
        for joint in description.joints.values()
        if joint.kind == "fixed" and joint.child in description.bodies
    }
    return moving - carrying


def check_masses(evidence: Evidence, report: Report) -> None:
    """Reports masses that are negative, and moving bodies whose mass is zero."""
    for description, body in _bodies(evidence):
        if body.mass is None or body.mass_span is None:
            continue
        zero = body.mass == 0.0 and body.name in _moving(description)
        if body.mass < 0.0 or zero:
            what = "moves, but has the mass 0" if zero else f"has the mass {body.mass:g} kg"
            report.add(
                "audit-mass",
                f"body `{body.name}` {what}; simulators reject it or drop the body",
                body.mass_span,
                hint="weigh the part, or estimate: volume times density",
            )


def check_inertias(evidence: Evidence, report: Report) -> None:
    """Reports inertias that no body has, and those too large for the size of the body."""
    for description, body in _bodies(evidence):
        if body.inertia is None or body.inertia_span is None or len(body.inertia) != 6:
            continue
        xx, yy, zz, xy, xz, yz = body.inertia
        inertial = Inertial(body.mass or 0.0, (0.0, 0.0, 0.0), (xx, yy, zz, xy, xz, yz))
        low, middle, high = inertial.principal_moments()
        reason = ""
        if low < -1e-9 - TOLERANCE * abs(high):
            reason = "one is negative"
        elif high > (low + middle) * (1.0 + TOLERANCE) + 1e-12:
            reason = "one exceeds the sum of the others"
        elif high <= 0.0 and (body.mass or 0.0) > 0.0 and body.name in _moving(description):
            reason = "a moving body needs an inertia"
        if reason:
            report.add(
                "audit-inertia",
                f"body `{body.name}` has the principal moments of inertia {low:.4g}, {middle:.4g},"
                f" {high:.4g} kg m^2: {reason}",
                body.inertia_span,
                hint="compute them from the shape; for a box: ixx = m (y^2 + z^2) / 12",
            )
            continue
        reach = _reach(body)
        if body.mass and body.mass > 0.0 and reach is not None and high > body.mass * reach**2:
            report.add(
                "audit-inertia-size",
                f"body `{body.name}` has a moment of inertia of {high:.4g} kg m^2, but its"
                f" {body.mass:g} kg within {plain(reach, 3)} m can have at most"
                f" {body.mass * reach**2:.4g} kg m^2",
                body.inertia_span,
                hint="the unit is kg m^2, about the centre of mass; kg mm^2 are 1e-6 of that",
            )


def _half_diagonal(shape: SolidShape) -> float | None:
    size = shape.size
    if shape.kind == "box":
        return math.hypot(*size) / 2.0
    if shape.kind in ("cylinder", "tyre"):
        return math.hypot(size[0], size[1] / 2.0)
    if shape.kind == "capsule":
        return size[0] + size[1] / 2.0
    if shape.kind in ("sphere", "ellipsoid"):
        return max(size)
    return None


def _reach(body: Body) -> float | None:
    """Returns an upper limit of the distance of two points of a body in m, if it is known."""
    reaches: list[float] = []
    for shape in body.shapes:
        half = _half_diagonal(shape)
        if half is None:
            return None
        reaches.append(half + math.hypot(*shape.pose.xyz))
    return 2.0 * max(reaches) if reaches else None


def _volume(shape: SolidShape) -> float | None:
    size = shape.size
    if shape.kind == "box":
        return size[0] * size[1] * size[2]
    if shape.kind in ("cylinder", "tyre"):
        return math.pi * size[0] ** 2 * size[1]
    if shape.kind == "sphere":
        return 4.0 / 3.0 * math.pi * size[0] ** 3
    if shape.kind == "capsule":
        return math.pi * size[0] ** 2 * (size[1] + 4.0 / 3.0 * size[0])
    if shape.kind == "ellipsoid":
        return 4.0 / 3.0 * math.pi * size[0] * size[1] * size[2]
    return None


def check_densities(evidence: Evidence, report: Report) -> None:
    """Reports bodies that are denser than any metal, or lighter than air in a foil."""
    for description, body in _bodies(evidence):
        if body.mass is None or body.mass_span is None or body.mass <= 0.0:
            continue
        volumes: list[float] = []
        for collides in (True, False):
            parts = [_volume(shape) for shape in body.shapes if shape.collides is collides]
            if any(part is None for part in parts):
                volumes = []
                break
            volumes.append(float_sum(part for part in parts if part is not None))
        if not volumes or max(volumes) <= 0.0 or body.name in _carriers(description):
            continue
        density = body.mass / max(volumes)
        if density > MAX_DENSITY or density < MIN_DENSITY:
            compared = "denser than any metal" if density > MAX_DENSITY else "lighter than air"
            report.add(
                "audit-density",
                f"body `{body.name}` has {body.mass:g} kg in {max(volumes):.3g} m^3, which is"
                f" {density:.3g} kg/m^3: {compared}",
                body.mass_span,
                hint="masses are in kg and lengths in m; is one of them in g or mm?",
            )


def _carriers(description: Description) -> set[str]:
    """Returns bodies to which fixed joints attach bodies with shapes: their mass may be merged."""
    return {
        joint.parent
        for joint in description.joints.values()
        if joint.kind == "fixed"
        and joint.child in description.bodies
        and description.bodies[joint.child].shapes
    }


def check_lengths(evidence: Evidence, report: Report) -> None:
    """Reports shapes and meshes of a size that suggests millimetres, and missing mesh files."""
    for _, body in _bodies(evidence):
        for shape in body.shapes:
            if shape.kind not in ("mesh", "plane") and max(shape.size) > MAX_LENGTH:
                report.add(
                    "audit-length-unit",
                    f"a {shape.kind} of body `{body.name}` measures {plain(max(shape.size))} m",
                    shape.span,
                    hint="lengths are in m; is this one in mm?",
                )
    sizes = MeshSizes(evidence)
    for description, body, shape in mesh_shapes(evidence):
        path = mesh_path(shape.mesh, description, evidence)
        if path is None:
            continue
        box = sizes.boxes.get(path)
        if box is None:
            if not path.exists():
                report.add(
                    "audit-mesh-missing",
                    f"the mesh file `{shape.mesh}` does not exist",
                    shape.span,
                    hint="check spelling and case; paths are relative to the package",
                )
            continue
        edges = [
            abs(scale) * (high - low)
            for scale, low, high in zip(shape.size, box[0], box[1], strict=True)
        ]
        other = _size_of_others(body, shape)
        if max(edges) > MAX_LENGTH or (other is not None and max(edges) > 100.0 * other):
            scale = " with a scale of 0.001" if max(map(abs, shape.size)) > 0.1 else ""
            report.add(
                "audit-length-unit",
                f"the mesh `{shape.mesh}` of body `{body.name}` measures {plain(max(edges), 3)} m",
                shape.span,
                hint=f"is it in mm? use it{scale}" if scale else "is its scale right?",
            )
        elif max(edges) < 1e-4 and max(edges) > 0.0:
            report.add(
                "audit-length-unit",
                f"the mesh `{shape.mesh}` of body `{body.name}` measures {plain(max(edges), 3)} m",
                shape.span,
                hint="is it in m already, so that the scale 0.001 is too much?",
            )


def _size_of_others(body: Body, mesh: SolidShape) -> float | None:
    """Returns the largest half diagonal of the other shapes of a body, if it is known."""
    halves = [_half_diagonal(shape) for shape in body.shapes if shape is not mesh]
    known = [half for half in halves if half is not None and half > 0.0]
    return max(known) if known else None


def check_angles(evidence: Evidence, report: Report) -> None:
    """Reports angles of joints that suggest degrees."""
    for description in evidence.descriptions:
        for joint in description.joints.values():
            if joint.kind not in ("revolute", "hinge"):
                continue
            for name in ("lower", "upper"):
                limit = joint.limits.get(name)
                if limit is None or abs(limit.value) <= MAX_ANGLE:
                    continue
                if abs(limit.value) > 1e4:  # a way to write "no limit"
                    continue
                report.add(
                    "audit-angle-unit",
                    f"the {name} limit of joint `{joint.name}` is {limit.value:g} rad, which is"
                    f" {abs(limit.value) / (2 * math.pi):.3g} turns",
                    limit.span,
                    hint=f"is it in degrees? {limit.value:g} degrees are"
                    f" {math.radians(limit.value):.6g} rad",
                )
