"""``sim`` of a scenario's variations: the table, its files, and what decides the exit status."""

from __future__ import annotations

import csv
import gc
import json as json_format
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import typer

from thorvaldc.cli.compiling import library_folders
from thorvaldc.cli.exits import DONE, INPUT, OutsideError
from thorvaldc.cli.faults import Faults, count, finite, message
from thorvaldc.cli.progress import Progress

if TYPE_CHECKING:
    from thorvaldc.compiler.scenario.variations import Change, Variations
    from thorvaldc.tools.scenario_batch import Run

SHOWN = 10
"""So many runs are named that are not as expected."""
# What the table on the terminal shows of the metrics, and how.
_METRICS = (
    ("path", "true", "{:.3f} m", 1.0),
    ("end_error", "end error", "{:.1f} mm", 1000.0),
    ("length_ratio", "length ratio", "{:.5f}", 1.0),
    ("tilt", "tilt", "{:.2f} deg", 57.29577951308232),
    ("slip", "slip", "{:.4f} m/s", 1.0),
    ("collisions", "collisions", "{:.0f}", 1.0),
)


def plan(
    scenario: str, settings: Sequence[str], draws: str, seed: str, *, own: bool
) -> Variations | None:
    """What varies; ``None`` where that is not understood, which is said on stderr.

    ``own``: the document's own variations as well.
    """
    from thorvaldc.diagnostics import Report
    from thorvaldc.tools.scenario_batch import plan_variations

    for text in settings:
        if "=" not in text or not text.partition("=")[0].strip():
            raise typer.BadParameter(f"{text!r} is not PATH=VALUES", param_hint="'--set'")
    report = Report()
    found = plan_variations(
        scenario,
        settings,
        _whole(draws, "--draws", 1),
        _whole(seed, "--seed", 0),
        own=own,
        report=report,
    )
    if found is None:
        raise typer.BadParameter(f"{scenario} is no scenario", param_hint="'FILE'")
    if report.has_errors:
        faults = Faults("text", sys.stderr)
        faults.add(report, {scenario: Path(scenario)})
        faults.finish()
        return None
    if not found.varied and not (own and found.draws > 1):
        raise typer.BadParameter(
            f"{scenario} has no `variations`; say what varies by --set", param_hint="'--variations'"
        )
    return found


def _whole(text: str, option: str, least: int) -> int | None:
    if not text:
        return None
    if not (text.isascii() and text.isdigit() and int(text) >= least):
        raise typer.BadParameter(
            f"{text!r} is no whole number from {least} on", param_hint=f"'{option}'"
        )
    return int(text)


def only_run(variations: Variations) -> tuple[Change, ...] | None:
    """The changes where there is but one run; ``None`` where there are several."""
    return next(variations.all()) if variations.size == 1 else None


def run_batch(
    scenario: str,
    variations: Variations,
    robot: str | None,
    library: Sequence[str],
    jobs: str,
    output: str,
    json: bool,
) -> int:
    """Run them all and show what came of it; ``output`` is a CSV or JSON file, or empty.

    After Ctrl-C what is done is shown and kept.
    """
    from thorvaldc.tools.scenario_batch import Batch, processors

    gc.enable()
    wanted = _whole(jobs, "--jobs", 1) or processors()
    kind = Path(output).suffix.lower()
    if output and kind not in (".csv", ".json"):
        raise typer.BadParameter(f"{output!r} does not end in .csv or .json", param_hint="'-o'")
    batch = Batch(scenario, variations, robot=robot, library=library_folders(library))
    wrong = batch.check()
    if wrong is not None:
        faults = Faults("text", sys.stderr)
        faults.add(wrong.report, wrong.sources)
        return faults.finish()
    stream = _opened(output) if output else None
    runs: list[Run] = []
    bar = Progress(len(batch), "runs")
    try:
        bar.show(0)
        for run in batch.runs(wanted):
            runs.append(run)
            bar.show(len(runs))
            if stream is not None:
                # As they come, so that nothing is lost with the process; in order at the end.
                _append(stream, kind, run, first=len(runs) == 1)
    except OSError:
        raise
    except RuntimeError as fault:
        raise OutsideError(str(fault)) from None
    finally:
        bar.clear()
        runs.sort(key=lambda run: run.number)
        if stream is not None:
            with stream:
                _write(stream, kind, runs)
        if json:
            print(_json(runs))
        elif runs:
            print(table(runs))
        if len(runs) < len(batch):
            message(f"{len(runs)} of {len(batch)} runs are done")
    for line in _failures(runs):
        message(line)
    return DONE if all(run.passed for run in runs) else INPUT


def _opened(path: str) -> TextIO:
    try:
        return open(path, "w", encoding="utf-8", newline="")
    except OSError as fault:
        raise OutsideError(f"cannot write {path}: {fault.strerror or fault}") from None


def _append(stream: TextIO, kind: str, run: Run, *, first: bool) -> None:
    if kind == ".csv":
        _rows(stream, [run], heading=first)
    else:
        stream.write(json_format.dumps(finite(run.as_json()), ensure_ascii=False) + "\n")
    stream.flush()


def _write(stream: TextIO, kind: str, runs: Sequence[Run]) -> None:
    stream.seek(0)
    stream.truncate()
    if kind == ".csv":
        _rows(stream, runs)
    else:
        stream.write(_json(runs) + "\n")


def _json(runs: Sequence[Run]) -> str:
    listed = [finite(run.as_json()) for run in runs]
    return json_format.dumps(listed, indent=1, ensure_ascii=False)


def _rows(stream: TextIO, runs: Sequence[Run], *, heading: bool = True) -> None:
    """A line for each robot of each run: what varied, every metric in SI, the hash."""
    from thorvaldc.simulation.scenario_metrics import UNITS

    writer = csv.writer(stream, lineterminator="\n")
    if heading and runs:
        writer.writerow(
            ["run", "robot", *runs[0].values, *UNITS, "simulated", "passed", "hash", "faults"]
        )
    for run in runs:
        values = [_text(value) for value in run.values.values()]
        for robot, metrics in _robots(run):
            simulated = run.result["run"]["simulated"] if run.result is not None else ""
            writer.writerow(
                [
                    run.number,
                    robot,
                    *values,
                    *(f"{metrics[name]:.9g}" if name in metrics else "" for name in UNITS),
                    simulated,
                    str(run.passed).lower(),
                    run.result["hash"] if run.result is not None else "",
                    "; ".join(run.faults),
                ]
            )


def _robots(run: Run) -> Iterator[tuple[str, Mapping[str, float]]]:
    if run.result is None:
        yield "", {}
        return
    yield from run.result["metrics"].items()


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json_format.dumps(value, ensure_ascii=False)


def _short(value: Any) -> str:
    """A value in the table: six digits of a number that was drawn."""
    if isinstance(value, float):
        return f"{value:.6g}"
    text = _text(value)
    number, _, unit = text.partition(" ")
    try:
        return f"{float(number):.6g} {unit}".rstrip() if len(number) > 8 else text
    except ValueError:
        return text


def table(runs: Sequence[Run]) -> str:
    """The runs as aligned text: what varied, what was measured, and whether it is as expected."""
    several = any(run.result is not None and len(run.result["metrics"]) > 1 for run in runs)
    lines = [
        ["run", *runs[0].values, *(["robot"] * several), *(m[1] for m in _METRICS), "", "hash"]
    ]
    for run in runs:
        values = [_short(value) for value in run.values.values()]
        for robot, metrics in _robots(run):
            measured = [
                form.format(scale * metrics[name]) if name in metrics else "-"
                for name, _, form, scale in _METRICS
            ]
            verdict = "ok" if run.passed else "FAILED"
            mark = run.result["hash"][:8] if run.result is not None else "-"
            named = [robot] * several
            lines.append([str(run.number), *values, *named, *measured, verdict, mark])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    shown = [
        "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    ]
    failed = sum(not run.passed for run in runs)
    end = f", {failed} not as expected" if failed else ", all as expected"
    return "\n".join([*shown, count(len(runs), "run") + end])


def _failures(runs: Sequence[Run]) -> Iterator[str]:
    wrong = [run for run in runs if run.faults]
    for run in wrong[:SHOWN]:
        yield from (f"run {run.number}: {fault}" for fault in run.faults)
    if len(wrong) > SHOWN:
        yield f"and {count(len(wrong) - SHOWN, 'run')} more"
