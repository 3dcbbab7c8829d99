"""Reads a DBC file with cantools, as the service of a limited worker process.

A request has the name ``node``; its data is the file.  The answer has ``nodes`` (the names of all
nodes that send or receive), ``bitrate`` (bit/s or ``None``), and ``messages``: those that the node
sends or receives, in the order of the file, as dictionaries of plain values.  Instead of these, it
has ``error`` (a reason), ``line`` and ``column`` if cantools cannot read the file.
"""

from __future__ import annotations

import re
from typing import Any

NO_NODE = "Vector__XXX"
"""The name of no node in a DBC file."""
_PLACE = re.compile(r"[Ii]nvalid syntax at line (\d+), column (\d+)")


def answer(request: dict[str, Any], data: bytes) -> tuple[dict[str, Any], bytes]:
    """Reads the file of a request, see ``worker_protocol``."""
    from cantools.database import load_string

    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", "replace")  # the encoding that the format had at first
    try:
        database: Any = load_string(text, "dbc", strict=False, sort_signals=None)
        return _content(database, request["node"], _lines(text)), b""
    except MemoryError:
        raise
    except Exception as error:  # cantools raises many types of exceptions for a damaged file
        return _error(error, _lines(text)), b""


def _error(error: Exception, lines: dict[str, int]) -> dict[str, Any]:
    reason = " ".join(str(error).split()).removeprefix("DBC: ").strip('"')
    if place := _PLACE.match(reason):
        line, column = map(int, place.groups())
        return {"error": "invalid syntax", "line": line, "column": column}
    message = re.search(r" in message (\w+)", reason)
    line = lines.get(message[1], 1) if message else 1
    return {"error": reason[:300] or type(error).__name__, "line": line, "column": 1}


def _lines(text: str) -> dict[str, int]:
    """Returns the line of each message, and of each signal as ``message.signal``."""
    lines: dict[str, int] = {}
    message = ""
    for number, line in enumerate(text.splitlines(), 1):
        if start := re.match(r"\s*BO_\s+\d+\s+(\w+)", line):
            message = start[1]
            lines.setdefault(message, number)
        elif signal := re.match(r"\s*SG_\s+(\w+)", line):
            lines.setdefault(f"{message}.{signal[1]}", number)
    return lines


def _content(database: Any, node: str, lines: dict[str, int]) -> dict[str, Any]:
    names: dict[str, None] = {}
    messages = []
    for message in database.messages:
        senders = message.senders or [NO_NODE]
        receivers = [name for signal in message.signals for name in signal.receivers]
        names |= dict.fromkeys([*senders, *receivers])
        if node in senders or node in receivers:
            messages.append(_message(message, node in senders, lines))
    known = {own_node.name: None for own_node in database.nodes}
    bus = database.buses[0] if database.buses else None
    return {
        "nodes": [*known, *(name for name in names if name not in known)],
        "bitrate": bus.baudrate if bus is not None else None,
        "messages": messages,
    }


def _message(message: Any, is_report: bool, lines: dict[str, int]) -> dict[str, Any]:
    return {
        "name": message.name,
        "id": message.frame_id,
        "extended": message.is_extended_frame,
        "length": message.length,
        "is_report": is_report,
        "period": message.cycle_time,
        "comment": message.comment or "",
        "line": lines.get(message.name, 1),
        "signals": [
            _signal(signal) | {"line": lines.get(f"{message.name}.{signal.name}", 1)}
            for signal in message.signals
        ],
    }


def _signal(signal: Any) -> dict[str, Any]:
    numbers = {
        key: None if value is None else str(value)  # JSON has no infinite numbers
        for key in ("scale", "offset", "minimum", "maximum")
        for value in [getattr(signal, key)]
    }
    return {
        "name": signal.name,
        "start": signal.start,
        "length": signal.length,
        "big_endian": signal.byte_order == "big_endian",
        "signed": signal.is_signed,
        "floating_point": signal.is_float,
        "unit": signal.unit or "",
        "comment": signal.comment or "",
        "choices": [[raw, str(name)] for raw, name in (signal.choices or {}).items()],
        "multiplexer": signal.is_multiplexer,
        "selector": signal.multiplexer_signal,
        "selected_by": signal.multiplexer_ids or [],
        **numbers,
    }
