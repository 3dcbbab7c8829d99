"""Rules about limits of joints, and values of one robot in several descriptions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

from thorvaldc.diagnostics import Label, Report
from thorvaldc.model.spatial import norm, sub
from thorvaldc.tools.audit.audit_facts import Description, Evidence, Fact, path_words
from thorvaldc.tools.audit.drive_facts import wheel_center, wheel_radius

TOLERANCE = 0.01
# A wheel that sinks into the soft contact of a simulator may be a little larger there.
RADIUS_TOLERANCE = 0.02


def check_command_limits(evidence: Evidence, report: Report) -> None:
    """Reports commands of ``<ros2_control>`` that go beyond the limits of the joint."""
    for description in evidence.descriptions:
        worst: dict[tuple[str, str], tuple[float, Fact, Fact]] = {}
        for fact in description.facts:
            interface, _, end = fact.kind.partition(" ")
            joint = description.joints.get(fact.names[0]) if fact.names else None
            if joint is None or end not in ("min", "max"):
                continue
            limit = None
            if interface == "velocity":
                limit = joint.limits.get("velocity")
            elif interface == "position":
                limit = joint.limits.get("upper" if end == "max" else "lower")
            if limit is None or (interface == "velocity" and limit.value <= 0.0):
                continue
            bound = -limit.value if interface == "velocity" and end == "min" else limit.value
            excess = fact.value - bound if end == "max" else bound - fact.value
            known = worst.get((joint.name, interface))
            if excess > TOLERANCE * max(abs(bound), 1e-3) and (known is None or excess > known[0]):
                worst[joint.name, interface] = excess, fact, limit._replace(value=bound)
        for (name, interface), (_, fact, limit) in worst.items():
            report.add(
                "audit-joint-limit",
                f"{fact.subject} allows a {interface} of {fact.value:g} {limit.unit} for joint"
                f" `{name}`, whose limit is {limit.value:g} {limit.unit}",
                fact.span,
                hint="write the limit of the motor in both places",
                labels=[Label(limit.span, "limit here")],
            )


def _pairs(evidence: Evidence) -> Iterator[tuple[Description, Description]]:
    """Yields descriptions of one robot in two formats: most of the joints have equal names."""
    for a, b in itertools.combinations(evidence.descriptions[:200], 2):
        if a.format == b.format:
            continue
        names_a = {n for n, j in a.joints.items() if j.kind not in ("fixed", "free")}
        names_b = {n for n, j in b.joints.items() if j.kind not in ("fixed", "free")}
        common = names_a & names_b
        if len(common) >= 2 and 2 * len(common) >= min(len(names_a), len(names_b)):
            words = path_words(a.file) & path_words(b.file)
            best = max(
                len(path_words(a.file) & path_words(other.file))
                for other in evidence.descriptions
                if other.format == b.format
            )
            if len(words) == best:
                yield a, b


def check_descriptions_agree(evidence: Evidence, report: Report) -> None:
    """Reports limits, wheel radii and wheel positions that differ between formats of one robot."""
    for a, b in _pairs(evidence):
        wheels: list[tuple[str, Fact, Fact]] = []
        for name, joint in a.joints.items():
            other = b.joints.get(name)
            if other is None:
                continue
            for quantity in ("lower", "upper", "velocity", "effort"):
                first, second = joint.limits.get(quantity), other.limits.get(quantity)
                if first is None or second is None or first.unit != second.unit:
                    continue
                width = max(abs(first.value), abs(second.value), 1e-3)
                if abs(first.value - second.value) > TOLERANCE * width:
                    _report(f"the {quantity} limit of joint `{name}`", first, second, a, b, report)
            radius, other_radius = wheel_radius(a, joint), wheel_radius(b, other)
            if radius is None or other_radius is None:
                continue
            wheels.append((name, radius, other_radius))
            if not math.isclose(radius.value, other_radius.value, rel_tol=RADIUS_TOLERANCE):
                what = f"the wheel radius at joint `{name}`"
                _report(what, radius, other_radius, a, b, report)
        _check_distances([name for name, *_ in wheels], a, b, report)


def _check_distances(wheels: list[str], a: Description, b: Description, report: Report) -> None:
    """Reports wheels whose distance from the first wheel differs between two descriptions."""
    poses_a, poses_b = a.root_poses(), b.root_poses()
    for name in wheels[1:]:
        lengths: list[float] = []
        for description, poses in ((a, poses_a), (b, poses_b)):
            joints = (description.joints[wheels[0]], description.joints[name])
            start, end = (wheel_center(description, joint, poses) for joint in joints)
            if start is not None and end is not None:
                lengths.append(norm(sub(end, start)))
        if len(lengths) == 2 and not math.isclose(*lengths, rel_tol=TOLERANCE, abs_tol=0.002):
            facts = [
                Fact("distance", name, length, description.joints[name].span, "m")
                for description, length in ((a, lengths[0]), (b, lengths[1]))
            ]
            what = f"the distance of the wheels at joints `{wheels[0]}` and `{name}`"
            _report(what, facts[0], facts[1], a, b, report)


def _report(
    what: str, first: Fact, second: Fact, a: Description, b: Description, report: Report
) -> None:
    report.add(
        "audit-descriptions-differ",
        f"{what} is {second.value:.6g} {second.unit} in {b.format}, but {first.value:.6g}"
        f" {first.unit} in {a.format}",
        second.span,
        hint="make both files from one source",
        labels=[Label(first.span, f"{first.value:.6g} {first.unit} here")],
    )
