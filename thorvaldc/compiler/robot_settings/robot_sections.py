"""Reads short sections of a robot document.

They are the base calculator, requirements on the robot (`design`), the connection of its batteries,
and its names in ROS 2.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.source.node import Node, insertion
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import ValueReader, entries
from thorvaldc.diagnostics import FIRST_USE, Label, Proposal, Report, Span
from thorvaldc.model import Battery, CalculatorChoice, Robot
from thorvaldc.model import settings as ros
from thorvaldc.model.robot import PARALLEL, SEPARATE
from thorvaldc.schema import inlined
from thorvaldc.schema.old_words import old_value


def read_calculator(document: Node, scope: Scope) -> CalculatorChoice:
    """Returns the name and options of the base calculator that the document chooses.

    The default base calculator is ``general``.
    """
    node = document.get("base_calculator")
    if node is None:
        return CalculatorChoice()
    default = CalculatorChoice().name
    if not isinstance(node.value, dict):
        return CalculatorChoice(scope.text(node, default))
    options = node.get("options")
    entries = options.value if options is not None and isinstance(options.value, dict) else {}
    return CalculatorChoice(
        scope.text(node.get("name"), default),
        tuple(
            (key, option.value)
            for key, option in entries.items()
            if isinstance(option.value, bool | int | float | str)
        ),
    )


def check_calculator(robot: Robot | None, document: Node, report: Report) -> None:
    """Checks the base calculator of a robot.

    The base calculator must exist, accept the chosen options and suit the wheels of the robot.  If
    the robot has other errors, it is ``None``, and only the name is checked.
    """
    choice = document.get("base_calculator")
    if choice is None or (robot is not None and robot.calculator == CalculatorChoice()):
        return  # The general base calculator suits every robot.
    # The import of the base calculators is here, because robots with the general base calculator do
    # not need the import.
    from thorvaldc.runtime import calculators

    name = choice.get("name") or choice
    options = choice.get("options")
    for problem in calculators.calculator_errors(robot or str(name.value)):
        option = options.get(problem.option) if options is not None and problem.option else None
        diagnostic = problem.diagnostic
        span = (option or name).span
        if option is not None and isinstance(diagnostic.hint, Proposal):
            span = option.where  # the name of the option is misspelled
        old = old_value("robot", ("base_calculator",), str(name.value))
        hint = old.hint if old and diagnostic.code.name == "calculator-unknown" else diagnostic.hint
        report.add(diagnostic.code.name, diagnostic.message, span, hint=hint)


DEFAULT_TIP_OVER = math.radians(15)


class DesignRequirements(NamedTuple):
    """Requirements on a whole robot, such as the slope that the robot must climb.

    Attributes
    ----------
    slope : slope (rad) that the robot must climb.  ``None`` if no slope is required.
    tip_over_angle : least tip-over angle (rad) of the robot.
    slope_span : span of the entry for the slope.
    tip_over_span : span of the entry for the tip-over angle.
    """

    slope: float | None = None
    tip_over_angle: float = DEFAULT_TIP_OVER
    slope_span: Span | None = None
    tip_over_span: Span | None = None


def read_design(document: Node, report: Report) -> DesignRequirements:
    """Reads the `design` section of a robot document.

    A missing or invalid requirement is replaced by the default requirement.
    """
    node = document.get("design")
    if node is None:
        return DesignRequirements()
    section = Section(node, inlined("robot")["properties"]["design"], ValueReader(report))

    def angle(key: str, default: float) -> float:
        entry = node.get(key)
        if entry is None:
            return default
        hint = None
        if isinstance(entry.value, int | float) and not isinstance(entry.value, bool):
            value, hint = float(entry.value), f"write `{entry.value:g} deg` if degrees are meant"
        else:
            value = section.get(key, default)
        if 0.0 <= value < math.pi / 2:
            return value
        report.add(
            "number-out-of-range",
            f"`{key}` is {math.degrees(value):.6g} deg; it must be from 0 to less than 90 deg",
            entry.span,
            hint=hint,
        )
        return default

    slope, tip_over = node.get("slope"), node.get("minimum_tip_over_angle")
    return DesignRequirements(
        angle("slope", 0.0) if slope is not None else None,
        angle("minimum_tip_over_angle", DEFAULT_TIP_OVER),
        slope.where if slope is not None else None,
        tip_over.where if tip_over is not None else None,
    )


def read_battery_connection(
    document: Node, batteries: Sequence[Battery], report: Report
) -> str | None:
    """Returns the connection of the batteries, or ``None`` if the document does not state it.

    Reports several batteries without a statement, and batteries in parallel with different nominal
    voltages: the one with the higher voltage charges the other without a limit of the current.
    """
    node = document.get("batteries")
    present = [battery for battery in batteries if battery.node is not None]
    if node is None:
        if len(present) > 1:
            names = ", ".join(f"`{battery.module}`" for battery in present[:4])
            report.add(
                "battery-connection",
                f"the robot has {len(present)} batteries ({names}{', ..' * (len(present) > 4)}) "
                "and does not state how they are connected",
                present[1].span,
                labels=[Label(present[0].span, "the first battery")],
                hint=insertion(
                    "add `batteries: parallel`, or `separate` if each supplies its own modules",
                    document,
                    "batteries",
                    PARALLEL,
                    is_example=True,
                ),
            )
        return None
    if node.value == PARALLEL and len(present) > 1:
        _check_voltages(present, node, report)
    return str(node.value)


def _check_voltages(batteries: Sequence[Battery], connection: Node, report: Report) -> None:
    stated = [(b, v) for b in batteries if (v := b.voltage) is not None]
    for battery, voltage in stated[1:]:
        first, expected = stated[0]
        if not math.isclose(voltage, expected, rel_tol=1e-6):
            report.add(
                "battery-voltages",
                f"`{battery.module}` with {voltage:g} V is in parallel with `{first.module}` with "
                f"{expected:g} V",
                battery.span,
                labels=[Label(first.span, f"{expected:g} V here")],
                hint=Proposal(
                    "use batteries of one voltage, or write `batteries: separate`",
                    SEPARATE,
                    span=connection.span,
                ),
            )


def read_ros_settings(
    section: Section, robot_name: str, launches: tuple[ros.OwnLaunch, ...], report: Report
) -> ros.RosSettings:
    """Returns the settings of the ROS 2 package of a robot: the section `ros` of its document.

    The default name of the package is made from the name of the robot.  ``launches``: the launch
    files that the section names.
    """
    package = section.get("package", ros.package_name(robot_name or ros.RosSettings().package))
    if "package" in section:
        problem = ros.package_problem(package)
        if problem is not None:
            report.add(
                "ros-package-name",
                f"`{package}` cannot be the name of a ROS 2 package: {problem}",
                section.entry("package").span,
                hint=Proposal(
                    f"write `{ros.package_name(package)}`, or leave out `package`",
                    ros.package_name(package),
                ),
            )
    licence, maintainer, version = (
        _stated_text(section, key, *form, report) for key, form in _MANIFEST.items()
    )
    return ros.RosSettings(
        section["distro"], section["odom_tf"], package, licence, maintainer, version, launches
    )


_MANIFEST = {
    "license": (r"[^\n]+", "Apache-2.0"),
    "maintainer": (r"[^<>\n]*[^<>\s] <[^<>@\s]+@[^<>@\s]+>", "Ada Field <ada@example.org>"),
    "version": (r"(0|[1-9][0-9]*)([.](0|[1-9][0-9]*)){2}", "1.2.0"),
}
"""Form and example of the texts of the section `ros` that a ``package.xml`` contains (REP 149)."""


def _stated_text(section: Section, key: str, form: str, example: str, report: Report) -> str:
    text = str(section[key] or "")
    if key in section and not re.fullmatch(form, text):
        report.add(
            "unknown-value",
            f"`{text}` cannot be the {key} of a ROS 2 package",
            section.entry(key).span,
            hint=f"write it as `{example}`",
        )
    return text


def check_ros_names(robot: Robot, document: Node, report: Report) -> None:
    """Checks the names of the frames and topics that the robot has in ROS 2."""
    _check_frames(robot, report)
    _check_topics(robot, document, report)


def _check_frames(robot: Robot, report: Report) -> None:
    """Reports links whose names cannot be frames in ROS 2."""
    for link in robot.links:
        if link.name.startswith("/"):
            report.add(
                "ros-frame-name",
                f"the link `{link.name}` cannot be a frame: no frame of tf2 begins with `/`",
                link.span,
                hint=f"call it `{link.name.lstrip('/')}`",
            )
        elif link.name in (ros.ODOM_FRAME, ros.MAP_FRAME):
            report.add(
                "ros-frame-reserved",
                f"the link `{link.name}` has the name of a frame that is not part of the robot",
                link.span,
                hint=f"rename the link; localization publishes `{link.name}` (REP 105)",
            )


def _check_topics(robot: Robot, document: Node, report: Report) -> None:
    """Reports sources and locks of twists whose topic is used for something else."""
    driver = document.get("driver") or Node({}, document.span)
    owners: dict[str, tuple[str, Node]] = {}
    for section, inputs in (
        ("twist_sources", robot.twist_sources),
        ("twist_locks", robot.twist_locks),
    ):
        stated = entries(driver.get(section))
        for twist_input in inputs:
            entry = stated.get(twist_input.name, driver)
            node, topic = entry.get("topic") or entry, twist_input.topic
            owner = owners.setdefault(topic, (twist_input.name, node))
            if topic in ros.RESERVED_TOPICS:
                use, labels = ros.RESERVED_TOPICS[topic], []
            elif owner[0] != twist_input.name:
                use, labels = f"that of `{owner[0]}`", [Label(owner[1].where, FIRST_USE)]
            else:
                continue
            report.add(
                "ros-topic-duplicate",
                f"`{twist_input.name}` has the topic `{topic}`, which is also {use}",
                node.span,
                hint="give each source and each lock its own topic",
                labels=labels,
            )
