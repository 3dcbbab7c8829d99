"""The build target `can`: files for programs that use, set up or check the robot's CAN buses.

The page docs/canmap.md describes the files of the `can` target. The backend reads all node ids,
COB-IDs, scalings, object dictionary entries and response times from the model. The C header and
the script that sets up CAN interfaces (Linux, SocketCAN) are below, the other files beside.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from thorvaldc.backends import Backend
from thorvaldc.backends.can import canmap, canopen_files, dbc
from thorvaldc.diagnostics import Diagnostic
from thorvaldc.model import Bus, FrameDefinition, Robot, Signal

C_GUARD = "ROBOT_CAN_H"
C_LEGEND = """\
 * Names: ROBOT_CAN_<bus>_<frame>_..., and ROBOT_CAN_<bus>_<frame>_<signal>_... for its signals.
 * {order}; value = raw * SCALE + OFFSET, in the unit that is said beside. START and BITS
 * are in bits, periods in microseconds (0: on demand); IS_... are raw values with a name.
"""
SCRIPT_HEAD = """\
#!/bin/sh
# Sets the CAN interfaces of {robot} up:
#   sh bring_up.sh{usage}
# Made by thorvaldc; changes are lost. Never tried on physical hardware.
set -eu

set_up() {{
  bus=$1 interface=$2 bitrate=$3
  if [ ! -e "/sys/class/net/$interface" ]; then
    echo "error: there is no interface $interface for the bus $bus" >&2
    exit 3
  fi
  ip link set dev "$interface" down
  # restart-ms 0: after bus-off the interface stays down until somebody has looked for the cause.
  ip link set dev "$interface" type can bitrate "$bitrate" restart-ms 0
  ip link set dev "$interface" txqueuelen 128
  ip link set dev "$interface" up
  echo "$bus: $interface, $bitrate bit/s"
}}

if [ "$(id -u)" -ne 0 ]; then
  echo "error: only root may set up an interface; try: sudo sh $0" >&2
  exit 3
fi
if [ $# -gt {count} ]; then
  echo "error: {count_words} to name, {usage_words}" >&2
  exit 2
fi

"""


class Can(Backend):
    name = "can"
    summary = "CAN map, DBC, DCF of each node, C header, load of the bus, set-up of interfaces"

    def emit(self, robot: Robot) -> dict[str, bytes]:
        files = {"can/canmap.json": canmap.canmap_text(robot).encode()}
        if not robot.buses:
            return files
        alone = len(robot.buses) == 1
        for bus in robot.buses:
            path = "can/robot.dbc" if alone else f"can/{bus.name}.dbc"
            text = dbc.dbc_text(bus)
            # ASCII is part of the encoding, and its codec is much faster.
            files[path] = text.encode("ascii" if text.isascii() else dbc.ENCODING, "replace")
            for node in bus.described_nodes:
                files[f"can/dcf/{node.name}.dcf"] = canopen_files.dcf_text(bus, node).encode(
                    "ascii"
                )
            if bus.described_nodes:
                path = "can/bus.yml" if alone else f"can/{bus.name}.bus.yml"
                files[path] = canopen_files.bus_yml(bus).encode()
        files["can/robot_can.h"] = _c_header(robot).encode("ascii", "replace")
        files["can/budget.json"] = canmap.budget_json(robot).encode()
        files["can/budget.md"] = canmap.budget_table(robot).encode()
        files["can/bring_up.sh"] = _bring_up_script(robot).encode()
        return files

    def unsupported(self, robot: Robot) -> Iterable[Diagnostic]:
        for bus in robot.buses:
            yield from dbc.lost_texts(bus)


def _c_header(robot: Robot) -> str:
    """Return the C header of a robot's CAN buses as text. The C header contains only macros and
    works in C and C++."""
    signals = [s for bus in robot.buses for frame in bus.frames for s in frame.signals]
    big = any(signal.big_endian for signal in signals)
    legend = C_LEGEND.format(order=f"Little endian{' without ..._BIG_ENDIAN' if big else ''}")
    lines = [f"/* The buses of {robot.name}. Made by thorvaldc; changes are lost.\n *\n{legend} */"]
    lines += [f"#ifndef {C_GUARD}", f"#define {C_GUARD}"]
    taken: dict[str, int] = {}
    for bus in robot.buses:
        for name, value, comment in _macros(bus):
            if name:
                name = _unique(f"ROBOT_CAN_{bus.name}_{name}".upper(), taken)
                lines.append(f"#define {name} {value}" + (f" /* {comment} */" if comment else ""))
            else:
                lines.append(f"\n/* {comment} */")
    lines.append(f"\n#endif /* {C_GUARD} */")
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
        yield from _frame_macros(frame)


def _frame_macros(frame: FrameDefinition) -> Iterator[tuple[str, str, str]]:
    to = ", ".join(frame.consumers)
    yield "", "", f"{frame.name}: {frame.producer} to {to if len(to) < 60 else 'all'}"
    yield f"{frame.name}_cob_id", f"0x{frame.cob_id:03X}u", ""
    if frame.extended:
        yield f"{frame.name}_extended", "1u", "29 bits; 11 without this macro"
    yield f"{frame.name}_length", f"{frame.length}u", "bytes"
    yield f"{frame.name}_period", f"{round((frame.period or 0.0) * 1e6)}ul", "us"
    for signal in frame.signals:
        yield from _signal_macros(frame.name, signal)


def _signal_macros(frame: str, signal: Signal) -> Iterator[tuple[str, str, str]]:
    name = f"{frame}_{signal.name}"
    kind = "floating point" if signal.floating_point else "signed" if signal.signed else "unsigned"
    about = f", joint {signal.joint}" if signal.joint is not None else ""
    yield f"{name}_start", f"{signal.start}u", ""
    if signal.big_endian:
        yield f"{name}_big_endian", "1u", "START is the most significant bit, numbered as in a DBC"
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


def _bring_up_script(robot: Robot) -> str:
    """Return the POSIX shell script that sets up the CAN interfaces.

    The default names of the CAN interfaces are can0, can1, and so on.
    """
    names = [bus.name for bus in robot.buses]
    usage = "".join(f" [interface of {name}]" for name in names)
    text = SCRIPT_HEAD.format(
        robot=robot.name,
        usage=usage,
        usage_words=", ".join(f"that of {name}" for name in names),
        count=len(names),
        count_words="there is one interface"
        if len(names) == 1
        else f"there are {len(names)} interfaces",
    )
    for i, bus in enumerate(robot.buses):
        text += f'set_up {bus.name} "${{{i + 1}:-can{i}}}" {bus.bitrate}\n'
    return text
