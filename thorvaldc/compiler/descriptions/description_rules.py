"""The rules about masses, inertias, sizes, units, and the sides of wheels.

``check`` judges robots and extras by them, ``audit`` the files of others.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection

from thorvaldc.compiler.descriptions.description import Description
from thorvaldc.compiler.shapes.solids import measures
from thorvaldc.diagnostics import Label, Report, Span, plain
from thorvaldc.model import Cylinder, Joint, Link, Sphere

# Rounded inertias of thin bodies may break the triangle inequality a little in files of others.
TOLERANCE = {"robot": 1e-6, "extra": 1e-6, "file": 0.01}
# Osmium has 22 590 kg/m^3; the air in a closed box of sheet metal makes 5 kg/m^3 possible.
MAX_DENSITY, MIN_DENSITY = 30_000.0, 1.0
MAX_LENGTH = 20.0  # m
MAX_ANGLE = 4.0 * math.pi + 0.01  # rad; larger limits of joints are probably degrees
NO_LIMIT = 1e4  # rad; a way to write "no limit"

# The errors have pages of their own for modules, extras and files of others.
_CODES = {
    "robot": ("inertia-impossible", "link-massless", "inertia-impossible"),
    "extra": ("extra-inertia", "extra-massless", "extra-inertia"),
    "file": ("audit-mass", "audit-mass", "audit-inertia"),
}


def check_description(
    description: Description, report: Report, of: Collection[str] | None = None
) -> None:
    """Applies all rules.

    - ``of``: names of the links that are judged, with the joints above them; ``None`` for all.
    """
    for link in description.links.values():
        if of is None or link.name in of:
            for rule in LINK_RULES:
                rule(description, link, report)
    for joint in description.joints.values():
        if of is None or joint.child in of:
            for joint_rule in JOINT_RULES:
                joint_rule(description, joint, report)


# -- links ------------------------------------------------------------------------------


def check_mass(description: Description, link: Link, report: Report) -> None:
    """Reports a negative mass, and an inertia without a mass."""
    body = link.inertial
    if body is None or body.mass > 0.0 or (body.mass == 0.0 and not any(body.inertia)):
        return
    message = f"link `{link.name}` has " + (
        f"the mass {body.mass:g} kg, which must be at least 0 kg"
        if body.mass < 0.0
        else "an inertia but no mass"
    )
    hint = "weigh the part, or estimate: volume times density"
    description.report(report, _CODES[description.origin][0], message, link, "mass", hint)


def check_inertia(description: Description, link: Link, report: Report) -> None:
    """Reports an inertia that no body has, and one that is too large for the shapes of the link.

    The principal moments of a body are positive, and none exceeds the sum of the others.
    """
    body = link.inertial
    if body is None or body.mass <= 0.0 or not any(body.inertia):
        return
    low, middle, high = body.principal_moments()
    tolerance = TOLERANCE[description.origin]
    reason = ""
    if low < -1e-12 - tolerance * abs(high):
        reason = "one is negative"
    elif high > (low + middle) * (1.0 + tolerance) + 1e-12:
        reason = "one exceeds the sum of the others"
    elif low <= 1e-9 * high and description.origin == "robot":
        reason = "one is 0"
    if reason:
        description.report(
            report,
            _CODES[description.origin][2],
            f"no body has the inertia of link `{link.name}`: of its principal moments {low:.4g},"
            f" {middle:.4g} and {high:.4g} kg m^2, {reason}",
            link,
            "inertia",
            "compute them from the shape; for a box: ixx = m (y^2 + z^2) / 12",
        )
        return
    reach = _reach(description, link)
    if reach is not None and high > body.mass * reach * reach:
        description.report(
            report,
            "inertia-too-large",
            f"link `{link.name}` has a moment of inertia of {high:.4g} kg m^2, but its"
            f" {body.mass:g} kg within {plain(reach, 3)} m can have at most"
            f" {body.mass * reach * reach:.4g} kg m^2",
            link,
            "inertia",
            "the unit is kg m^2, about the centre of mass; kg mm^2 are 1e-6 of that",
        )


def _reach(description: Description, link: Link) -> float | None:
    """Returns an upper limit of the distance of two points of a link in m, if it is known."""
    reaches: list[float] = []
    for shape, pose, _, _ in description.shapes(link):
        size = measures(shape)
        if size is None:
            return None
        reaches.append(size.half_diagonal + math.hypot(*pose.xyz))
    return 2.0 * max(reaches) if reaches else None


def check_density(description: Description, link: Link, report: Report) -> None:
    """Reports a link that is denser than any metal, or lighter than air in a foil."""
    body = link.inertial
    if body is None or body.mass <= 0.0 or _carries_shapes(description, link):
        return
    volumes = {True: 0.0, False: 0.0}
    for shape, _, collides, _ in description.shapes(link):
        size = measures(shape)
        if size is None:
            return
        volumes[collides] += size.volume
    volume = max(volumes.values())
    if volume <= 0.0:
        return
    density = body.mass / volume
    if density > MAX_DENSITY or density < MIN_DENSITY:
        compared = "denser than any metal" if density > MAX_DENSITY else "lighter than air"
        description.report(
            report,
            "density-implausible",
            f"link `{link.name}` has {body.mass:g} kg in {volume:.3g} m^3, which is {density:.3g}"
            f" kg/m^3: {compared}",
            link,
            "mass",
            "masses are in kg and lengths in m; is one of them in g or mm?",
        )


def _carries_shapes(description: Description, link: Link) -> bool:
    """Returns whether fixed joints attach links with shapes, whose mass may be that of the link."""
    return any(
        joint.type == "fixed" and (child := description.links.get(joint.child)) is not None
        and (child.visuals or child.collisions)
        for joint in description.joints_below.get(link.name, ())
    )  # fmt: skip


def check_lengths(description: Description, link: Link, report: Report) -> None:
    """Reports shapes of a size that suggests millimetres."""
    for shape, _, _, span in description.shapes(link):
        size = measures(shape)
        if size is not None and size.length > MAX_LENGTH:
            report.add(
                "length-unit",
                f"a {type(shape).__name__.lower()} of link `{link.name}` measures"
                f" {plain(size.length, 3)} m",
                span,
                hint="lengths are in m; is this one in mm?",
            )


LINK_RULES: tuple[Callable[[Description, Link, Report], None], ...] = (
    check_mass,
    check_inertia,
    check_density,
    check_lengths,
)


# -- joints -----------------------------------------------------------------------------


def check_moved_mass(description: Description, joint: Joint, report: Report) -> None:
    """Reports a joint that moves no mass, which simulators refuse.

    The links that fixed joints attach to the moving link move with it.
    """
    if joint.type in ("fixed", "floating") or joint.child not in description.links:
        return
    links = [description.links[name] for name in description.rigid_part(joint.child)]
    bodies = [link.inertial for link in links]
    if description.origin == "file" and None in bodies:
        return  # the mass is unknown
    moved = [body for body in bodies if body is not None]
    has_inertia = any(any(body.inertia) for body in moved if body.mass > 0.0)
    if has_inertia or any(body.mass < 0.0 for body in moved):
        return
    link, what = links[0], "inertia" if any(body.mass > 0.0 for body in moved) else "mass"
    _, massless, inertia = _CODES[description.origin]
    description.report(
        report,
        massless if what == "mass" else inertia,
        f"link `{link.name}` moves on joint `{joint.name}` and has no {what}",
        link,
        what,
        "give it a mass and an inertia: weigh the part, or estimate volume times density",
        [Label(joint.span, "the joint")],
    )


def check_angles(description: Description, joint: Joint, report: Report) -> None:
    """Reports limits of a joint that suggest degrees."""
    if joint.type != "revolute":
        return
    for name, limit in (("lower", joint.lower), ("upper", joint.upper)):
        if limit is not None and MAX_ANGLE < abs(limit) <= NO_LIMIT:
            description.report(
                report,
                "angle-unit",
                f"the {name} limit of joint `{joint.name}` is {limit:g} rad, which is"
                f" {abs(limit) / (2 * math.pi):.3g} turns",
                joint,
                name,
                f"is it in degrees? {limit:g} degrees are {math.radians(limit):.6g} rad",
            )


def check_sides(description: Description, joint: Joint, report: Report) -> None:
    """Reports a left wheel that is on the right of the right wheel, or turns the other way."""
    other = description.joints.get(right_name(joint.name) or "")
    if other is not None and all(_is_wheel(description, wheel) for wheel in (joint, other)):
        judge_pair(description, joint, other, report)


def _is_wheel(description: Description, joint: Joint) -> bool:
    """Returns whether a joint moves a round part, or has the name of a wheel."""
    parts = map(description.links.get, description.rigid_part(joint.child))
    shapes = [s.shape for part in parts if part is not None for s in description.shapes(part)]
    is_round = any(isinstance(shape, Cylinder | Sphere) for shape in shapes)
    return is_round or "wheel" in f"{joint.name} {joint.child}".lower()


def judge_pair(
    description: Description,
    left: Joint,
    right: Joint,
    report: Report,
    drive: tuple[str, Span] | None = None,
) -> None:
    """Judges the sides and the axes of two wheels that spin about the y axis of the root.

    - ``drive``: who drives them as a left and a right wheel, and where, if it is not their names.
    """
    poses = [description.poses.get(wheel.child) for wheel in (left, right)]
    if poses[0] is None or poses[1] is None or {left.type, right.type} != {"continuous"}:
        return
    y_left, y_right = poses[0].rotate(left.axis)[1], poses[1].rotate(right.axis)[1]
    if min(abs(y_left), abs(y_right)) < 0.9:
        return
    offset = poses[1].xyz[1] - poses[0].xyz[1]
    if offset > 1e-3:
        subject = f"`{left.name}` is" if drive is None else f"{drive[0]} drives `{left.name}` as"
        report.add(
            "wheel-sides-exchanged",
            f"{subject} a left wheel, {plain(offset, 3)} m to the right of `{right.name}`",
            left.span if drive is None else drive[1],
            hint="left is where y is larger; exchange the names or the places",
            labels=[Label(right.span, "the other wheel")],
        )
    if y_left * y_right < 0.0:
        report.add(
            "wheel-axes-opposite",
            f"the wheels at `{left.name}` and `{right.name}` turn about opposite axes: with equal"
            " speeds the robot turns instead of driving straight",
            right.span,
            hint="give both axes one direction in the frame of the robot",
            labels=[Label(left.span, "the other wheel")],
        )


_LEFT_WORD = re.compile(r"(?i)left")
_LEFT_LETTER = re.compile(r"(?<![A-Za-z])([fbrm]?)l(?![A-Za-z])")


def right_name(name: str) -> str | None:
    """Returns the name of the right one of a pair whose left one has a name, or ``None``."""
    if _LEFT_WORD.search(name):
        return _LEFT_WORD.sub(_right_word, name)
    right = _LEFT_LETTER.sub(r"\1r", name)
    return right if right != name else None


def _right_word(match: re.Match[str]) -> str:
    word = match[0]
    return "RIGHT" if word.isupper() else "Right" if word[0].isupper() else "right"


JOINT_RULES: tuple[Callable[[Description, Joint, Report], None], ...] = (
    check_moved_mass,
    check_angles,
    check_sides,
)
