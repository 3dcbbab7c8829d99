"""The view of a bus monitor on a terminal with the library Textual.

Problems are listed one per line above a table of the CAN frames, which is grouped by node and
scrolls in both directions.  The module needs the extra ``tui``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import BindingType
from textual.widgets import DataTable, Footer, Static

from thorvaldc.tools.monitor.monitor_text import COLUMNS, headline, problem_lines, table_rows

REFRESH = 0.1
"""Time (s) between two looks for a new summary."""
Show = Callable[[Mapping[str, Any]], None]


def run_monitor_app(watch: Callable[[Show, Callable[[], bool]], None]) -> None:
    """Shows the summaries of a bus monitor on the terminal until the user quits.

    ``watch``: function that listens to the bus and passes each summary to its first argument, until
    its second argument returns true.  It runs in a thread of its own; an exception that it raises
    ends the view and is raised again.
    """
    app = MonitorApp(watch)
    app.run(mouse=False)
    if app.failure is not None:
        raise app.failure


class MonitorApp(App[None]):
    """Headline, problems and frames of one CAN bus."""

    CSS = """
    #head { height: auto; text-style: bold; }
    #problems { height: auto; max-height: 7; color: $text-error; overflow-y: auto; }
    DataTable { height: 1fr; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        ("q", "quit", "Quit"),
        ("ctrl+c", "quit", "Quit"),
        ("ctrl+d", "quit", "Quit"),
    ]
    ENABLE_COMMAND_PALETTE = False

    def __init__(self, watch: Callable[[Show, Callable[[], bool]], None]) -> None:
        super().__init__()
        self.failure: BaseException | None = None
        self._watch = watch
        self._latest: Mapping[str, Any] | None = None
        self._quit = threading.Event()
        self._listener = threading.Thread(target=self._listen)
        self._shown: dict[str, tuple[str, ...]] = {}

    def compose(self) -> ComposeResult:
        yield Static("waiting for the first second of the bus", id="head", markup=False)
        yield Static("", id="problems", markup=False)
        yield DataTable(cursor_type="row", zebra_stripes=True, fixed_columns=2)
        yield Footer()

    def on_mount(self) -> None:
        table = self.query_one(DataTable)
        for name in COLUMNS:
            table.add_column(name, key=name)
        table.focus()
        self._listener.start()
        self.set_interval(REFRESH, self._refresh_summary)

    def on_unmount(self) -> None:
        self._quit.set()
        if self._listener.ident is not None:
            self._listener.join()

    def _listen(self) -> None:
        try:
            self._watch(self._take, self._quit.is_set)
        except Exception as error:
            self.failure = error
        self._quit.set()

    def _take(self, summary: Mapping[str, Any]) -> None:
        self._latest = summary

    def _refresh_summary(self) -> None:
        if self._quit.is_set():
            self.exit()
            return
        summary, self._latest = self._latest, None
        if summary is None:
            return
        self.query_one("#head", Static).update(headline(summary))
        problems = problem_lines(summary)
        self.query_one("#problems", Static).update("\n".join(problems) or "no problems")
        self._show_rows(dict(table_rows(summary)))

    def _show_rows(self, rows: dict[str, tuple[str, ...]]) -> None:
        table = self.query_one(DataTable)
        if list(rows) != list(self._shown):
            offset, row = table.scroll_offset, table.cursor_row
            table.clear()
            for key, cells in rows.items():
                table.add_row(*map(_cell, cells), key=key)
            table.move_cursor(row=row, scroll=False)
            table.scroll_to(*offset, animate=False)
        else:
            for key, cells in rows.items():
                before = self._shown[key]
                for name, cell, old in zip(COLUMNS, cells, before, strict=True):
                    if cell != old:
                        table.update_cell(key, name, _cell(cell), update_width=True)
        self._shown = rows


def _cell(text: str) -> Text:
    return Text(text, no_wrap=True)
