"""Applies the measured wheel radii and steering offsets in the calibration file of a robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, NamedTuple

from thorvaldc.compiler.robot_settings.driver_settings import noise_of
from thorvaldc.compiler.source.input_file import DOCUMENTS, folder_of, report_missing
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.compiler.values.document_section import Section, read_document
from thorvaldc.compiler.values.value_reader import ValueReader
from thorvaldc.diagnostics import Label, Proposal, Report, Span, did_you_mean, millimetres
from thorvaldc.model import Actuator, Wheel
from thorvaldc.model.robot import MAX_STEERING_OFFSET
from thorvaldc.model.spatial import clean

MAX_RADIUS_CHANGE = 0.2
"""Fraction by which a measured radius may differ from the radius in the module document.

A measured radius with a larger difference is probably the radius of another wheel.
"""


class Measured(NamedTuple):
    """A measured value in SI units, with file, line and column of the value in the calibration
    file.
    """

    value: float
    span: Span


@dataclass
class Calibration:
    """Content of a calibration file, which contains measured wheel radii and steering offsets.

    Attributes
    ----------
    names : span of the entry of each wheel, by the name of the wheel.
    radii : measured radius (m) of each wheel, by the name of the wheel.
    named_radii : measured radii (m) of each wheel, by the names of the wheel and of the radius.
    steering_offsets : measured steering offset (rad) of each wheel, by the name of the wheel.
    noise : errors that remain after the calibration, by the key of the section ``noise``.
    """

    tolerance: ClassVar[float] = MAX_RADIUS_CHANGE

    names: dict[str, Span] = field(default_factory=dict)
    radii: dict[str, Measured] = field(default_factory=dict)
    named_radii: dict[str, dict[str, Measured]] = field(default_factory=dict)
    steering_offsets: dict[str, Measured] = field(default_factory=dict)
    noise: dict[str, float] = field(default_factory=dict)

    def with_measured_radii(self, wheels: Sequence[Wheel], report: Report) -> tuple[Wheel, ...]:
        """Returns the wheels with the measured radii.

        A named wheel radius that equals the nominal ``radius`` of the wheel belongs to the same
        tyre.  The named wheel radius is therefore replaced by the same measured radius.
        """
        known = [wheel.name for wheel in wheels]
        for name, span in self.names.items():
            if name not in known:
                report.add(
                    "calibration-wheel",
                    f"the robot has no wheel `{name}`",
                    span,
                    hint=did_you_mean(name, known, f"its wheels: {', '.join(known)}"),
                )
        return tuple(self._measured_wheel(wheel, report) for wheel in wheels)

    def _measured_wheel(self, wheel: Wheel, report: Report) -> Wheel:
        """Returns a wheel with the measured radii."""
        nominal_radii = dict(wheel.radii)
        radius, radii = wheel.radius, dict(nominal_radii)
        measured_radius = self.radii.get(wheel.name)
        if measured_radius is not None:
            radius = _checked_radius(measured_radius, wheel.radius, wheel.name, report)
            radii = {key: radius if r == wheel.radius else r for key, r in wheel.radii}
        for key, measured in self.named_radii.get(wheel.name, {}).items():
            if key in radii:
                radii[key] = _checked_radius(measured, nominal_radii[key], wheel.name, report)
            else:
                report.add(
                    "calibration-wheel",
                    f"the wheel `{wheel.name}` has no radius named `{key}`",
                    measured.span,
                    hint=did_you_mean(
                        key, radii, f"it has {', '.join(radii)}" if radii else "it has one radius"
                    ),
                )
        return replace(wheel, radius=radius, radii=tuple(radii.items()))

    def with_steering_offsets(
        self,
        actuators: Sequence[Actuator],
        wheels: Sequence[Wheel],
        report: Report,
    ) -> tuple[Actuator, ...]:
        """Returns the actuators; steering motors get the measured encoder offsets (rad)."""
        actuated = {actuator.joint for actuator in actuators}
        offset_by_joint: dict[str, Measured] = {}
        for wheel in wheels:
            measured = self.steering_offsets.get(wheel.name)
            if measured is None:
                continue
            offset, span = measured
            joint = wheel.steering_joint
            if joint is None or joint not in actuated:
                report.add(
                    "calibration-wheel",
                    f"the wheel `{wheel.name}` is not steered; it has no steering offset",
                    span,
                    hint="leave `steering_offset` out",
                )
            elif abs(offset) > MAX_STEERING_OFFSET:
                report.add(
                    "calibration-value",
                    f"the steering offset of `{wheel.name}` is {math.degrees(offset):.6g} deg; "
                    f"it must be within +-{math.degrees(MAX_STEERING_OFFSET):.0f} deg",
                    span,
                    hint="home the steering first, then calibrate; "
                    "a number without a unit is in rad",
                )
            elif joint in offset_by_joint and offset_by_joint[joint].value != offset:
                first = offset_by_joint[joint]
                report.add(
                    "calibration-value",
                    f"the steering joint `{joint}` of `{wheel.name}` has two offsets: "
                    f"{math.degrees(first.value):.6g} and {math.degrees(offset):.6g} deg",
                    span,
                    labels=[Label(first.span, "the other one")],
                    hint="wheels on one joint have one offset",
                )
            else:
                offset_by_joint[joint] = measured
        return tuple(
            replace(actuator, encoder_offset=clean(offset_by_joint[actuator.joint].value))
            if actuator.joint in offset_by_joint
            else actuator
            for actuator in actuators
        )


def load_calibration(
    document: Node, base_dir: Path, report: Report, files: dict[str, Path]
) -> Calibration | None:
    """Reads the calibration file of a robot.

    The entry ``calibration`` of the robot document names the calibration file.  Returns ``None``
    if the document has no entry ``calibration``.  Returns ``None`` and reports an error if the
    file cannot be read.

    Parameters
    ----------
    document : the robot document.
    base_dir : folder of the robot file.
    files : the function adds the calibration file, by the name of the file in spans.
    """
    node = document.get("calibration")
    if node is None or not isinstance(node.value, str):
        return None
    base_dir = folder_of(node, files, base_dir)
    path = base_dir / node.value
    if not path.is_file():
        hint = "make it with `thorvaldc calibrate`, or leave the line out"
        report_missing("calibration-missing", base_dir, node, DOCUMENTS, report, hint)
        return None
    files[node.value] = path
    shape = Report()
    root = read_file(path, node.value, shape)
    if root is not None:
        check(root, "calibration", shape)
        root = without_invalid_values(root, shape)
    report.extend(shape)
    if root is None:
        return None
    _check_robot(root, document, report)
    measured = read_document(root, "calibration", ValueReader(report))
    calibration = Calibration(noise=noise_of(measured))
    for name, wheel in measured["wheels"].items():
        calibration.names[name] = wheel.node.where
        if "radius" in wheel:
            calibration.radii[name] = _measured(wheel, "radius")
        radii = wheel["radii"]
        calibration.named_radii[name] = {key: _measured(radii, key) for key, _ in radii.items()}
        if "steering_offset" in wheel:
            calibration.steering_offsets[name] = _measured(wheel, "steering_offset")
    return calibration


def _measured(section: Section, key: str) -> Measured:
    return Measured(section.get(key, 0.0), section.entry(key).span)


def _check_robot(calibration: Node, document: Node, report: Report) -> None:
    """Checks that the calibration file and the robot document contain the same robot name."""
    measured_node, name_node = calibration.get("robot"), document.get("name")
    if measured_node is None or name_node is None:
        return
    measured_name, name = measured_node.value, name_node.value
    if None not in (measured_name, name) and measured_name != name:
        report.add(
            "calibration-robot",
            f"the calibration is of `{measured_name}`; the robot is `{name}`",
            measured_node.span,
            labels=[Label(name_node.span, "the robot's name")],
            hint="two robots of one design have different wheels: calibrate each",
        )


def _checked_radius(measured: Measured, nominal: float, wheel: str, report: Report) -> float:
    """Returns the measured radius (m), or the nominal radius if the measurement is not plausible.

    A measured wheel radius that is not plausible is reported.
    """
    if abs(measured.value - nominal) <= MAX_RADIUS_CHANGE * nominal:
        return measured.value
    report.add(
        "calibration-value",
        f"the radius of `{wheel}` is {millimetres(measured.value, 6)}; its module states "
        f"{millimetres(nominal, 6)}, and a difference of more than {MAX_RADIUS_CHANGE:.0%} means "
        "another wheel",
        measured.span,
        hint=_radius_hint(measured.value, nominal),
    )
    return nominal


def _radius_hint(radius: float, nominal: float) -> str:
    for factor, reason in ((0.001, "a radius in mm needs its unit"), (0.5, "this is the diameter")):
        if abs(factor * radius - nominal) <= MAX_RADIUS_CHANGE * nominal:
            text = f"{millimetres(factor * radius, 6)}"
            return Proposal(f"write `{text}` if {reason}", text)
    return "calibrate again, or correct the wheel's module"
