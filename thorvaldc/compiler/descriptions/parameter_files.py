"""Reads ROS parameter files to sections, one for each node, and what they state about wheels."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from thorvaldc.compiler.descriptions.facts import Fact, ParameterSection, UnreadableFileError
from thorvaldc.compiler.source.node import Node, plain_scalar
from thorvaldc.compiler.source.reader import MAX_DEPTH, MAX_VALUES, compose
from thorvaldc.diagnostics import FIRST_USE, Label, Report, Span

_KEY = "ros__parameters"


def read_yaml(data: bytes, display: str, report: Report) -> Node | None:
    """Returns the document of a YAML file as ROS reads it, or ``None`` if it is empty.

    ROS merges mappings with the same key, and of two values it takes the last one, which is
    reported if they differ.  Raises ``UnreadableFileError``.
    """
    strict = Report()
    root = compose(data, display, strict)
    if root is None:
        if any(d.code.name == "yaml-empty" for d in strict):
            return None
        error = strict.sorted()[0]
        raise UnreadableFileError(error.message, error.span)
    converter = _Converter(display, report)
    try:
        return converter.node(root, None, 0)
    except OverflowError:
        text = f"the document has more than {MAX_VALUES} values, aliases expanded"
        raise UnreadableFileError(text) from None


class _Converter:
    """Converts the nodes of PyYAML; repeated keys, merge keys and aliases are allowed."""

    def __init__(self, file: str, report: Report) -> None:
        self.file = file
        self.report = report
        self.count = 0
        self.ignored = Report()  # words such as `yes`: readers of ROS know them

    def node(self, raw: Any, key_span: Span | None, depth: int) -> Node:
        self.count += 1
        if self.count > MAX_VALUES or depth > MAX_DEPTH:  # also an alias that contains itself
            raise OverflowError
        line, column = raw.start_mark.line + 1, raw.start_mark.column + 1
        span = Span(self.file, line, column, line, column + 1)
        if raw.id == "scalar":
            end = raw.end_mark
            span = Span(self.file, line, column, end.line + 1, end.column + 1)
            value = raw.value if raw.style else plain_scalar(raw.value, span, self.ignored)
            return Node(value, span, key_span, bool(raw.style))
        if raw.id == "sequence":
            return Node(tuple(self.node(v, None, depth + 1) for v in raw.value), span, key_span)
        values: dict[str, Node] = {}
        for raw_key, raw_value in raw.value:
            key = self.node(raw_key, None, depth + 1)
            value = self.node(raw_value, key.span, depth + 1)
            if raw_key.value == "<<" and isinstance(value.value, dict):
                values = {**value.value, **values}
            else:
                self.add(values, str(raw_key.value), value)
        return Node(values, span, key_span)

    def add(self, values: dict[str, Node], key: str, last: Node) -> None:
        """Adds the value of a key that can occur twice in one mapping."""
        first = values.get(key, last)
        if first is not last and isinstance(first.value, dict) and isinstance(last.value, dict):
            merged = dict(first.value)
            for name, value in last.value.items():
                self.add(merged, name, value)
            last = Node(merged, first.span, first.key_span)
        elif first.plain() != last.plain() and first.key_span != last.key_span:
            self.report.add(
                "audit-key-twice",
                f"the key `{key}` occurs twice with different values; ROS uses the last one",
                last.where,
                hint="keep one of them",
                labels=[Label(first.where, FIRST_USE)],
            )
        values[key] = last


def sections(document: Node, display: str, path: Path) -> list[ParameterSection]:
    """Returns the sections of a document in the order of the file; other keys are ignored."""
    result: list[ParameterSection] = []

    def collect(node: Node, name: str) -> None:
        if not isinstance(node.value, dict):
            return
        for key, child in node.value.items():
            if key == _KEY:
                values = flattened(child)
                result.append(ParameterSection(name, display, path, child.where, values))
            else:
                collect(child, f"{name}/{key.strip('/')}" if name else key.strip("/"))

    collect(document, "")
    return result


def flattened(node: Node, prefix: str = "") -> dict[str, Node]:
    """Returns the parameters of a node by their dotted names; lists stay lists."""
    if not isinstance(node.value, dict):
        return {prefix: node}
    values: dict[str, Node] = {}
    for key, child in node.value.items():
        values |= flattened(child, f"{prefix}.{key}" if prefix else key)
    return values


# -- statements about wheels and joints -------------------------------------------------

LEFT = (
    *("left_wheel_names", "left_wheel_name", "left_wheel"),
    *("front_left_wheel_name", "rear_left_wheel_name"),
    *("front_left_wheel_command_joint_name", "rear_left_wheel_command_joint_name"),
)
RIGHT = tuple(name.replace("left", "right") for name in LEFT)
TRACTION = (
    *("rear_wheels_names", "front_wheels_names", "traction_joints_names"),
    *("traction_joint_name", "wheel_names"),
)
STEERING = ("steering_joints_names", "steering_joint_name", "front_steering")
_JOINT_LISTS = (*LEFT, *RIGHT, *TRACTION, *STEERING, "joints", "joint")
_RADIUS = ("wheel_radius", "wheels_radius", "kinematics.wheels_radius", "traction_wheels_radius",
           "front_wheels_radius", "rear_wheels_radius")  # fmt: skip
_SEPARATION = ("wheel_separation", "wheel_separation_y", "traction_track_width")


def controller_facts(section: ParameterSection, known: Collection[str]) -> list[Fact]:
    """Returns what the parameters of a node state about joints and wheels.

    - ``known``: names of the joints of all descriptions.
    """
    facts: list[Fact] = []
    subject = f"`{section.short_name}`"
    for name in _JOINT_LISTS:
        facts += [
            Fact("joint", subject, joint_of(item.value, known), item.span)
            for item in section.items(name)
            if isinstance(item.value, str) and is_plain(item.value)
        ]
    left = plain_names(section, LEFT, known)
    right = plain_names(section, RIGHT, known)
    wheels = (*left, *right) or plain_names(section, TRACTION, known)
    sides = (*left, "", *right) if left and right else ()
    for kind, parameters, joints in (
        ("wheel radius", _RADIUS, wheels),
        ("wheel separation", _SEPARATION, sides),
    ):
        for name in parameters:
            value = section.number(name)
            if value is not None and joints:
                span = section.values[name].span
                facts.append(Fact(kind, subject, value, span, "m", joints))
    return facts


def is_plain(name: str) -> bool:
    """Whether a name is written in full, without substitutions such as ``$(var prefix)``."""
    return bool(name) and "$" not in name and "{" not in name and "<" not in name


def joint_of(name: str, known: Collection[str]) -> str:
    """Returns the joint of an interface: that of a chained controller is `controller/joint`."""
    return name if name in known else name.rsplit("/", 1)[-1]


def plain_names(
    section: ParameterSection, parameters: Sequence[str], known: Collection[str]
) -> tuple[str, ...]:
    """Returns the joints in parameters, or no joints if a name contains a substitution."""
    names = [
        joint_of(item.value, known)
        for parameter in parameters
        for item in section.items(parameter)
        if isinstance(item.value, str)
    ]
    return tuple(names) if all(is_plain(name) for name in names) else ()
