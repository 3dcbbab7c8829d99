"""A DBC file of a CAN bus, for tools that read the DBC format.

The sections, their order and their spaces are those of files that the Python package cantools
writes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import NamedTuple

from thorvaldc.diagnostics import CODES, Diagnostic
from thorvaldc.model import Bus, FrameDefinition, Signal
from thorvaldc.model.bus import MASTER

ENCODING = "cp1252"  # the encoding that readers of DBC files assume
LONGEST_NAME = 32  # characters of a name in a DBC file; an attribute contains a longer name
SYMBOLS = (
    "NS_DESC_ CM_ BA_DEF_ BA_ VAL_ CAT_DEF_ CAT_ FILTER BA_DEF_DEF_ EV_DATA_ ENVVAR_DATA_ SGTYPE_ "
    "SGTYPE_VAL_ BA_DEF_SGTYPE_ BA_SGTYPE_ SIG_TYPE_REF_ VAL_TABLE_ SIG_GROUP_ SIG_VALTYPE_ "
    "SIGTYPE_VALTYPE_ BO_TX_BU_ BA_DEF_REL_ BA_REL_ BA_DEF_DEF_REL_ BU_SG_REL_ BU_EV_REL_ "
    "BU_BO_REL_ SG_MUL_VAL_"
)
LONG_NODE, LONG_FRAME = "SystemNodeLongSymbol", "SystemMessageLongSymbol"
LONG_SIGNAL, CYCLE_TIME, BAUDRATE = "SystemSignalLongSymbol", "GenMsgCycleTime", "Baudrate"
# Definition and default value of each attribute. BU_ is a node, BO_ a frame and SG_ a signal.
ATTRIBUTES = {
    LONG_NODE: ('BU_  "SystemNodeLongSymbol" STRING ', '""'),
    LONG_FRAME: ('BO_  "SystemMessageLongSymbol" STRING ', '""'),
    LONG_SIGNAL: ('SG_  "SystemSignalLongSymbol" STRING ', '""'),
    CYCLE_TIME: ('BO_  "GenMsgCycleTime" INT 0 65535', "0"),  # ms
    BAUDRATE: (' "Baudrate" INT 0 10485760', "125000"),  # bit/s
}


def lost_texts(bus: Bus) -> Iterator[Diagnostic]:
    """Yield a diagnostic for each CAN frame whose texts a DBC file cannot encode."""
    for frame in bus.frames:
        texts = [frame.description]
        for signal in frame.signals:
            texts += (signal.description, signal.unit)
        text = "".join(texts)
        missing = [] if text.isascii() else [c for c in dict.fromkeys(text) if not _in_dbc(c)]
        if missing:
            yield Diagnostic(
                CODES["dbc-text"],
                f"the texts of `{frame.name}` have characters that a DBC file cannot "
                f"hold: {' '.join(missing[:8])}",
                frame.span,
                "they are `?` there; the CAN map has them all",
            )


def _in_dbc(character: str) -> bool:
    try:
        character.encode(ENCODING)
    except UnicodeEncodeError:
        return False
    return True


class _Names(NamedTuple):
    """The name in the DBC file of each node and frame, and of the signals of each frame."""

    nodes: dict[str, str]
    frames: dict[str, str]
    signals: dict[str, dict[str, str]]


def dbc_text(bus: Bus) -> str:
    """Return the DBC file of a CAN bus as text."""
    names = _Names(
        _short_names([MASTER, *(node.name for node in bus.nodes)]),
        _short_names(frame.name for frame in bus.frames),
        {frame.name: _short_names(s.name for s in frame.signals) for frame in bus.frames},
    )
    attributes = list(_attributes(bus, names))
    used = {attribute for attribute, _ in attributes}
    definitions = [ATTRIBUTES[attribute] for attribute in ATTRIBUTES if attribute in used]
    defaults = [(name, ATTRIBUTES[name][1]) for name in ATTRIBUTES if name in used]
    sections = [
        ['VERSION ""', "", ""],
        ["NS_ : ", *(f"\t{symbol}" for symbol in SYMBOLS.split()), ""],
        ["BS_:", ""],
        [f"BU_: {' '.join(names.nodes.values())}", "", ""],
        [*_frames(bus, names), "", "", "", ""],
        _comments(bus, names),
        [f"BA_DEF_ {definition};" for definition, _ in definitions],
        [f'BA_DEF_DEF_  "{name}" {default};' for name, default in defaults],
        [f'BA_ "{name}" {value};' for name, value in attributes],
        list(_choices(bus, names)) or [""],
        list(_floating_point(bus, names)) or [""],
        [""],
        list(_selections(bus, names)) or [""],
    ]
    return "".join(f"{line}\r\n" for section in sections for line in section)


def _short_names(names: Iterable[str]) -> dict[str, str]:
    """Return the name in the DBC file of each name. A name that is too long is cut, and numbered
    if another name is cut to the same text."""
    names = list(names)
    short_names: dict[str, str] = {}
    for name in sorted(names, key=lambda name: (len(name), name)):
        short, number = name[:LONGEST_NAME], 0
        while short in short_names.values():
            short = f"{short[:27]}_{number:04d}"
            number += 1
        short_names[name] = short
    return {name: short_names[name] for name in names}


def _frames(bus: Bus, names: _Names) -> Iterator[str]:
    for i, frame in enumerate(bus.frames):
        if i:
            yield ""
        sender = names.nodes[frame.producer]
        yield f"BO_ {frame.key} {names.frames[frame.name]}: {frame.length} {sender}"
        receivers = ",".join(names.nodes[name] for name in frame.consumers)
        for signal in frame.signals:
            name = names.signals[frame.name][signal.name]
            low, high = _limits(signal)
            order = f"{0 if signal.big_endian else 1}{'-' if signal.signed else '+'}"
            yield (
                f" SG_ {name}{_multiplexing(signal)} : {signal.start}|{signal.length}"
                f"@{order} ({_number(signal.scale)},"
                f'{_number(signal.offset)}) [{low}|{high}] "{_plain(signal.unit)}" '
                + (f" {receivers}" if receivers else "Vector__XXX")
            )


def _multiplexing(signal: Signal) -> str:
    if signal.multiplexer:
        return " M"
    return f" m{signal.selected_by[0]}" if signal.selected_by else ""


def _by_start(frame: FrameDefinition) -> list[Signal]:
    """Return the signals of a frame in the order of comments and attributes: last bits first."""
    return sorted(frame.signals, key=lambda signal: signal.start)[::-1]


def _comments(bus: Bus, names: _Names) -> Iterator[str]:
    yield 'CM_ BU_ master "Master of the bus: the base driver.";'
    for node in bus.nodes:
        text = _plain(f"{node.module}: {node.protocol}, id {node.id} of {node.id_space}")
        yield f'CM_ BU_ {names.nodes[node.name]} "{text}";'
    for frame in bus.frames:
        text = _plain(frame.description)
        if text:
            yield f'CM_ BO_ {frame.key} "{text}";'
        for signal in _by_start(frame):
            joint = f" Joint {signal.joint}." if signal.joint is not None else ""
            text = _plain(signal.description + joint)
            if text:
                name = names.signals[frame.name][signal.name]
                yield f'CM_ SG_ {frame.key} {name} "{text}";'


def _attributes(bus: Bus, names: _Names) -> Iterator[tuple[str, str]]:
    """Yield the name of each attribute, and its object and value as in the DBC file."""
    yield BAUDRATE, f"{bus.bitrate}"
    for long, short in names.nodes.items():
        if long != short:
            yield LONG_NODE, f'BU_ {short} "{long}"'
    for frame in bus.frames:
        if names.frames[frame.name] != frame.name:
            yield LONG_FRAME, f'BO_ {frame.key} "{frame.name}"'
        if frame.period:
            # The attribute contains whole milliseconds; canmap.json contains the exact period.
            cycle_time = max(1, min(round(frame.period * 1000), 0xFFFF))
            yield CYCLE_TIME, f"BO_ {frame.key} {cycle_time}"
        for signal in _by_start(frame):
            short = names.signals[frame.name][signal.name]
            if short != signal.name:
                yield LONG_SIGNAL, f'SG_ {frame.key} {short} "{signal.name}"'


def _choices(bus: Bus, names: _Names) -> Iterator[str]:
    for frame in bus.frames:
        for signal in _by_start(frame):
            if signal.choices:
                texts = " ".join(f'{raw} "{_plain(text)}"' for raw, text in signal.choices)
                yield f"VAL_ {frame.key} {names.signals[frame.name][signal.name]} {texts} ;"


def _floating_point(bus: Bus, names: _Names) -> Iterator[str]:
    for frame in bus.frames:
        for signal in frame.signals:
            if signal.floating_point:
                precision = {32: 1, 64: 2}[signal.length]  # single or double
                name = names.signals[frame.name][signal.name]
                yield f"SIG_VALTYPE_ {frame.key} {name} : {precision};"


def _selections(bus: Bus, names: _Names) -> Iterator[str]:
    """Yield the ranges of multiplexer values of all signals, if one of them has several values."""
    if all(len(signal.selected_by) <= 1 for frame in bus.frames for signal in frame.signals):
        return
    for frame in bus.frames:
        short = names.signals[frame.name]
        selector = next((short[s.name] for s in frame.signals if s.multiplexer), None)
        for signal in frame.signals:
            if signal.selected_by:
                ranges = ", ".join(_ranges(signal.selected_by))
                yield f"SG_MUL_VAL_ {frame.key} {short[signal.name]} {selector} {ranges};"


def _ranges(values: Iterable[int]) -> Iterator[str]:
    """Yield the ranges of successive integers, such as ``1-3`` and ``5-5`` for 1, 2, 3 and 5."""
    for _, group in groupby(enumerate(sorted(values)), lambda item: item[1] - item[0]):
        run = [value for _, value in group]
        yield f"{run[0]}-{run[-1]}"


def _limits(signal: Signal) -> tuple[float, float]:
    """Return the minimum and maximum of a CAN signal, or 0 for both if the signal has no limits.

    The DBC format cannot omit only one limit of a signal. A missing limit of a signal is therefore
    computed from the length of the signal in bits.
    """
    if signal.minimum is None and signal.maximum is None:
        return 0, 0
    ends = sorted(raw * signal.scale + signal.offset for raw in signal.raw_range)
    return (
        ends[0] if signal.minimum is None else signal.minimum,
        ends[1] if signal.maximum is None else signal.maximum,
    )


def _number(value: float) -> float | int:
    return round(value) if value.is_integer() else value


def _plain(text: str) -> str:
    """Return the text on one line, without quotes and backslashes, which DBC strings cannot
    contain."""
    return " ".join(text.replace("\\", "/").replace('"', "'").split())
