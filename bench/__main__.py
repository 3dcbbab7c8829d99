"""Measures the figures, prints a table and writes bench.json.

``python -m bench`` measures the group ``speed``, ``python -m bench long`` the other group, and
``python -m bench MODULE ...`` the named modules, without writing a file.
"""

from __future__ import annotations

import importlib
import json
import pkgutil
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from types import ModuleType

import bench
from bench.figure import ROOT, Figure
from bench.machine_load import LoadMeter, MachineLoad

GROUPS = {"speed": "bench.json", "long": "bench-long.json"}
"""Groups of modules (``GROUP``, without it ``speed``), and the file of their figures."""


def main(only: list[str]) -> int:
    start = time.perf_counter()
    group = next(iter(only), "speed")
    meter = LoadMeter()
    rows: list[dict[str, object]] = []
    for info in sorted(pkgutil.iter_modules(bench.__path__), key=lambda m: m.name):
        if info.name.startswith("__") or (group not in GROUPS and info.name not in only):
            continue
        module = importlib.import_module(f"bench.{info.name}")
        if group in GROUPS and getattr(module, "GROUP", "speed") != group:
            continue
        for figure in measured(module):
            load = meter.since_last()
            verdict = figure.verdict(load.is_busy)
            rows.append(asdict(figure) | {"verdict": verdict, "load": asdict(load)})
            print(row(figure, verdict, load), flush=True)
    if group in GROUPS:
        (ROOT / GROUPS[group]).write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    number = Counter(str(row["verdict"]) for row in rows)
    print(
        f"{number['holds']} bounds hold, {number['FAILS']} fail, {number['unclear']} cannot be"
        f" judged; {number['info']} figures are information;"
        f" {time.perf_counter() - start:.0f} s"
    )
    missed = [str(row["name"]) for row in rows if row["verdict"] == "FAILS"]
    if missed:
        print(f"bound missed: {', '.join(missed)}", file=sys.stderr)
    return 1 if missed else 0


def measured(module: ModuleType) -> Iterator[Figure]:
    """Returns the figures of a module; one more that fails if it cannot measure them all."""
    try:
        yield from module.figures() if hasattr(module, "figures") else ()
    except SystemExit as error:
        name = f"not measured: {module.__name__}"
        yield Figure(name, 1, "", 0, "lower", str(error), timed=True)


def row(figure: Figure, verdict: str, load: MachineLoad) -> str:
    """Returns the line of a figure in the table."""
    sign = "<=" if figure.better == "lower" else ">="
    bound = "" if figure.bound is None else f"{sign} {figure.bound:g}"
    value = f"{figure.value:.4g} {figure.unit}".strip()
    reason = f"{load}; " if verdict == "unclear" and figure.timed else ""
    return f"{figure.name:<30} {value:>10} {bound:<8} {verdict:<7} {reason}{figure.how}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
