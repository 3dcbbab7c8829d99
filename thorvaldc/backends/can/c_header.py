"""A C header with the node ids, COB-IDs and signal scales of the CAN buses, for firmware and
tools."""

from __future__ import annotations

from collections.abc import Iterator

from thorvaldc.model import Bus, FrameDefinition, Robot, Signal

GUARD = "ROBOT_CAN_H"
LEGEND = """\
 * Names: ROBOT_CAN_<bus>_<frame>_..., and ROBOT_CAN_<bus>_<frame>_<signal>_... for its signals.
 * Little endian; value = raw * SCALE + OFFSET, in the unit that is said beside. START and BITS
 * are in bits, periods in microseconds (0: on demand); IS_... are raw values with a name.
"""


def header_text(robot: Robot) -> str:
    """Return the C header of a robot's CAN buses as text. The C header contains only macros and
    works in C and C++."""
    lines = [f"/* The buses of {robot.name}. Made by thorvaldc; changes are lost.\n *\n{LEGEND} */"]
    lines += [f"#ifndef {GUARD}", f"#define {GUARD}"]
    taken: dict[str, int] = {}
    for bus in robot.buses:
        for name, value, comment in _macros(bus):
            if name:
                name = _unique(f"ROBOT_CAN_{bus.name}_{name}".upper(), taken)
                lines.append(f"#define {name} {value}" + (f" /* {comment} */" if comment else ""))
            else:
                lines.append(f"\n/* {comment} */")
    lines.append(f"\n#endif /* {GUARD} */")
    return "\n".join(lines) + "\n"


def _unique(name: str, taken: dict[str, int]) -> str:
    """Return the name of a C macro, with a number appended if ``taken`` already contains the name.

    Different CAN signals can have the same macro name: the signal `b_c` of the frame `a` and the
    signal `c` of the frame `a_b`.
    """
    number = taken[name] = taken.get(name, 0) + 1
    return name if number == 1 else _unique(f"{name}_{number}", taken)


def _macros(bus: Bus) -> Iterator[tuple[str, str, str]]:
    """Yield each C macro as (name without the prefix of the bus, value, comment).

    A macro with an empty name is a line of the C header that contains only a comment.
    """
    yield "", "", f"bus {_plain(bus.name)}"
    yield "bitrate", f"{bus.bitrate}ul", "bit/s"
    yield "cycle", f"{round(bus.sync_period * 1e6)}ul", "us"
    yield "master_id", f"{bus.master_id}u", ""
    for node in bus.nodes:
        if node.id_space:
            yield f"{node.name}_id", f"{node.id}u", f"{_plain(node.protocol)}, {node.module}"
    for frame in bus.frames:
        yield from _frame(frame)


def _frame(frame: FrameDefinition) -> Iterator[tuple[str, str, str]]:
    to = ", ".join(frame.consumers)
    yield "", "", f"{frame.name}: {frame.producer} to {to if len(to) < 60 else 'all'}"
    yield f"{frame.name}_cob_id", f"0x{frame.cob_id:03X}u", ""
    yield f"{frame.name}_length", f"{frame.length}u", "bytes"
    yield f"{frame.name}_period", f"{round((frame.period or 0.0) * 1e6)}ul", "us"
    for signal in frame.signals:
        yield from _signal(frame.name, signal)


def _signal(frame: str, signal: Signal) -> Iterator[tuple[str, str, str]]:
    name = f"{frame}_{signal.name}"
    kind = "floating point" if signal.floating_point else "signed" if signal.signed else "unsigned"
    about = f", joint {signal.joint}" if signal.joint is not None else ""
    yield f"{name}_start", f"{signal.start}u", ""
    yield f"{name}_bits", f"{signal.length}u", kind
    yield f"{name}_scale", _number(signal.scale), f"{_plain(signal.unit) or 'no unit'}{about}"
    if signal.offset:
        yield f"{name}_offset", _number(signal.offset), _plain(signal.unit)
    for raw, choice in signal.choices:
        yield f"{name}_is_{choice}", f"({raw})" if raw < 0 else str(raw), ""


def _number(value: float) -> str:
    return f"({value!r})" if value < 0 else repr(value)


def _plain(text: str) -> str:
    """Return the text without backslashes and without ``/*`` and ``*/``."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/").split())
