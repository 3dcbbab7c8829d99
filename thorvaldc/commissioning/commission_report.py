"""The report of the first motion of a robot, which ``thorvaldc can commission`` writes.

The report is a JSON file beside the robot file, with an HTML page.  docs/commissioning.md describes
it.  A run can demand it (``thorvaldc run --commissioned``): each motor has passed, what leads from
its channel to the ground has not changed in the robot file since then, and the controllers on the
bus are those that were checked.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thorvaldc.can.lss import Identity
from thorvaldc.commissioning.scan_result import OK, ScanEntry, identity_text
from thorvaldc.diagnostics import DiagnosticError, Span
from thorvaldc.diagnostics.files import read_bounded, read_json
from thorvaldc.model import Actuator, Node, Robot
from thorvaldc.model.model_json import ModelFormatError, typed_value

FORMAT, VERSION = "thorvaldc-commission", 1
MAX_BYTES = 4_000_000
SUFFIX = ".commission.json"
PASSED, FAILED, LEFT_OUT, NOT_TESTED = "passed", "failed", "left out", "not tested"
"""States of a motor in the report."""
YES = "yes"
"""Unit of a figure that is 1 for yes and 0 for no."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A measured value with its bounds.

    - ``name``: what was measured;
    - ``value``: the value, or ``None`` if it was not reached.
    """

    name: str
    value: float | None
    unit: str
    least: float
    most: float

    @property
    def passed(self) -> bool:
        numbers = (self.least, self.value, self.most)
        known = all(number is not None and math.isfinite(number) for number in numbers)
        return known and self.least <= (self.value or 0.0) <= self.most

    @property
    def value_text(self) -> str:
        if self.unit == YES:
            return "yes" if self.value else "no"
        return "not reached" if self.value is None else f"{self.value:.2f} {self.unit}".strip()

    @property
    def bounds_text(self) -> str:
        return "yes" if self.unit == YES else f"{self.least:.2f} to {self.most:.2f}"


@dataclass(frozen=True, slots=True)
class Finding:
    """What is wrong in the assembly.

    - ``motors``: names of the motors that it concerns;
    - ``text``: what is wrong;
    - ``change``: what to change, in the file or on the robot.
    """

    motors: tuple[str, ...]
    text: str
    change: str


@dataclass(frozen=True, slots=True)
class CheckedMotor:
    """Result of the checks of one motor.

    - ``key``: hash of the motor and its controller, see ``motor_key``;
    - ``state``: ``PASSED``, ``FAILED``, ``LEFT_OUT`` or ``NOT_TESTED``;
    - ``moved``: motor of the joint that has moved;
    - ``seen``: travel (rad) that the operator has seen;
    - ``zero``: angle (rad) of the wheel at the zero of its drive;
    - ``not_tested``: checks that were left out.
    """

    name: str
    node: str | None
    channel: str | None
    key: str
    state: str = NOT_TESTED
    date: str = ""
    operator: str = ""
    moved: str | None = None
    seen: float | None = None
    zero: float | None = None
    figures: tuple[Figure, ...] = ()
    not_tested: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class FoundNode:
    """A device on a bus, with the numbers of its identity as far as they are known.

    - ``state``: verdict of the scan.
    """

    name: str
    state: str
    id: int | None
    vendor: int | None = None
    product: int | None = None
    revision: int | None = None
    serial: int | None = None

    @classmethod
    def of(cls, entry: ScanEntry) -> FoundNode:
        node = cls(entry.node, entry.verdict, entry.device_id)
        if entry.identity is None:
            return node
        vendor, product, revision, serial = entry.identity
        return dataclasses.replace(
            node, vendor=vendor, product=product, revision=revision, serial=serial or None
        )

    @property
    def identity(self) -> Identity | None:
        if self.vendor is None or self.product is None or self.revision is None:
            return None
        return Identity(self.vendor, self.product, self.revision, self.serial or 0)


@dataclass(frozen=True, slots=True)
class CalibratedWheel:
    """Result of ``calibrate`` for a wheel, with standard errors; ``None``: not determined.

    - ``steering_offset``: in rad;
    - ``radius_ratio``: measured radius over the radius of the robot file.
    """

    name: str
    steering_offset: float | None
    steering_offset_error: float | None
    radius_ratio: float | None
    radius_ratio_error: float | None


@dataclass(frozen=True, slots=True)
class LastingError:
    """An error in SI units that remains after a calibration."""

    name: str
    value: float


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    wheels: tuple[CalibratedWheel, ...]
    remaining_errors: tuple[LastingError, ...]


@dataclass(frozen=True, slots=True)
class CommissionReport:
    """The report.

    - ``model``: hash of the model, see ``model_hash``;
    - ``program``: version of thorvaldc;
    - ``interruption``: reason why the checks ended before their end, or an empty text;
    - ``calibration``: result of a later ``calibrate``.
    """

    robot: str
    model: str
    program: str
    date: str
    operator: str
    interruption: str
    nodes: tuple[FoundNode, ...]
    findings: tuple[Finding, ...]
    motors: tuple[CheckedMotor, ...]
    calibration: CalibrationResult | None = None

    @property
    def passed(self) -> bool:
        complete = all(motor.state == PASSED for motor in self.motors)
        return complete and not self.findings and not self.interruption

    def as_json(self) -> dict[str, Any]:
        head = {"format": FORMAT, "version": VERSION, "passed": self.passed}
        return head | dataclasses.asdict(self)


def motor_key(robot: Robot, motor: Actuator) -> str:
    """Returns the hash of all that leads from a channel to a wheel on the ground.

    That is motor, controller, the signals of the joint in its frames, joint, and the wheel with its
    place and radii, but no line of a file.
    """
    nodes = [(bus.name, n) for bus in robot.buses for n in bus.nodes if n.name == motor.node]
    signals = [
        (frame.key, dataclasses.replace(signal, description=""))
        for bus in robot.buses
        for frame in bus.frames
        for signal in frame.signals
        if signal.joint == motor.joint
    ]
    joint = robot.joint(motor.joint)
    axis = (joint.pose, joint.axis, joint.lower, joint.upper, joint.parent, joint.child)
    wheels = [
        (w.name, w.x, w.y, w.heading, w.steering_sign, w.trail, w.lateral_offset, w.radius, w.radii)
        for w in robot.wheels
        if motor.joint in (w.spin_joint, w.steering_joint)
    ]
    parts = (motor, *nodes, *signals, axis, *wheels)
    return hashlib.sha256(repr(_values(parts)).encode()).hexdigest()[:16]


def _values(value: Any) -> Any:
    """Returns the values of a part of a model, without spans."""
    if isinstance(value, Span):
        return None
    if isinstance(value, tuple):
        return [_values(item) for item in value]
    if dataclasses.is_dataclass(value):
        return [_values(getattr(value, field.name)) for field in dataclasses.fields(value)]
    return value


def driven_joints(robot: Robot) -> list[Actuator]:
    """Returns the motors of wheels and steering joints, in the order of the wheels."""
    by_joint = {actuator.joint: actuator for actuator in robot.actuators}
    names = [name for w in robot.wheels for name in (w.spin_joint, w.steering_joint) if name]
    return [by_joint[name] for name in names if name in by_joint]


def passed_motors(
    robot: Robot, report: CommissionReport, devices: Sequence[ScanEntry]
) -> dict[str, CheckedMotor]:
    """Returns the motors for which the report counts, by name; see ``refusals``."""
    refused = refusals(robot, report, devices)
    return {m.name: m for m in report.motors if m.name in refused and not refused[m.name]}


def refusals(
    robot: Robot, report: CommissionReport, devices: Sequence[ScanEntry]
) -> dict[str, str]:
    """Returns for each motor of a robot why the report does not count for it, or an empty text.

    ``devices``: the devices that answer on the buses of the robot now.  A later check goes on with
    the motors that count; a run needs all of them.
    """
    nodes = {node.name: node for bus in robot.buses for node in bus.nodes}
    texts = {}
    for motor in driven_joints(robot):
        reason = _refusal(robot, motor, report)
        texts[motor.name] = f"{motor.name} {reason}" if reason else ""
        if not reason and motor.node in nodes:
            texts[motor.name] = _device_refusal(nodes[motor.node], report, devices)
    return texts


def _refusal(robot: Robot, motor: Actuator, report: CommissionReport) -> str:
    checked = [each for each in report.motors if each.name == motor.name]
    if report.robot != robot.name:
        return f"was checked at the robot {report.robot}"
    if len(checked) > 1:
        return "is in the report more than once"
    if not checked or checked[0].state != PASSED:
        return f"is {checked[0].state if checked else NOT_TESTED}"
    if checked[0].key != motor_key(robot, motor):
        return "has changed since"
    if any(motor.name in finding.motors for finding in report.findings):
        return "has a finding"
    if checked[0].moved != motor.name:
        return f"moved {checked[0].moved or 'nothing'}"
    if not checked[0].figures or not all(figure.passed for figure in checked[0].figures):
        return "has a figure that is missing or out of its bounds"
    return ""


def _device_refusal(node: Node, report: CommissionReport, devices: Sequence[ScanEntry]) -> str:
    """Returns why the device on the bus is not the one of the report, or an empty text."""
    checked = [each for each in report.nodes if each.name == node.name]
    if len(checked) != 1 or checked[0].state != OK:
        return f"{node.name}: the report does not say which device was checked"
    present = next((entry for entry in devices if entry.node == node.name), None)
    if present is None or present.verdict != OK:
        actual = "is not on the bus" if present is None else f"is {present.verdict}"
        detail = f": {present.detail}" if present is not None and present.detail else ""
        return f"{node.name} {actual}{detail}; checked was {identity_text(checked[0].identity)}"
    if present.identity != checked[0].identity:
        return (
            f"{node.name} is not the device that was checked: it was"
            f" {identity_text(checked[0].identity)}; now it is {identity_text(present.identity)}"
        )
    return ""


def identity_note(robot: Robot, devices: Sequence[ScanEntry]) -> str:
    """Says for which motor controllers a replacement cannot be noticed, or returns ""."""
    known = {
        entry.node for entry in devices if entry.identity is not None and entry.identity.serial
    }
    nodes = dict.fromkeys(motor.node for motor in driven_joints(robot) if motor.node is not None)
    names = ", ".join(name for name in nodes if name not in known)
    if not names:
        return ""
    return f"no serial number is known of {names}: an equal device in its place is not noticed"


def read_report(path: Path) -> CommissionReport:
    """Returns the report in a file.

    Raises ``DiagnosticError`` (``not-commissioned``) if the file is missing or is no report.
    """
    try:
        content = read_json(read_bounded(path, MAX_BYTES))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise _not_commissioned(f"cannot read {path}: {reason}") from None
    if not isinstance(content, dict) or content.pop("format", None) != FORMAT:
        raise _not_commissioned(f"{path} is no report of `can commission`")
    if (version := content.pop("version", None)) != VERSION:
        raise _not_commissioned(f"{path} has the version {version}, not {VERSION}")
    passed = content.pop("passed", None)
    try:
        report: CommissionReport = typed_value(CommissionReport, content, "report")
    except ModelFormatError as error:
        raise _not_commissioned(f"{path}: {error}") from None
    if passed is not report.passed:
        raise _not_commissioned(f"{path}: `passed` does not fit its motors; was it edited?")
    return report


def require_commissioned(
    path: Path, report: CommissionReport, robot: Robot, devices: Sequence[ScanEntry]
) -> None:
    """Raises ``DiagnosticError`` (``not-commissioned``) if ``shortcomings`` are left."""
    reasons = shortcomings(robot, report, devices)
    if reasons:
        raise _not_commissioned(f"{path}: {'; '.join(reasons)}")


def shortcomings(robot: Robot, report: CommissionReport, devices: Sequence[ScanEntry]) -> list[str]:
    """Returns why a run that demands the report is refused; see ``refusals``."""
    reasons = [reason for reason in refusals(robot, report, devices).values() if reason]
    if report.interruption:
        reasons.append(f"the checks were interrupted: {report.interruption}")
    elif report.findings and not reasons:
        reasons.append("it has findings")
    return list(dict.fromkeys(reasons))


def _not_commissioned(reason: str) -> DiagnosticError:
    return DiagnosticError(
        "not-commissioned",
        reason,
        hint="check the first motion: thorvaldc can commission FILE; to find the file of the robot"
        " on a bus: thorvaldc can identify FOLDER",
    )


def report_text(report: CommissionReport) -> str:
    return json.dumps(report.as_json(), indent=1, ensure_ascii=False) + "\n"
