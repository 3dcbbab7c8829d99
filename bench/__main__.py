"""Measures all figures, prints a table and writes bench.json.

``python -m bench [MODULE ...]`` measures only the named modules and does not write bench.json.
"""

from __future__ import annotations

import importlib
import json
import pkgutil
import sys
from dataclasses import asdict

import bench
from bench.figure import ROOT, Figure


def main(only: list[str]) -> int:
    figures: list[Figure] = []
    for info in sorted(pkgutil.iter_modules(bench.__path__), key=lambda m: m.name):
        if info.name.startswith("__") or (only and info.name not in only):
            continue
        module = importlib.import_module(f"bench.{info.name}")
        for figure in module.figures() if hasattr(module, "figures") else ():
            figures.append(figure)
            print(row(figure), flush=True)
    rows = [asdict(figure) | {"holds": figure.holds} for figure in figures]
    if not only:
        (ROOT / "bench.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    missed = [figure.name for figure in figures if not figure.holds]
    if missed:
        print(f"bound missed: {', '.join(missed)}", file=sys.stderr)
    return 0


def row(figure: Figure) -> str:
    """Returns the line of a figure in the table."""
    sign = "<=" if figure.better == "lower" else ">="
    bound = "" if figure.bound is None else f"{sign} {figure.bound:g}"
    verdict = "" if figure.bound is None else ("holds" if figure.holds else "FAILS")
    value = f"{figure.value:.4g} {figure.unit}".strip()
    return f"{figure.name:<30} {value:>10} {bound:<8} {verdict:<6} {figure.how}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
