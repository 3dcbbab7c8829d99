"""Makes the module of a CAN device from the messages of a node in a DBC file.

``dbc_worker`` reads the file, in a limited process.  Its values are kept; only signals that
thorvaldc knows by name get this name and its unit, see ``_bind``.  Begin with ``module_from_dbc``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from thorvaldc.compiler.bus.device_file import MAX_BYTES, read_contained
from thorvaldc.compiler.source.input_file import read_bytes
from thorvaldc.compiler.source.units import UnitError, parse_unit
from thorvaldc.diagnostics import OutsideError, Report, Span, did_you_mean
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.model import Signal
from thorvaldc.tools.device_files.device_module import (
    DeviceModule,
    ModuleFrame,
    ModuleSignal,
    Names,
    left_out,
    plain_text,
    quoted,
    without_refused,
)

_LONGEST_FRAME = 8  # bytes
_WORKER = f"{__package__}.dbc_worker"


def module_from_dbc(path: Path, node: str, type_name: str, report: Report) -> DeviceModule | None:
    """Returns the module of a node of a DBC file, or ``None`` if the file has errors.

    Reports a note for each part of the file that the module leaves out.

    - ``node``: name of the node; ``Vector__XXX`` has the messages that no node sends or receives.
    - ``type_name``: name of the module type.  Its category tells which signals are bound: those of
      a ``battery``, or of the motor of a ``controller``.

    Raises ``OutsideError`` if cantools is not installed.
    """
    if find_spec("cantools") is None:
        command = install_command("dbc")
        raise OutsideError(f"DBC files require cantools, which is not installed: {command}")
    imports = ("cantools.database",)
    data = read_bytes(path, str(path), report, limit=MAX_BYTES)
    if data is None:
        return None
    content = read_contained(data, str(path), "DBC", _WORKER, report, node, imports)
    if content is None:
        return None
    if not content["messages"]:
        nodes = content["nodes"]
        hint = did_you_mean(node, nodes, f"the file has {', '.join(nodes) or 'no nodes'}")
        text = f"no message of `{path}` is sent or received by a node `{node}`"
        report.add("import-missing", text, Span(str(path)), hint=hint)
        return None
    device = _device(content, f"{path.name}, node {node}", str(path), type_name, report)
    without_refused(device, report)
    if not any(frame.signals for frame in device.frames):
        text = f"no signal of the node `{node}` can be expressed in a module"
        report.add("import-missing", text, Span(str(path)))
        return None
    _bind(device)
    return device


def _device(
    content: dict[str, Any], source: str, file: str, type_name: str, report: Report
) -> DeviceModule:
    protocol = type_name.rpartition("/")[2]
    can = {"protocol": protocol, "id_space": protocol, "ids": "[1, 1]"}
    if (bitrate := content["bitrate"]) and bitrate > 0:
        can["bitrates"] = f"[{_number(bitrate / 1000)} kbit/s]"
    frames, names, known = [], Names(), set[tuple[int, bool]]()
    for message in content["messages"]:
        span = _line(file, message["line"])
        key = (message["id"], message["extended"])
        if message["length"] > _LONGEST_FRAME:
            reason = f"it has {message['length']} bytes, a CAN frame has at most {_LONGEST_FRAME}"
            left_out(report, f"the message `{message['name']}`", reason, span)
        elif key in known:
            reason = f"another message has the identifier {key[0]:#x}"
            left_out(report, f"the message `{message['name']}`", reason, span)
        else:
            known.add(key)
            signals = [*_signals(message, file, report)]
            name = names.make(message["name"], "frame")
            frames.append(ModuleFrame(name, _frame_keys(message), signals, span))
    comments = [
        f"Made from {source}. The file has fixed identifiers, so that a bus has one such device.",
        "A driver of this protocol is a package (docs/batteries.md, docs/motor-controllers.md).",
    ]
    return DeviceModule(type_name, f"CAN device of {source}.", can, frames, comments=comments)


def _line(file: str, line: int) -> Span:
    return Span(file, line, 1, line, 2)


def _frame_keys(message: dict[str, Any]) -> dict[str, str]:
    period, is_report = message["period"], message["is_report"]
    is_time = isinstance(period, int | float) and math.isfinite(period) and period > 0
    return {
        "description": quoted(f"{message['name']}. {message['comment']}"),
        "cob_id": f"{message['id']:#x}",
        **({"extended": "true"} if message["extended"] else {}),
        # A missing report is a fault of the robot only where its driver says so.
        "kind": "broadcast" if is_report else "pdo",
        "direction": "report" if is_report else "command",
        "length": str(message["length"]),
        "period": f"{_number(float(period))} ms" if is_time else "on_demand",
    }


def _signals(message: dict[str, Any], file: str, report: Report) -> Iterator[ModuleSignal]:
    """Yields the signals of a message that has at most one multiplexer which nothing selects."""
    selectors = [s["name"] for s in message["signals"] if s["multiplexer"] and not s["selector"]]
    names = Names()
    for signal in message["signals"]:
        span, name = _line(file, signal["line"]), signal["name"]
        selector = signal["selector"] or (name if signal["multiplexer"] else None)
        if selector is not None and selector not in selectors[:1]:
            reason = f"it belongs to the multiplexer `{selector}`; a frame has one multiplexer"
            left_out(report, f"the signal `{message['name']}.{name}`", reason, span)
            continue
        low, high = Signal("", 0, signal["length"], signal["signed"]).raw_range
        for raw, text in [*signal["choices"]]:
            if not low <= raw <= high:
                signal["choices"].remove([raw, text])
                reason = f"it is {raw}; `{name}` has the range {low} to {high}"
                left_out(report, f"the choice `{plain_text(text)}`", reason, span)
        keys = _signal_keys(signal, message["is_report"])
        if keys is None:
            reason = "its scale or offset is not finite"
            left_out(report, f"the signal `{message['name']}.{name}`", reason, span)
            continue
        yield ModuleSignal(names.make(name, "signal"), keys, span)


def _signal_keys(signal: dict[str, Any], is_report: bool) -> dict[str, str] | None:
    """Returns the YAML text of the keys of a signal, or ``None`` if its numbers are not finite."""
    scale, offset = float(signal["scale"]), float(signal["offset"])
    if not (math.isfinite(scale) and math.isfinite(offset)):
        return None
    keys = {"start": str(signal["start"]), "length": str(signal["length"])}
    for flag in ("big_endian", "signed", "floating_point"):
        if signal[flag] and not (flag == "signed" and signal["floating_point"]):
            keys[flag] = "true"
    if signal["unit"].strip():
        keys["unit"] = quoted(signal["unit"])
    keys |= _scaling(scale, offset)
    limits = [signal["minimum"], signal["maximum"]]
    if not is_report and None not in limits:
        low, high = map(float, limits)
        if math.isfinite(low) and math.isfinite(high) and low < high:
            keys |= {"minimum": _number(low), "maximum": _number(high)}
    if signal["multiplexer"] and not signal["selector"]:
        keys["multiplexer"] = "true"
    if signal["selector"]:
        keys["selected_by"] = str(signal["selected_by"])
    if signal["choices"] and not signal["floating_point"]:
        names = Names()
        choices = ", ".join(
            f"{names.make(text, 'value')}: {raw}" for raw, text in signal["choices"]
        )
        keys["choices"] = f"{{{choices}}}"
    keys["description"] = quoted(f"{signal['name']}. {signal['comment']}")
    return keys


def _number(value: float) -> str:
    """Returns the shortest text of a number that reads back equal."""
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


def _scaling(scale: float, offset: float) -> dict[str, str]:
    return {
        **({"scale": _number(scale)} if scale != 1.0 else {}),
        **({"offset": _number(offset)} if offset else {}),
    }


# -- signals that thorvaldc knows ----------------------------------------------------------


class Known(NamedTuple):
    """A quantity that drivers read by the name of its signal.

    - ``name``, ``unit``: name and unit of the signal of a module.
    - ``words``: expression for the names of such signals.
    - ``comment``: what a file cannot tell, above the signal.
    """

    name: str
    unit: str
    words: str
    comment: str = ""


_BATTERY = (
    Known("voltage", "V", r"volt"),
    Known(
        "current",
        "A",
        r"curr|amp",
        "Positive while the battery discharges? If not, change the signs of scale and offset.",
    ),
    Known("state_of_charge", "%", r"(^|_)soc(_|$)|state_?of_?charge"),
    Known("state_of_health", "%", r"(^|_)soh(_|$)|state_?of_?health"),
)
# Signals of a part of the battery, or that are limits or requests.
_NOT_BATTERY = r"cell|min|max|limit|high|low|charger|request|req_|set|target|avg|mean|peak|module"
_VELOCITY = Known("velocity", "rad/s", r"speed|vel|rpm")
_NOT_MOTOR = r"min|max|limit|erpm|electr|avg|mean|error"
_UNITS = {"volt": "V", "volts": "V", "amp": "A", "amps": "A", "1/min": "rpm", "u/min": "rpm"}


def _bind(device: DeviceModule) -> None:
    """Names the signals that drivers of batteries or motor controllers read, where one alone fits.

    What is ambiguous stays as it is in the file, and is named in a comment of the module.
    """
    category = device.type.partition("/")[0]
    reports = [frame for frame in device.frames if frame.keys["direction"] == "report"]
    if category == "battery":
        device.add_battery()
        for known in _BATTERY:
            _bind_one(device, reports, known, _NOT_BATTERY, _in_unit)
    elif category == "controller":
        commands = [frame for frame in device.frames if frame not in reports]
        motors = [
            _bind_one(device, frames, _VELOCITY._replace(name=name), _NOT_MOTOR, _of_motor)
            for frames, name in ((reports, "velocity"), (commands, "velocity_command"))
        ]
        if any(motors):
            _set_required(reports)
            device.sections["channels"] = "{motor: {role: propulsion}}"


def _set_required(reports: Sequence[ModuleFrame]) -> None:
    """Makes the absence of a report of a motor a fault of the robot."""
    for frame in reports:
        if any("channel" in signal.keys for signal in frame.signals):
            frame.keys["kind"] = "pdo"


Convert = Callable[[ModuleSignal, Known, float], bool]


def _bind_one(
    device: DeviceModule, frames: Sequence[ModuleFrame], known: Known, others: str, convert: Convert
) -> bool:
    """Binds the only signal that fits, or adds a comment with all that do.

    - ``others``: expression for the names of signals that are something else.
    - ``convert``: changes the keys of the signal, or returns ``False`` if this is ambiguous.
    """
    candidates = [
        (frame, signal, factor)
        for frame in frames
        for signal in frame.signals
        if re.search(known.words, signal.name) and not re.search(others, signal.name)
        for factor in [_factor(signal.keys.get("unit", ""), known.unit)]
        if factor is not None
    ]
    shown = ", ".join(f"{frame.name}.{signal.name}" for frame, signal, _ in candidates)
    if len(candidates) != 1:
        reason = f"one of {shown}" if candidates else "none by unit and name"
        device.comments.append(f"`{known.name}` in {known.unit} is not bound: {reason}.")
        return False
    frame, signal, factor = candidates[0]
    if not convert(signal, known, factor):
        text = f"`{known.name}` is not bound: of motor or wheel? {shown}."
        device.comments.append(text)
        return False
    if all(other.name != known.name for other in frame.signals):
        signal.name = known.name
    if known.comment:
        signal.comments.append(known.comment)
    return True


def _factor(unit: str, known: str) -> float | None:
    """Returns how many of the unit ``known`` one of ``unit`` is, or ``None`` if it is no such unit.

    ``unit``: YAML text of the unit of a signal.
    """
    unit = unit.strip('"')
    if known == "%":
        return 1.0 if unit == "%" else None
    try:
        own, other = parse_unit(_UNITS.get(unit.lower(), unit)), parse_unit(known)
    except UnitError:
        return None
    if own.dimension != other.dimension or own.offset:
        return None
    return own.numerator / own.denominator * math.pi**own.pi_power


def _in_unit(signal: ModuleSignal, known: Known, factor: float) -> bool:
    scale, offset = (float(signal.keys.pop(key, default)) for key, default in _DEFAULTS)
    signal.keys |= {"unit": quoted(known.unit), **_scaling(scale * factor, offset * factor)}
    return True


_DEFAULTS = (("scale", "1"), ("offset", "0"))


def _of_motor(signal: ModuleSignal, known: Known, factor: float) -> bool:
    """Converts a speed to that of the joint, if the name tells whether it is of motor or wheel."""
    is_motor = bool(re.search(r"motor|rotor|shaft", signal.name))
    if is_motor is bool(re.search(r"wheel|axle", signal.name)):
        return False
    _in_unit(signal, known, factor)
    for key in ("scale", "offset") if is_motor else ():
        if key in signal.keys or key == "scale":
            signal.keys[key] = f'"${{{signal.keys.get(key, "1")} / motor.gear_ratio}}"'
    signal.keys.pop("minimum", None)
    signal.keys.pop("maximum", None)
    signal.keys["channel"] = "motor"
    return True
