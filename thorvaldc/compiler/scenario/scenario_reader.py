"""A scenario document, of a fleet that is compiled already, as the model of a scenario."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from thorvaldc.compiler.library import Library
from thorvaldc.compiler.modules.bounded_quantities import BoundedQuantities
from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.scenario.ground_zones import check_starts
from thorvaldc.compiler.scenario.world import friction, read_world, with_friction
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.scenario import GROUPS, Command, Expectation, Noise, Scenario, WheelFault

LONGEST = 86400.0
"""A day: the longest run (s)."""

# What a fault needs besides its wheel: (key, quantity, least, most).
_FAULT_VALUES = {
    "steering_offset": ("angle", "angle", -1.0, 1.0),
    "radius_error": ("error", "number", -0.5, 1.0),
    "ice": ("friction", "number", 0.0, 5.0),
}
_OF_MOTORS = ("encoder_frozen", "motor_lost")

_QUANTITIES = {
    "end_error": "length",
    "yaw_error": "angle",
    "path": "length",
    "length_ratio": "number",
    "tilt": "angle",
    "slip": "velocity",
    "largest_slip": "velocity",
    "steering_limit_hits": "number",
    "collisions": "number",
    "energy": "energy",
}


def read_scenario(document: Node, fleet: Fleet, report: Report) -> Scenario:
    """The scenario; its ``fleet`` is the given one in the document's world.

    The values of its variations are tried as well.
    """
    found = _read(document, fleet, report)
    if document.get("variations") is not None:
        _try_variations(document, fleet, report)
    return found


def _try_variations(document: Node, fleet: Fleet, report: Report) -> None:
    """What is wrong with single values, each in the place of the document's own."""
    from thorvaldc.compiler.scenario.variations import changed, read_variations, without_variations
    from thorvaldc.compiler.validation.document_check import check, without_invalid_values

    variations = read_variations(document, (), None, None, report)
    if report.has_errors:
        return
    for change in variations.single():
        if change.path.partition(".")[0] in ("robots", "fleet"):
            continue  # which would be other robots
        shape, said = Report(), Report()
        tried = without_variations(changed(document, [change], said))
        check(tried, "scenario", shape)
        _read(without_invalid_values(tried, shape), fleet, said)
        for fault in (*shape.errors, *said.errors):
            report.put(fault)


def _read(document: Node, fleet: Fleet, report: Report) -> Scenario:
    scope = Scope(None, {}, Library(), report, None)
    numbers = BoundedQuantities(scope, report)
    mu = friction(document, numbers)
    if mu is not None:
        placed = (replace(p, robot=with_friction(p.robot, mu)) for p in fleet.placements)
        fleet = replace(fleet, placements=tuple(placed))
    name = scope.text(document.get("scenario"))
    description = scope.text(document.get("description"))
    fleet = replace(
        fleet, name=name, description=description, world=read_world(document, numbers, report)
    )
    check_starts(fleet, document, report)
    reader = _Reader(fleet, numbers, report)
    record = document.get("record")
    return Scenario(
        name=name,
        description=description,
        fleet=fleet,
        duration=numbers(document, "duration", "time", 1.0, least=0.0, most=LONGEST, above=True),
        commands=reader.commands(document.get("script")),
        faults=tuple(reader.faults(document.get("faults"))),
        noise=reader.noise(document.get("noise")),
        expectations=tuple(reader.expectations(document.get("expect"))),
        span=document.span,
        record=_groups(record),
        every=numbers(record, "every", "time", least=0.0) if record is not None else 0.0,
    )


def _groups(record: Node | None) -> tuple[str, ...]:
    named = {str(node.value) for node in _items(record.get("what") if record else None)}
    return tuple(group for group in GROUPS if not named or group in named)


class _Reader:
    def __init__(self, fleet: Fleet, numbers: BoundedQuantities, report: Report) -> None:
        self.robots = {placement.name: placement.robot for placement in fleet.placements}
        self.numbers = numbers
        self.report = report

    def commands(self, script: Node | None) -> tuple[tuple[str, tuple[Command, ...]], ...]:
        plans: dict[str, list[Command]] = {name: [] for name in self.robots}
        if script is not None and (named := script.get("robot")) is not None:
            self._robots(named)  # of a log, whose velocities the pipeline reads
        before = 0.0
        for node in _items(script):
            time = self.numbers(node, "at", "time", before, least=before, most=LONGEST)
            before = time
            command = Command(
                time,
                self.numbers(node, "vx", "velocity"),
                self.numbers(node, "vy", "velocity"),
                self.numbers(node, "wz", "angular_velocity"),
                "" if node.get("parameters") is None else str(node.plain()["parameters"]),
            )
            named = node.get("robot")
            for name in plans if named is None else self._robots(named):
                plans[name].append(command)
                self._check_parameters(name, node.get("parameters"))
        return tuple((name, tuple(plan)) for name, plan in plans.items())

    def _check_parameters(self, name: str, node: Node | None) -> None:
        known = [found.name for found in self.robots[name].parameter_sets]
        if node is not None and node.value not in known:
            there = f"it has {', '.join(known)}" if known else "its file names none"
            self.report.add(
                "parameter-set-unknown",
                f"{name} has no parameter set `{node.value}`",
                node.span,
                hint=did_you_mean(str(node.value), known, there),
            )

    def faults(self, listed: Node | None) -> Iterator[WheelFault]:
        for node in _items(listed):
            type_, wheel = node.get("type"), node.get("wheel")
            if type_ is None or wheel is None or not isinstance(type_.value, str):
                continue
            named = node.get("robot")
            found = list(self.robots) if named is None else self._robots(named)
            if len(found) > 1:
                self.report.add(
                    "missing-key",
                    "a fault has no `robot`, and there are several",
                    node.where,
                    hint=f"add `robot: {found[0]}`",
                )
            if len(found) != 1:
                continue
            fault = self._fault(node, type_.value, found[0], wheel)
            if fault is not None:
                yield fault

    def _fault(self, node: Node, type_: str, robot: str, wheel: Node) -> WheelFault | None:
        motor = node.get("motor")
        of = str(motor.value) if motor is not None else "drive"
        if type_ == "steering_offset":
            of = "steering"
        if not self._has_wheel(self.robots[robot], wheel, of if type_ != "ice" else ""):
            return None
        value = 0.0
        keys = {"motor"} if type_ in _OF_MOTORS else set()
        if type_ in _FAULT_VALUES:
            key, quantity, least, most = _FAULT_VALUES[type_]
            keys.add(key)
            if node.get(key) is None:
                self.report.add("missing-key", f"the fault `{type_}` has no `{key}`", node.where)
                return None
            value = self.numbers(node, key, quantity, least=least, most=most)
        for key in ("angle", "error", "friction", "motor"):
            entry = node.get(key)
            if entry is not None and key not in keys:
                self.report.add(
                    "conflicting-keys", f"the fault `{type_}` has no `{key}`", entry.where
                )
        start = self.numbers(node, "at", "time", least=0.0)
        end = self.numbers(node, "until", "time", math.inf, least=start, above=True)
        return WheelFault(type_, robot, str(wheel.value), of, value, start, end, node.span)

    def _has_wheel(self, robot: Robot, node: Node, motor: str) -> bool:
        names = [wheel.name for wheel in robot.wheels]
        for wheel in robot.wheels:
            if wheel.name == node.value:
                lacks = {"drive": not wheel.driven, "steering": not wheel.steered}.get(motor, False)
                if lacks:
                    self.report.add(
                        "scenario-wheel-unknown",
                        f"`{wheel.name}` has no motor for its {motor}",
                        node.span,
                    )
                return not lacks
        self.report.add(
            "scenario-wheel-unknown",
            f"{robot.name} has no wheel `{node.value}`",
            node.span,
            hint=did_you_mean(str(node.value), names, f"its wheels: {', '.join(names)}"),
        )
        return False

    def _robots(self, node: Node) -> Sequence[str]:
        if node.value in self.robots:
            return [str(node.value)]
        names = list(self.robots)
        self.report.add(
            "scenario-robot-unknown",
            f"the scenario has no robot `{node.value}`",
            node.span,
            hint=did_you_mean(str(node.value), names, f"its robots: {', '.join(names)}"),
        )
        return []

    def noise(self, node: Node | None) -> Noise:
        if node is None:
            return Noise()
        seed, counts = node.get("seed"), node.get("encoder_counts")
        gyro = node.get("gyro") or node.get("gyro_bias")
        if gyro is not None and not any(map(_has_imu, self.robots.values())):
            self.report.add(
                "scenario-imu-missing",
                "no robot of the scenario has an IMU, and so none tells its yaw rate",
                gyro.where,
                hint="mount a `sensor/imu` on one of them",
            )
        return Noise(
            seed.value if seed is not None and isinstance(seed.value, int) else 0,
            self.numbers(node, "wheel_speed", "angular_velocity", least=0.0),
            self.numbers(node, "wheel_position", "angle", least=0.0),
            self.numbers(node, "steering_angle", "angle", least=0.0),
            self.numbers(node, "gyro", "angular_velocity", least=0.0) if gyro is not None else None,
            self.numbers(node, "gyro_bias", "angular_velocity"),
            counts is not None and counts.value is True,
        )

    def expectations(self, node: Node | None) -> Iterator[Expectation]:
        entries = node.value if node is not None else None
        for metric, bounds in (entries if isinstance(entries, dict) else {}).items():
            quantity = _QUANTITIES.get(metric)
            if quantity is None:
                continue
            least, most = (
                self.numbers(bounds, key, quantity) if bounds.get(key) is not None else None
                for key in ("min", "max")
            )
            if least is not None and most is not None and least > most:
                self.report.add(
                    "out-of-range",
                    f"`{metric}` is expected to be at least {least:g} and at most {most:g}",
                    bounds.where,
                )
            yield Expectation(metric, least, most, bounds.where)


def _has_imu(robot: Robot) -> bool:
    return any(sensor.type == "imu" for sensor in robot.sensors)


def _items(node: Node | None) -> tuple[Node, ...]:
    items = node.value if node is not None else None
    return items if isinstance(items, tuple) else ()
