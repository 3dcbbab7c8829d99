"""Makes the module of a CANopen device from its EDS or DCF file (CiA 306).

``device_file`` reads the file.  A drive of CiA 402 gets the PDOs that the
driver ``cia402`` needs, if its objects can be mapped; every other device has the PDOs of its file.
The objects of batteries and chargers have the units and names of CiA 418 and 419.
Each value names its object in a comment.  Begin with ``module_from_eds``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from thorvaldc.can.canopen import RPDO, TPDO
from thorvaldc.compiler.bus.device_file import Dictionary, Entry, read_eds
from thorvaldc.compiler.validation.schema_diagnostics import similar_name
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model.bus import CIA_402, OBJECT_TYPES
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

_IDS = {"controller": "[1, 31]", "io": "[32, 47]"}
_OTHER_IDS = "[48, 63]"
_PLAIN_NAME = r"[A-Za-z0-9][A-Za-z0-9._-]{0,70}\.(eds|dcf|EDS|DCF)"
_INVALID, _EXTENDED = 1 << 31, 1 << 29
"""Bits of the COB-ID of a PDO: it is not used, it has 29 bits (CiA 301)."""
_LONGEST_TIME = 0xFFFF  # ms
_PDOS, _MOST_MAPPED = 512, 64
_BITRATES = (10, 20, 50, 125, 250, 500, 800, 1000)  # kbit/s, keys `BaudRate_125` ...
_UNITS = {
    # CiA 402: torque and current per thousand of the rated ones, voltage of the supply in mV.
    (402, 0x6071): ("%", "0.1"),
    (402, 0x6077): ("%", "0.1"),
    (402, 0x6078): ("%", "0.1"),
    (402, 0x6079): ("V", "0.001"),
    # CiA 418 (batteries) and 419 (chargers) have the same objects.  Voltage and temperature are as
    # the driver `canopen_inventus` of Clearpath Robotics reads them; these and the others as in the
    # object dictionary of a public battery firmware (CiA418_Profile.c, 2018): 1/8 degC, 1/8 Ah,
    # 1/1024 V, 1/16 A, 1 %.  The total charge 0x6050 has no fraction there.
    **{
        (profile, index): unit
        for profile in (418, 419)
        for index, unit in {
            0x6010: ("degC", "0.125"),
            0x6050: ("Ah", "1"),
            0x6051: ("Ah", "0.125"),
            0x6052: ("Ah", "0.125"),
            0x6053: ("Ah", "0.125"),
            0x6060: ("V", "0.0009765625"),
            0x6070: ("A", "0.0625"),
            0x6080: ("%", "1"),
            0x6081: ("%", "1"),
        }.items()
    },
}
_BATTERY_NAMES = {
    0x6010: "temperature",
    0x6060: "voltage",
    0x6070: "requested_charge_current",
    0x6081: "state_of_charge",
}
"""Names by which drivers of batteries read the objects of CiA 418."""
_RAW = {0x6400, 0x6401, 0x6402, 0x6410, 0x6411, 0x6412}
"""Analogue inputs and outputs of CiA 401, in counts of the converter of the device."""


def module_from_eds(path: Path, type_name: str, report: Report) -> DeviceModule | None:
    """Returns the module of a CANopen device, or ``None`` if the file has errors.

    Reports a note for each PDO that the module leaves out.
    """
    file = str(path)
    dictionary = read_eds(path, file, report)
    if dictionary is None:
        return None
    is_drive = dictionary.profile == CIA_402
    device = DeviceModule(type_name, "", _can(dictionary, type_name), [])
    copy = path.name if re.fullmatch(_PLAIN_NAME, path.name) else "device.eds"
    device.can["eds"] = f"{copy}  # `check` compares this module with it"
    device.files[copy] = dictionary.data
    name = plain_text(dictionary.info.get("productname", "")) or path.name
    vendor = plain_text(dictionary.info.get("vendorname", ""))
    device.description = f"CANopen device {name}{f' of {vendor}' if vendor else ''}."
    profile = f"profile CiA {dictionary.profile}" if dictionary.profile else "no device profile"
    device.comments.append(f"Made from {path.name} ({profile}). Comments name the objects.")
    device.params |= _params(dictionary, path.name)
    if is_drive and not _has_consumer(dictionary):
        text = "The drive cannot supervise the master: the file has no writable 0x1016:1 (TV534)."
        device.comments.append(text)
    if not (is_drive and _add_drive(device, dictionary)):
        device.frames = [*_frames(dictionary, report)]
        without_refused(device, report)
        _add_profile(device, dictionary)
    if not device.frames:
        text = f"`{file}` has no PDO that a module can have"
        report.add("import-missing", text, Span(file), hint="its PDOs must be valid and mapped")
        return None
    return device


def _can(dictionary: Dictionary, type_name: str) -> dict[str, str]:
    """Returns the keys of the section ``can``: protocol, identity, services, bit rates."""
    category, _, name = type_name.partition("/")
    protocol = "cia402" if dictionary.profile == CIA_402 else name.rpartition("/")[2]
    can = {"protocol": protocol, "id_space": "canopen", "ids": "[1, 127]"}
    can["auto_ids"] = _IDS.get(category, _OTHER_IDS)
    keys = ("vendor_id", "product_code", "revision_number")
    for subindex, key in enumerate(keys, 1):
        value = dictionary.number(0x1018, subindex)
        if value is not None and 0 <= value < 1 << 32:
            can[key] = f"{value:#x}  # 0x1018:{subindex}"
    device_type = dictionary.number(0x1000)
    if device_type is not None and 0 <= device_type < 1 << 32:
        can["device_type"] = f"{device_type:#x}  # 0x1000:0"
    has_identity = all(dictionary.get(0x1018, subindex) for subindex in (1, 2, 3, 4))
    if dictionary.info.get("lss_supported", "0").strip() == "1" and has_identity:
        can["lss"] = "true  # LSS_Supported"
    services = ["sdo"]
    services += ["heartbeat"] if dictionary.get(0x1017) else []
    services += ["emcy"] if dictionary.get(0x1014) else []
    can["canopen"] = f"[{', '.join(services)}]  # 0x1017 and 0x1014"
    if dictionary.get(0x1017):
        can["heartbeat_period"] = "${heartbeat_period}"
    if _has_consumer(dictionary):
        can["heartbeat_consumer_time"] = "${heartbeat_consumer_time}"
    known = [f"{n} kbit/s" for n in _BITRATES if dictionary.info.get(f"baudrate_{n}") == "1"]
    if known:
        can["bitrates"] = f"[{', '.join(known)}]  # BaudRate_..."
    return can


def _has_consumer(dictionary: Dictionary) -> bool:
    consumer = dictionary.get(0x1016, 1)
    return consumer is not None and consumer.is_writable


def _params(dictionary: Dictionary, file: str) -> dict[str, str]:
    params = {}
    if dictionary.get(0x1017):
        period, source = dictionary.number(0x1017) or 0, f"published: {file}, object 0x1017"
        if not 10 <= period <= _LONGEST_TIME:
            period, source = 100, "chosen: the file has no time from 10 ms on in 0x1017"
        params["heartbeat_period"] = (
            f"{{quantity: time, default: {period} ms, minimum: 10 ms, "
            f"description: Time between two heartbeats., source: {quoted(source)}}}"
        )
    if _has_consumer(dictionary):
        params["heartbeat_consumer_time"] = (
            "{quantity: time, default: 500 ms, minimum: 10 ms, description: Silence of the master "
            'after which the device stops by itself., source: "chosen: five of its heartbeats"}'
        )
    return params


# -- PDOs of the file ---------------------------------------------------------------------


def _frames(dictionary: Dictionary, report: Report) -> Iterator[ModuleFrame]:
    for base, is_report in ((0x1400, False), (0x1800, True)):
        for number in range(1, _PDOS + 1):
            index = base + number - 1
            if dictionary.get(index, 1) is None:
                continue
            frame, reason = _frame(dictionary, index, number, is_report)
            if frame is not None:
                yield frame
            else:
                what = f"the PDO of the object 0x{index:04X}"
                left_out(report, what, reason, dictionary.span(index, 1))


def _frame(
    dictionary: Dictionary, index: int, number: int, is_report: bool
) -> tuple[ModuleFrame | None, str]:
    """Returns a PDO, or the reason why a module cannot have it."""
    communication = dictionary.get(index, 1)
    value = communication.fields["value"] if communication is not None else None
    if value is None:
        return None, f"the file has no COB-ID (0x{index:04X}:1)"
    if value[0] & _INVALID:
        return None, f"it is not used (bit 31 of its COB-ID, 0x{index:04X}:1)"
    if value[0] & _EXTENDED:
        return None, f"a PDO of a module has 11 bits (bit 29 of its COB-ID, 0x{index:04X}:1)"
    mapped = [*_mapped(dictionary, index + 0x200)]
    if not mapped:
        return None, f"the file maps no objects (0x{index + 0x200:04X})"
    start, names, mapping, signals = 0, Names(), [], []
    for entry, bits in mapped:
        kind = entry.type
        if "access" not in entry.fields:
            return None, f"the file has no object {entry.shown}, which it contains"
        if kind is None or OBJECT_TYPES[kind][1] != bits:
            return None, f"{entry.shown} has {bits} bits and a type that a module does not have"
        mapping.append(f"[0x{entry.index:04X}, {entry.subindex}, {kind}]")
        signals.append(_signal(dictionary, entry, kind, start, is_report, names))
        start += bits
    transmission = dictionary.number(index, 2)
    synchronous = dictionary.get(0x1005) is not None and 1 <= (transmission or 0) <= 240
    timer = (dictionary.number(index, 5) or 0) if is_report else 0
    timer = timer if timer <= _LONGEST_TIME else 0
    period = "cycle" if synchronous else f"{timer} ms" if timer > 0 else "on_demand"
    keys = {
        "cob_id": f"{_cob_id(dictionary, value)}  # 0x{index:04X}:1",
        "kind": "pdo",
        "pdo": str(number),
        "mapping": f"[{', '.join(mapping)}]  # 0x{index + 0x200:04X}",
        **({"synchronous": f"true  # 0x{index:04X}:2"} if synchronous else {}),
        "direction": "report" if is_report else "command",
        "length": str((start + 7) // 8),
        "period": period + (f"  # 0x{index:04X}:5" if timer > 0 and not synchronous else ""),
    }
    name = f"{'tpdo' if is_report else 'rpdo'}{number}"
    return ModuleFrame(name, keys, signals, dictionary.span(index, 1)), ""


def _mapped(dictionary: Dictionary, index: int) -> Iterator[tuple[Entry, int]]:
    """Yields the entries that a PDO contains, and their lengths in bits."""
    for subindex in range(1, min(dictionary.number(index) or 0, _MOST_MAPPED) + 1):
        value = dictionary.number(index, subindex)
        if value:
            key = (value >> 16 & 0xFFFF, value >> 8 & 0xFF)
            entry = dictionary.get(*key) or Entry(*key, {"type": 0, "name": "", "parent": ""})
            yield entry, value & 0xFF


def _cob_id(dictionary: Dictionary, value: tuple[int, int]) -> str:
    number, nodes = value
    number &= 0x7FF
    if not nodes and dictionary.node_id and number > dictionary.node_id:
        number, nodes = number - dictionary.node_id, 1  # of a DCF, which is for one node id
    return f"${{{number:#x} + id}}" if nodes else f"{number:#x}"


def _signal(
    dictionary: Dictionary, entry: Entry, kind: str, start: int, is_report: bool, names: Names
) -> ModuleSignal:
    fields = entry.fields
    name = " ".join(filter(None, (fields["parent"], fields["name"])))
    keys = {"start": str(start), "length": str(OBJECT_TYPES[kind][1])}
    if kind.startswith("integer"):
        keys["signed"] = "true"
    unit, scale = _UNITS.get((dictionary.profile, entry.index), ("", "1"))
    if unit:
        keys |= {"unit": quoted(unit), "scale": scale}
    low, high = fields["low"], fields["high"]
    if not is_report and low and high and not low[1] and not high[1] and low[0] < high[0]:
        step = float(scale)
        keys |= {"minimum": f"{low[0] * step:.15g}", "maximum": f"{high[0] * step:.15g}"}
    keys["description"] = quoted(f"{entry.shown}, {name}.")
    short = fields["name"] if len(fields["name"]) > 8 or not fields["parent"] else name
    if dictionary.profile == 418:
        is_taken = similar_name(short) in _BATTERY_NAMES.values()  # by an object of the profile
        short = _BATTERY_NAMES.get(entry.index, f"{short} {entry.index:x}" if is_taken else short)
    return ModuleSignal(
        names.make(short, "object"), keys, dictionary.span(entry.index, entry.subindex)
    )


def _add_profile(device: DeviceModule, dictionary: Dictionary) -> None:
    """Adds what a person must state of an IO device or battery, and the section ``battery``."""
    mapped = {
        entry.index
        for base in (0x1600, 0x1A00)
        for index in range(base, base + _PDOS)
        for entry, _ in _mapped(dictionary, index)
    }
    if dictionary.profile == 401 and _RAW & mapped:
        text = "CiA 401 gives analogue values no unit: state `unit` and `scale`, from the manual."
        device.comments.append(text)
    if dictionary.profile == 418:
        text = "CiA 418 has no current of the battery: 0x6070 is what it requests of its charger."
        device.comments.append(text)
        if device.type.startswith("battery/"):
            device.add_battery()


# -- drives of CiA 402 ---------------------------------------------------------------------

_MOTOR = "motor"
_VELOCITY = "${velocity_unit / motor.gear_ratio}"
_Object = tuple[int, str, int, dict[str, str]]
"""Index, name of the signal after that of the channel, length in bits, and further keys."""
_COMMANDS: tuple[_Object, ...] = (
    (0x6040, "controlword", 16, {}),
    (0x6060, "mode_of_operation", 8, {"signed": "true"}),
    (0x60FF, "target_velocity", 32, {"signed": "true", "unit": "rad/s", "scale": _VELOCITY}),
)
_REPORTS: tuple[_Object, ...] = (
    (0x6041, "statusword", 16, {}),
    (0x6061, "mode_of_operation_display", 8, {"signed": "true"}),
    (0x606C, "velocity", 32, {"signed": "true", "unit": "rad/s", "scale": _VELOCITY}),
)
_PER_SECOND = "${motor.max_acceleration * motor.gear_ratio * 1 s / velocity_unit}"
# Index, subindex, name, value: what the drive must hold, as in controller/cia402_propulsion.
_VALUES = (
    (0x6007, 0, "abort_connection_option", "3"),
    (0x605A, 0, "quick_stop_option", "2"),
    (0x605E, 0, "fault_reaction_option", "2"),
    (0x6060, 0, "mode_of_operation", "${mode}"),
    (0x607F, 0, "max_profile_velocity", "${motor.max_velocity * motor.gear_ratio / velocity_unit}"),
    (0x6083, 0, "profile_acceleration", _PER_SECOND),
    (0x6084, 0, "profile_deceleration", _PER_SECOND),
    (0x6085, 0, "quick_stop_deceleration", _PER_SECOND),
)
_MODES = ((3, 2), (9, 8))  # mode of operation, its bit in 0x6502


def _add_drive(device: DeviceModule, dictionary: Dictionary) -> bool:
    """Adds the PDOs and values that the driver ``cia402`` needs for one propulsion motor.

    Returns ``False`` and adds a comment if the device cannot have them.
    """
    missing = []
    for index, _, bits, _ in (*_COMMANDS, *_REPORTS):
        entry = dictionary.get(index)
        kind = entry.type if entry is not None else None
        if entry is None or not entry.fields["mappable"] or kind is None:
            missing.append(f"0x{index:04X} (not mappable)" if entry else f"0x{index:04X} (missing)")
        elif OBJECT_TYPES[kind][1] != bits:
            missing.append(f"0x{index:04X} ({kind})")
    for index, objects in ((0x1600, _COMMANDS), (0x1A00, _REPORTS)):
        places = [dictionary.get(index, number) for number in range(1, len(objects) + 1)]
        if not all(entry is not None and entry.is_writable for entry in places):
            missing.append(f"0x{index:04X} (fewer than {len(places)} writable entries)")
    missing += [] if dictionary.get(0x1005) else ["0x1005 (missing)"]
    supported = dictionary.number(0x6502)
    modes = [mode for mode, bit in _MODES if supported is None or supported >> bit & 1]
    missing += [] if modes else ["0x6502 (neither mode 3 nor 9)"]
    if missing:
        text = f"The driver `cia402` cannot drive it: {', '.join(missing)}."
        device.comments.append(f"{text} The PDOs are those of the file.")
        device.can["protocol"] = device.type.rpartition("/")[2]
        return False
    device.params["mode"] = (
        f"{{type: integer, default: {modes[0]}, choices: {modes}, description: 3 profile velocity "
        'or 9 cyclic synchronous velocity., source: "published: object 0x6502"}'
        if supported is not None
        else "{type: integer, default: 3, choices: [3, 9], description: 3 profile velocity or 9 "
        'cyclic synchronous velocity., source: "chosen: the file has no 0x6502"}'
    )
    device.params["velocity_unit"] = (
        "{quantity: angular_velocity, description: Speed of the motor for 1 in 0x60FF "
        "and 0x606C; 1 rpm or that of one encoder count per second.}"
    )
    device.sections["channels"] = f"{{{_MOTOR}: {{role: propulsion}}}}"
    device.can["objects"] = _values(device, dictionary)
    for name, index, objects in (("rpdo1", 0x1400, _COMMANDS), ("tpdo1", 0x1800, _REPORTS)):
        device.frames.append(_drive_frame(dictionary, name, index, objects))
    device.comments.append("State `velocity_unit`, which no EDS has: the manual of the drive.")
    return True


def _values(device: DeviceModule, dictionary: Dictionary) -> str:
    lines, missing = [], []
    for index, subindex, name, value in _VALUES:
        entry = dictionary.get(index, subindex)
        if entry is None or not entry.is_writable or entry.type is None:
            missing.append(f"0x{index:04X} ({name})")
            continue
        keys = f"index: 0x{index:04X}, type: {entry.type}, value: {_value_text(value)}"
        lines.append(f"\n    motor_{name}: {{{keys}, channel: {_MOTOR}}}")
    if missing:
        device.comments.append(f"The drive has no writable {', '.join(missing)}: set it there.")
    return "".join(lines) or " {}"


def _value_text(text: str) -> str:
    """Returns the YAML text of a value; an expression needs quotes in a flow mapping."""
    return f'"{text}"' if text.startswith("$") else text


def _drive_frame(
    dictionary: Dictionary, name: str, index: int, objects: tuple[_Object, ...]
) -> ModuleFrame:
    start, signals, mapping = 0, [], []
    for number, signal, bits, more in objects:
        keys = {"start": str(start), "length": str(bits), "channel": _MOTOR}
        keys |= {key: _value_text(text) for key, text in more.items()}
        keys["description"] = quoted(f"0x{number:04X}:0.")
        signals.append(ModuleSignal(f"motor_{signal}", keys, dictionary.span(number)))
        entry = dictionary.get(number)
        mapping.append(f"[0x{number:04X}, 0, {entry.type if entry else ''}]")
        start += bits
    is_report = index >= 0x1800
    keys = {
        "cob_id": f"${{{TPDO[0] if is_report else RPDO[0]:#x} + id}}",
        "kind": "pdo",
        "pdo": "1",
        "mapping": f"[{', '.join(mapping)}]",
        "synchronous": "true",
        "direction": "report" if is_report else "command",
        "length": str(start // 8),
        "period": "cycle",
    }
    return ModuleFrame(name, keys, signals, dictionary.span(index, 1))
