"""The progress of a study on a terminal: a bar, and a plot of the Pareto front so far."""

from __future__ import annotations

import itertools
import shutil
import sys
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from thorvaldc.cli.diagnostic_output import has_color
from thorvaldc.cli.progress import Progress
from thorvaldc.tools.study.study_results import front, objective_columns
from thorvaldc.tools.study.study_run import StudyRun

if TYPE_CHECKING:
    from rich.live import Live

PERIOD = 0.5
"""Least time (s) between two plots."""
LEAST_SIZE = (50, 16)
"""Columns and lines of the smallest terminal with a plot."""
MOST_SIZE = (90, 20)
"""Columns and lines of the largest plot, without its frame."""
AROUND = (16, 7)
"""Columns and lines beside and around a plot: frame, title, axes, legend and bar."""
PASSED, ON_FRONT = ".", "*"


class StudyProgress:
    """The progress of a study on stderr, which is shown only on a terminal.

    A study with several objectives has a plot of the first two, from two designs with the status
    ``ok`` on.  Without the package uniplot, on a small terminal, or if the terminal has no Unicode,
    there is only the bar.
    """

    def __init__(self, run: StudyRun) -> None:
        study = run.inputs.study
        self._run = run
        self._bar = Progress(run.number, "designs")
        self._objectives = study.objectives
        self._columns = objective_columns(study)
        self._results_read = 0
        self._points: list[tuple[float, ...]] = []  # values of the objectives
        self._front: list[tuple[float, ...]] = []
        self._next_plot = 0.0
        self._live: Live | None = None
        self._has_plot = self._bar.active and len(study.objectives) > 1 and _can_plot()

    def show(self, finished: int, results: Mapping[str, Mapping[str, Any]]) -> None:
        """Shows the number of finished designs and their front.

        ``results``: results by the keys of designs, in the order in which they finished.
        """
        if not self._has_plot:
            self._bar.show(finished)
            return
        if time.monotonic() < self._next_plot:
            return
        self._read(results)
        plot = self._plot()
        if self._live is None and not plot:
            self._bar.show(finished)
            return
        self._draw(f"{plot}{self._bar.line(finished)}")
        self._next_plot = time.monotonic() + PERIOD

    def clear(self) -> None:
        """Erases the progress from the terminal."""
        if self._live is not None:
            self._live.stop()
            self._live = None
        self._bar.clear()

    def _read(self, results: Mapping[str, Mapping[str, Any]]) -> None:
        """Adds the results that are new since the last call, so that a plot of many is quick."""
        points, keys = [], set(self._run.keys)
        for key, result in itertools.islice(results.items(), self._results_read, None):
            if key in keys and result["status"] == "ok":
                values = [each.value_of(result) for each in self._objectives]
                points.append(tuple(value for value in values if value is not None))
        self._results_read = len(results)
        self._points += (p for p in points if len(p) == len(self._objectives))
        candidates = self._front + [p for p in points if len(p) == len(self._objectives)]
        ranks = [
            [objective.rank(value) for objective, value in zip(self._objectives, p, strict=True)]
            for p in candidates
        ]
        self._front = [candidates[index] for index in front(ranks)]

    def _plot(self) -> str:
        """Returns the plot as text with a newline at its end, or an empty text without one."""
        columns, lines = shutil.get_terminal_size()
        fits = columns >= LEAST_SIZE[0] and lines >= LEAST_SIZE[1]
        if len(self._points) < 2 or not fits:
            return ""
        try:
            return self._plot_text(columns, lines)
        except Exception:
            # A plot must not end a study of hours, for example with values that overflow.
            return ""

    def _plot_text(self, columns: int, lines: int) -> str:
        import uniplot

        x, y = self._columns[:2]
        text: str = uniplot.plot_to_string(
            [[point[1] for point in points] for points in (self._points, self._front)],
            [[point[0] for point in points] for points in (self._points, self._front)],
            width=min(columns - AROUND[0], MOST_SIZE[0]),
            height=min(lines - AROUND[1], MOST_SIZE[1]),
            title=f"{y.title} against {x.title}"[: columns - AROUND[0]],
            legend_labels=["ok", "front"],
            color=["blue", "red"] if has_color(sys.stderr) else False,
            # Characters tell the front apart without colours.
            character_set="ascii",
            force_ascii_characters=[PASSED, ON_FRONT],
            line_length_hard_cap=columns - 1,
            x_gridlines=[],
            y_gridlines=[],
        )
        return text.rstrip("\n") + "\n"

    def _draw(self, text: str) -> None:
        from rich.console import Console
        from rich.live import Live
        from rich.text import Text

        if self._live is None:
            self._bar.clear()
            self._live = Live(
                console=Console(stderr=True, highlight=False),
                auto_refresh=False,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=False,
            )
            self._live.start()
        content = Text.from_ansi(text)
        content.no_wrap = True
        self._live.update(content, refresh=True)


def _can_plot() -> bool:
    try:
        import rich.live  # noqa: F401
        import uniplot  # noqa: F401
    except ImportError:
        return False
    return "utf" in (sys.stderr.encoding or "").lower()
