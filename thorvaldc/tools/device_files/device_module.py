"""The module of a CAN device: what a file of others says of its frames, as text of a module.yaml.

``without_refused`` leaves out what the compiler refuses, by the checks of the compiler itself.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from thorvaldc.compiler.bus.device_frames import frames_of
from thorvaldc.compiler.bus.device_sections import Device
from thorvaldc.compiler.modules.library import FILE, Library, ModuleType
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.scaffolding import SCHEMA
from thorvaldc.compiler.source.node import Node, yaml_text
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.validation.schema_diagnostics import similar_name
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model.bus import CANOPEN

_LONGEST_NAME = 56  # a number may follow
_LONGEST_TEXT = 300
CYCLE = 0.02  # s; the control cycle with which the frames are checked


@dataclass
class ModuleSignal:
    """A signal: YAML text of its keys, comments above it, and its place in the file of others."""

    name: str
    keys: dict[str, str]
    span: Span
    comments: list[str] = field(default_factory=list)


@dataclass
class ModuleFrame:
    """A frame: YAML text of its keys, its signals, and its place in the file of others."""

    name: str
    keys: dict[str, str]
    signals: list[ModuleSignal]
    span: Span


@dataclass
class DeviceModule:
    """The content of a module of a CAN device.

    - ``type``: name of the module type, such as ``battery/mine``.
    - ``params``: YAML text of parameters beside the mass, by their names.
    - ``sections``: YAML text of further sections of the module, by their names.
    - ``can``: YAML text of the keys of the section ``can`` but ``frames``.
    - ``comments``: what a person must know or decide, at the top of the file.
    - ``files``: bytes of further files of the module, by their names.
    """

    type: str
    description: str
    can: dict[str, str]
    frames: list[ModuleFrame]
    params: dict[str, str] = field(default_factory=dict)
    sections: dict[str, str] = field(default_factory=dict)
    comments: list[str] = field(default_factory=list)
    files: dict[str, bytes] = field(default_factory=dict)

    def add_battery(self) -> None:
        """Adds the section ``battery``, and what a person must state there."""
        self.sections["battery"] = "{present: true, link: housing}"
        nominal = "`battery: {properties: {voltage: 48 V, capacity: 70 Ah}}`"
        self.comments.append(f"State what the file cannot know, as in {nominal}.")

    def usage(self) -> str:
        """Returns the lines of a robot file that use the module.

        A device that is not CANopen has a bus of its own: its identifiers can be those of others.
        """
        entry = {"type": self.type, "mount": "{parent: frame, xyz: [0, 0, 300 mm]}", "can": "auto"}
        if "velocity_unit" in self.params:
            entry["params"] = "{velocity_unit: 1 rpm}"
        if "channels" in self.sections:
            entry["channels"] = "{motor: left.propulsion}"
        lines = []
        if self.can["id_space"] != CANOPEN:
            bus, bitrate = self.can["protocol"], self.can.get("bitrates", "").strip("[]")
            lines.append(f"  buses: {{main: {{}}, {bus}: {{{bitrate and f'bitrate: {bitrate}'}}}}}")
            entry["can"] = f"{{bus: {bus}, id: 1}}"
        keys = ", ".join(f"{key}: {text}" for key, text in entry.items())
        return "\n".join([*lines, "  modules:", f"    device: {{{keys}}}"])


class Names:
    """Makes unique names of a module from the names in a file of others."""

    def __init__(self) -> None:
        self._used: set[str] = set()

    def make(self, text: str, otherwise: str) -> str:
        """Returns a unique name, such as ``pack_voltage`` for ``PackVoltage``.

        ``otherwise``: beginning of the name if ``text`` begins with no letter.
        """
        words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text)[:_LONGEST_NAME]
        name = similar_name(words) or similar_name(f"{otherwise}_{words}") or otherwise
        unique, number = name, 2
        while unique in self._used:
            unique, number = f"{name[:_LONGEST_NAME]}_{number}", number + 1
        self._used.add(unique)
        return unique


def plain_text(text: str) -> str:
    """Returns the text of others on one line, without expressions and without control characters.

    Returns at most 300 characters.
    """
    shown = "".join(c if c.isprintable() else " " for c in text).replace("${", "$ {")
    return " ".join(shown.split())[:_LONGEST_TEXT]


def quoted(text: str) -> str:
    """Returns the YAML text of a text of others."""
    return yaml_text(plain_text(text))


def without_refused(device: DeviceModule, report: Report) -> None:
    """Removes frames and signals that the compiler refuses, and reports a note for each."""
    while True:
        own = Report()
        lines, places = _rendered(device)
        document = read_text("\n".join(lines).encode(), FILE, own)
        if document is None:
            raise ValueError(f"the module is no YAML: {own.errors}")
        list(frames_of(_compiler_device(document, own), 1, CYCLE, own))
        refused = {
            places[error.span.line]: error.message
            for error in own.errors
            if error.span is not None and error.span.line in places
        }
        if not refused:
            return
        for (frame_name, signal_name), message in refused.items():
            frame = next(f for f in device.frames if f.name == frame_name)
            if signal_name:
                signal = next(s for s in frame.signals if s.name == signal_name)
                frame.signals.remove(signal)
                left_out(report, f"the signal `{signal_name}`", message, signal.span)
            else:
                device.frames.remove(frame)
                left_out(report, f"the frame `{frame_name}`", message, frame.span)


def left_out(report: Report, what: str, reason: str, span: Span) -> None:
    """Reports a part of a file of others that the module does not have."""
    report.add("import-left-out", f"{what} is left out: {reason}", span)


def _compiler_device(document: Node, report: Report) -> Device:
    here, can = Span(FILE), document.get("can")
    if can is None:
        raise ValueError("a module of a device has a section `can`")
    library = Library()
    scope = Scope(ModuleType("", Path(), FILE, document), {}, library, report, None)
    scope = scope.with_names({"id": 1, "cycle": CYCLE}, {})
    return Device("device", "device", can, document.get("channels"), (), None, scope, here)


def module_text(device: DeviceModule) -> str:
    """Returns the text of the module.yaml."""
    return "\n".join(_rendered(device)[0]) + "\n"


def _rendered(device: DeviceModule) -> tuple[list[str], dict[int, tuple[str, str]]]:
    """Returns the lines of the module, and the names (frame, signal) by number of the line.

    The name of the signal is empty in the lines of the frame itself.
    """
    lines = [*"\n".join(_head(device)).split("\n"), "  frames:"]
    places: dict[int, tuple[str, str]] = {}
    for frame in device.frames:
        first = len(lines) + 1
        lines.append(f"    {frame.name}:")
        lines += [f"      {key}: {text}" for key, text in frame.keys.items()]
        places |= dict.fromkeys(range(first, len(lines) + 1), (frame.name, ""))
        if frame.signals:
            lines.append("      signals:")
        for signal in frame.signals:
            lines += [f"        # {plain_text(comment)}" for comment in signal.comments]
            keys = ", ".join(f"{k}: {v}" for k, v in sorted(signal.keys.items(), key=_is_text))
            lines.append(f"        {signal.name}: {{{keys}}}")
            places[len(lines)] = (frame.name, signal.name)
    if not device.frames:
        lines[-1] += " {}"
    return lines, places


def _is_text(entry: tuple[str, str]) -> bool:
    return entry[0] == "description"


def _head(device: DeviceModule) -> Iterator[str]:
    yield f"# yaml-language-server: $schema={'../' * (device.type.count('/') + 1)}{SCHEMA}"
    yield "thorvaldc: 1"
    yield f"description: {quoted(device.description)}"
    yield from (f"# {plain_text(comment)}" for comment in device.comments)
    yield from """\
params:
  mass:
    quantity: mass
    default: 1 kg
    minimum: 0.01 kg
    description: Mass of the device.
    source: "estimated: weigh yours, and write the source here\"""".splitlines()
    yield from (f"  {name}: {text}" for name, text in device.params.items())
    yield from """\
mount: {kinds: [frame_clamp, sensor_mount], link: housing, xyz: [0, 0, 0], optional: true}
links:
  housing:
    parts:
      - shape: {box: [120 mm, 80 mm, 40 mm]}
        xyz: [0, 0, 20 mm]
        mass: ${mass}
        source: "estimated: measure yours\"""".splitlines()
    yield from (f"{name}: {text}" for name, text in device.sections.items())
    yield "can:"
    yield from (f"  {key}: {text}".replace(": \n", ":\n") for key, text in device.can.items())
