"""Shows the summaries of a bus monitor: as lines of text, and on a terminal with scrolling."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import IO, Any

from thorvaldc.can.frame import CanInterface
from thorvaldc.cli.terminal import Terminal
from thorvaldc.diagnostics.text_layout import text_table
from thorvaldc.runtime.pace import end_signals
from thorvaldc.tools.monitor.bus_monitor import BusMonitor, watch

SHOWN_EMERGENCIES = 5
WIDE = 110
"""Number of columns of a terminal from which on values stand beside their frame."""
COLUMNS = 8
"""Number of columns by which the keys left and right scroll."""


def monitor_lines(summary: Mapping[str, Any], width: int | None = None) -> list[str]:
    """Returns the summary of a CAN bus as lines of text.

    The text contains a headline, the nodes, the EMCY messages, the CAN frames that are not in the
    CAN map, and the CAN frames of the CAN map with their signal values.

    ``width``: number of columns of a terminal, or ``None`` for a line for each frame.  On a narrow
    terminal, the values of a frame have lines of their own below it.
    """
    lines = [*_filled(_headline(summary), width or sys.maxsize, ""), ""]
    lines += _nodes(summary["nodes"])
    lines += _emergencies(summary["emergencies"], summary["time"])
    lines += _unknown(summary["unknown"])
    heads = [("id", "frame", "period", "age"), *map(_frame, summary["frames"])]
    texts = [["values"], *map(_values, summary["frames"])]
    table = text_table(heads, right=(0, 2, 3), least=(3, 30, 7, 7)).splitlines()
    lines.append("")
    for head, values in zip(table, texts, strict=True):
        if width is None or width >= WIDE:
            lines.append("  ".join([head, *values]))
        else:
            lines.append(head)
            lines += _filled(values, width, " " * 5) if head is not table[0] else []
    return lines


def _filled(parts: Sequence[str], width: int, indent: str) -> list[str]:
    """Returns lines of at most ``width`` columns with parts that are never divided."""
    lines: list[str] = []
    for part in parts:
        if lines and len(lines[-1]) + 2 + len(part) <= width:
            lines[-1] += f"  {part}"
        else:
            lines.append(indent + part)
    return lines


def page(lines: Sequence[str], height: int, first: int) -> list[str]:
    """Returns ``height`` lines of the bus monitor text, starting at the line with the index
    ``first``.

    If the text has more than ``height`` lines, the last returned line shows the scroll position.
    """
    height = max(height, 3)
    if len(lines) <= height:
        return list(lines)
    first = min(max(first, 0), len(lines) - height + 1)
    shown = list(lines[first : first + height - 1])
    return [*shown, f"-- {first + 1} to {first + len(shown)} of {len(lines)} lines; arrow keys --"]


def _headline(summary: Mapping[str, Any]) -> list[str]:
    """Returns robot, bus, bit rate, load and the state of this computer's CAN controller."""
    parts = [
        f"{summary['robot']} {summary['bus']}",
        f"{summary['bitrate'] // 1000} kbit/s",
        f"load {_percent(summary['load'])} (highest {_percent(summary['highest_load'])}, "
        f"budget {_percent(summary['load_budget'])})",
        f"{summary['frames_per_second']:.0f} frames/s",
    ]
    controller = summary.get("controller", "")
    if controller not in ("", "error-active"):
        parts.append(f"OWN CONTROLLER: {controller.upper()}")
    if summary.get("overruns"):
        parts.append(f"{summary['overruns']} frames lost by this program")
    return parts


def _nodes(nodes: Sequence[Mapping[str, Any]]) -> list[str]:
    if not nodes:
        return []
    rows = [("node", "id", "state", "")]
    rows += [(node["name"], str(node["id"]), *_state(node)) for node in nodes]
    return text_table(rows, right=(1,), least=(0, 3, 17, 0)).splitlines()


def _state(node: Mapping[str, Any]) -> tuple[str, str]:
    """Returns the NMT state of a node, and the states of its drives with the flags that are set."""
    drive = ", ".join(
        name.replace("_", " ") if state is None else f"{name} {state}"
        for name, state in node["drive"].items()
    )
    state = node["nmt"] or ("-" if node["heard"] is not None else "no frame yet")
    return (f"{state}  SILENT" if node["silent"] else state), drive


def _emergencies(emergencies: Sequence[Mapping[str, Any]], now: float) -> list[str]:
    lines = [""] if emergencies else []
    for emergency in emergencies[-SHOWN_EMERGENCIES:]:
        text = "no error" if emergency["over"] else f"error {emergency['code']:#06x}"
        register = (
            "" if emergency["register"] is None else f" register {emergency['register']:#04x}"
        )
        data = f" data {emergency['data']}" if emergency["data"].strip("0") else ""
        age = now - emergency["time"]
        lines.append(f"EMCY {age:.1f} s ago  {emergency['node']}: {text}{register}{data}")
    return lines


def _unknown(frames: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = [""] if frames else []
    for frame in frames:
        name = f"{frame['id']:08x}" if frame["extended"] else f"{frame['id']:03x}"
        lines.append(
            f"NOT IN THE MAP {name}  {frame['count']} frames  {_time(frame['period'])}  "
            f"{_time(frame['age'])} ago  {frame['data']}".rstrip()
        )
    return lines


def _frame(frame: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        f"{frame['id']:08x}" if frame["extended"] else f"{frame['id']:x}",
        frame["name"],
        _time(frame["period"]),
        _time(frame["age"]),
    )


def _values(frame: Mapping[str, Any]) -> list[str]:
    units, flags = frame["units"], frame["flags"]
    return [
        *([frame["problem"].upper()] if frame["problem"] else []),
        *(
            name if name in flags else f"{name} {_value(value)} {units.get(name, '')}".rstrip()
            for name, value in frame["values"].items()
            if value or name not in flags
        ),
    ]


def _value(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return str(value) if isinstance(value, int) else f"{value:z.4g}"


def _time(seconds: float | None) -> str:
    if seconds is None:
        return "-"
    if seconds < 1.0:
        return f"{seconds * 1000:.0f} ms"
    return f"{seconds:.1f} s" if seconds < 100.0 else f"{seconds:.0f} s"


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"


def watch_live(
    interface: CanInterface,
    monitor: BusMonitor,
    interval: float,
    duration: float,
    keys: IO[str] | None,
    screen: IO[str],
) -> None:
    """Shows the state of a CAN bus on the terminal.

    The function returns when the user presses ``q``, when a termination signal arrives, or after
    ``duration`` seconds.  ``interval``: time (s) between two updates of the terminal.  Raises
    ``ConnectionError`` if the connection to the CAN interface is lost.
    """
    until = interface.now + duration
    with end_signals() as end_requested, Terminal(keys, screen, whole=True) as terminal:
        view = LiveView(terminal)
        watch(
            interface,
            monitor,
            interval,
            view.show,
            until=until,
            ended=lambda: end_requested() or view.poll(),
        )


def watch_stream(
    interface: CanInterface,
    monitor: BusMonitor,
    interval: float,
    duration: float,
    show: Callable[[Mapping[str, Any]], None],
) -> None:
    """Calls the function ``show`` with a summary of the CAN bus every ``interval`` seconds.

    The function returns when a termination signal arrives, or after ``duration`` seconds.
    """
    with end_signals() as end_requested:
        until = interface.now + duration
        watch(interface, monitor, interval, show, until=until, ended=end_requested)


class LiveView:
    """View of a CAN bus summary on a terminal, which the user can scroll with the arrow keys."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal
        self._first_line = self._first_column = 0
        self._lines: list[str] = []
        self._quit = False

    def show(self, summary: Mapping[str, Any]) -> None:
        """Shows a new summary of the CAN bus on the terminal."""
        self._lines = monitor_lines(summary, shutil.get_terminal_size().columns)
        self._draw()

    def poll(self) -> bool:
        """Reads the pressed keys and scrolls the terminal view.

        Returns ``True`` if the user has pressed the key to quit.
        """
        try:
            keys = self._terminal.read()
        except EOFError:
            return True
        for key in keys:
            if key in ("q", "Q", "ctrl-d", "ctrl-c"):
                self._quit = True
            step = {"down": 1, "j": 1, "up": -1, "k": -1, " ": _height() - 2}.get(key, 0)
            sideways = {"right": COLUMNS, "l": COLUMNS, "left": -COLUMNS, "h": -COLUMNS}.get(key, 0)
            if step or sideways:
                last = max(len(self._lines) - _height() + 1, 0)
                self._first_line = min(max(self._first_line + step, 0), last)
                last = max(max(map(len, self._lines), default=0) - COLUMNS, 0)
                self._first_column = min(max(self._first_column + sideways, 0), last)
                self._draw()
        return self._quit

    def _draw(self) -> None:
        lines = [line[self._first_column :] for line in self._lines]
        self._terminal.show(page(lines, _height(), self._first_line))


def _height() -> int:
    return shutil.get_terminal_size().lines
