"""The calibration that a robot document includes: what was measured of its wheels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from thorvaldc.compiler.geometry.static_loads import PlacedWheel
from thorvaldc.compiler.library import Library
from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model.robot import Actuator, Joint, Wheel
from thorvaldc.model.spatial import add, clean
from thorvaldc.model.statics.joint_tree import JointTree

MOST_RADIUS = 0.2
"""Share by which a measured radius may differ from the module's: more is another wheel."""
MOST_OFFSET = math.radians(45.0)
"""Steering offset beyond which a reading is not a matter of calibration."""


@dataclass
class Calibration:
    """Measured values by wheel, in SI, with where each is written."""

    span: Span
    names: dict[str, Span] = field(default_factory=dict)
    radii: dict[str, tuple[float, Span]] = field(default_factory=dict)
    named_radii: dict[str, dict[str, tuple[float, Span]]] = field(default_factory=dict)
    offsets: dict[str, tuple[float, Span]] = field(default_factory=dict)


def load_calibration(
    document: Node, base_dir: Path, report: Report, files: dict[str, Path]
) -> Calibration | None:
    """What the document's ``calibration`` names; ``None`` where it names nothing readable.

    ``files`` gets the file by its name in spans.
    """
    node = document.get("calibration")
    if node is None or not isinstance(node.value, str):
        return None
    path = base_dir / node.value
    if not path.is_file():
        report.add(
            "calibration-missing",
            f"there is no file `{node.value}`",
            node.span,
            hint="make it with `thorvaldc calibrate`, or leave the line out",
        )
        return None
    files[node.value] = path
    shape = Report()
    whole = read_file(path, node.value, shape)
    if whole is not None:
        check(whole, "calibration", shape)
        whole = without_invalid_values(whole, shape)
    report.extend(shape)
    if whole is None:
        return None
    scope = Scope(None, {}, Library(), report, None)
    _check_robot(scope, whole, document, report)
    found = Calibration(whole.span)
    wheels = whole.get("wheels")
    for name, entry in (wheels.value if wheels and isinstance(wheels.value, dict) else {}).items():
        found.names[name] = entry.key_span or entry.span
        radius, offset = entry.get("radius"), entry.get("steering_offset")
        named = entry.get("radii")
        if radius is not None and radius.value is not None:
            found.radii[name] = (scope.quantity(radius, "length"), radius.span)
        if named is not None and isinstance(named.value, dict):
            found.named_radii[name] = {
                key: (scope.quantity(value, "length"), value.span)
                for key, value in named.value.items()
                if value.value is not None
            }
        if offset is not None and offset.value is not None:
            found.offsets[name] = (scope.quantity(offset, "angle"), offset.span)
    return found


def _check_robot(scope: Scope, whole: Node, document: Node, report: Report) -> None:
    node, own = whole.get("robot"), document.get("name")
    if node is None or own is None or None in (node.value, own.value):
        return
    measured, name = scope.text(node), scope.text(own)
    if measured != name:
        report.add(
            "calibration-robot",
            f"the calibration is of `{measured}`; the robot is `{name}`",
            node.span,
            labels=[Label(own.span, "the robot's name")],
            hint="two robots of one design have different wheels: calibrate each",
        )


def calibrate_wheels(
    calibration: Calibration, wheels: list[PlacedWheel], report: Report
) -> list[PlacedWheel]:
    """The wheels with their measured radii.

    A named radius that the module has equal to its ``radius`` is that of the same
    tyre and follows it.
    """
    known = [wheel.name for wheel in wheels]
    for name, span in calibration.names.items():
        if name not in known:
            report.add(
                "calibration-wheel",
                f"the robot has no wheel `{name}`",
                span,
                hint=did_you_mean(name, known, f"its wheels: {', '.join(known)}"),
            )
    made: list[PlacedWheel] = []
    for wheel in wheels:
        part = wheel.part
        measured = calibration.radii.get(wheel.name)
        named = calibration.named_radii.get(wheel.name, {})
        radii = dict(part.radii)
        radius = part.radius
        if measured is not None:
            radius = _radius(*measured, part.radius, wheel.name, report)
            radii = {key: radius if r == part.radius else r for key, r in part.radii}
        for key, (value, span) in named.items():
            if key in radii:
                radii[key] = _radius(value, span, dict(part.radii)[key], wheel.name, report)
            else:
                report.add(
                    "calibration-wheel",
                    f"the wheel `{wheel.name}` has no radius named `{key}`",
                    span,
                    hint=did_you_mean(
                        key, radii, f"it has {', '.join(radii)}" if radii else "it has one radius"
                    ),
                )
        part = part._replace(radius=radius, radii=tuple(radii.items()))
        made.append(wheel._replace(part=part))
    return made


def _radius(value: float, span: Span, nominal: float, wheel: str, report: Report) -> float:
    if abs(value - nominal) <= MOST_RADIUS * nominal:
        return value
    report.add(
        "calibration-value",
        f"the radius of `{wheel}` is {value * 1000:.6g} mm; its module says "
        f"{nominal * 1000:.6g} mm, and more than {MOST_RADIUS:.0%} from it is another wheel",
        span,
        hint="calibrate again, or correct the wheel's module",
    )
    return nominal


def raise_axles(
    joints: list[Joint],
    tree: JointTree,
    before: Sequence[PlacedWheel],
    after: Sequence[PlacedWheel],
) -> None:
    """Move the axles of wheels up by what their radii grew, in place.

    The radius on which a tyre rolls says little of how the robot stands: legs and
    frame give way by such millimetres, and a rigid model would stand on three wheels.
    """
    index = {joint.name: i for i, joint in enumerate(joints)}
    for old, new in zip(before, after, strict=True):
        growth = new.part.radius - old.part.radius
        spin = next((j for j in tree.joints_above(old.link) if j.type != "fixed"), None)
        if growth == 0.0 or spin is None:
            continue
        axis = tree.pose[spin.child].rotate(spin.axis)
        # Under camber the wheel stands on the foot of a leaning circle.
        up = growth * math.sqrt(max(1.0 - axis[2] * axis[2], 0.0))
        shift = tree.pose[spin.parent].inverse().rotate((0.0, 0.0, up))
        i = index[spin.name]
        pose = joints[i].pose
        joints[i] = replace(joints[i], pose=replace(pose, xyz=add(pose.xyz, shift)).clean())


def calibrate_steering(
    calibration: Calibration,
    actuators: list[Actuator],
    wheels: Sequence[Wheel],
    report: Report,
) -> None:
    """Give the steering motors the offsets of their encoders, in place."""
    index = {actuator.joint: i for i, actuator in enumerate(actuators)}
    given: dict[str, tuple[float, Span]] = {}
    for wheel in wheels:
        found = calibration.offsets.get(wheel.name)
        if found is None:
            continue
        offset, span = found
        joint = wheel.steering_joint
        if joint is None or joint not in index:
            report.add(
                "calibration-wheel",
                f"the wheel `{wheel.name}` is not steered; it has no steering offset",
                span,
                hint="leave `steering_offset` out",
            )
        elif abs(offset) > MOST_OFFSET:
            report.add(
                "calibration-value",
                f"the steering offset of `{wheel.name}` is {math.degrees(offset):.6g} deg; "
                f"it must be within +-{math.degrees(MOST_OFFSET):.0f} deg",
                span,
                hint="home the steering first, then calibrate",
            )
        elif joint in given and given[joint][0] != offset:
            other, where = given[joint]
            report.add(
                "calibration-value",
                f"the steering joint `{joint}` of `{wheel.name}` has two offsets: "
                f"{math.degrees(other):.6g} and {math.degrees(offset):.6g} deg",
                span,
                labels=[Label(where, "the other one")],
                hint="wheels on one joint have one offset",
            )
        else:
            given[joint] = found
            i = index[joint]
            actuators[i] = replace(actuators[i], encoder_offset=clean(offset))
