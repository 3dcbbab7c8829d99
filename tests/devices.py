"""Devices as the elaboration produces them, for tests of the bus compiler."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.compiler.bus.assemble_buses import build_buses
from thorvaldc.compiler.bus.device_sections import BusSpec, Device, Wire
from thorvaldc.compiler.bus.node_ids import Lock
from thorvaldc.compiler.modules.library import Library, ModuleType
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.diagnostics import Diagnostic, Report, Span
from thorvaldc.model import Actuator, Bus, FrameDefinition, Signal

MODULES = Path(__file__).parents[1] / "modules"
DRIVE = "controller/propulsion_steering"
TWO_DRIVES = "controller/propulsion_propulsion"
CIA_402 = "controller/cia402_propulsion_steering"
BATTERY = "battery/enclosure"
CYCLE = 0.02  # s
LIMIT = 3.078027759  # rad, steering
MOTORS = make_robot(FOUR_STEERED).actuators
SIMPLE = """
description: test
channels: {motor: {role: propulsion}}
can:
  protocol: simple
  id_space: canopen
  ids: [1, 127]
  frames:
"""


def line(number: int, file: str = "robot.yaml") -> Span:
    """Returns a span in one line of a file."""
    return Span(file, number, 1, number, 9)


class Bench:
    """Adds devices one by one; the n-th has the source span of line n of robot.yaml."""

    def __init__(self) -> None:
        self.report = Report()
        self.devices: list[Device] = []

    def add(
        self,
        type_name: str,
        address: object = None,
        wires: dict[str, Actuator] | None = None,
        *,
        text: str | None = None,
        params: dict[str, Any] | None = None,
        limits: tuple[float | None, float | None] = (-LIMIT, LIMIT),
        name: str | None = None,
    ) -> None:
        """Adds a device of a module type; ``text`` replaces the type's module.yaml.

        ``wires`` are the motors by channel, ``limits`` the steering limits in rad.
        """
        display = f"{type_name}/module.yaml"
        data = text.encode() if text else (MODULES / display).read_bytes()
        document = read_text(data, display, self.report)
        assert document is not None
        module = ModuleType(type_name, MODULES / type_name, display, document)
        number = len(self.devices) + 1
        span = line(number)
        values = {k: (Node(v, span), EMPTY) for k, v in (params or {}).items()}
        can = document.get("can")
        assert can is not None
        name = name or f"d{number}"
        self.devices.append(
            Device(
                name,
                name,
                can,
                document.get("channels"),
                tuple(
                    Wire(channel, motor, *limits, span)
                    if motor.role == "steering"
                    else Wire(channel, motor, None, None, span)
                    for channel, motor in (wires or {}).items()
                ),
                node_of(address, span) if address is not None else None,
                Scope(module, values, Library(), self.report, None),
                span,
            )
        )

    def drive(self, address: object = None, index: int | None = None) -> None:
        """Adds a controller for the two motors of wheel ``index``, by default of the next one."""
        i = 2 * (len(self.devices) if index is None else index)
        self.add(DRIVE, address, {"propulsion": MOTORS[i], "steering": MOTORS[i + 1]})

    def build(
        self,
        specs: Sequence[BusSpec] = (BusSpec("main", 500_000, line(99)),),
        *,
        motors: Sequence[Actuator] | None = None,
        cycle: float = CYCLE,
        foreign: str = "",
        lock: Lock | None = None,
    ) -> tuple[Bus, ...]:
        """Returns the buses; ``foreign`` is the text of the section with foreign frames."""
        wired = [w.actuator for d in self.devices for w in d.wires]
        used = list(dict.fromkeys(wired)) if motors is None else motors
        section = read_text(foreign.encode(), "robot.yaml", self.report) if foreign else None
        return build_buses(
            self.devices, specs, used, cycle, self.report, foreign=section, lock=lock
        )

    def only_diagnostic(self, code: str) -> Diagnostic:
        """Returns the only diagnostic, which must have this code."""
        assert [d.code.name for d in self.report] == [code]
        return next(iter(self.report))


EMPTY = Scope(None, {}, Library(), Report(), None)


def node_of(value: object, span: Span) -> Node:
    """Returns a scalar, or a flat mapping, as a YAML node."""
    if isinstance(value, dict):
        return Node({k: Node(v, span) for k, v in value.items()}, span)
    return Node(value, span)  # type: ignore[arg-type]


def simple(
    signals: str = "{a: {start: 0, length: 8}}",
    *,
    length: int = 8,
    cob_id: int = 0x190,
    kind: str = "pdo",
    period: str = "on_demand",
) -> str:
    return (
        f"{SIMPLE}    a: {{cob_id: {cob_id}, kind: {kind}, direction: report, "
        f"length: {length}, period: {period}, signals: {signals}}}\n"
    )


def frame(bus: Bus, name: str) -> FrameDefinition:
    return next(f for f in bus.frames if f.name == name)


def signal(bus: Bus, frame_name: str, name: str) -> Signal:
    return next(s for s in frame(bus, frame_name).signals if s.name == name)
