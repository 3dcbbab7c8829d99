"""Take every figure, print the table, write bench.json."""

from __future__ import annotations

import importlib
import json
import pkgutil
import sys
from dataclasses import asdict

import bench
from bench.figure import ROOT, Figure


def main(only: list[str]) -> int:
    found: list[Figure] = []
    for info in sorted(pkgutil.iter_modules(bench.__path__), key=lambda m: m.name):
        if info.name.startswith("__") or (only and info.name not in only):
            continue
        module = importlib.import_module(f"bench.{info.name}")
        for figure in module.figures() if hasattr(module, "figures") else ():
            found.append(figure)
            print(row(figure), flush=True)
    listed = [asdict(figure) | {"holds": figure.holds} for figure in found]
    if not only:
        (ROOT / "bench.json").write_text(json.dumps(listed, indent=1) + "\n", encoding="utf-8")
    broken = [figure.name for figure in found if not figure.holds]
    if broken:
        print(f"does not hold: {', '.join(broken)}", file=sys.stderr)
    return 0


def row(figure: Figure) -> str:
    sign = "<=" if figure.better == "lower" else ">="
    bound = "" if figure.bound is None else f"{sign} {figure.bound:g}"
    verdict = "" if figure.bound is None else ("holds" if figure.holds else "FAILS")
    value = f"{figure.value:.4g} {figure.unit}".strip()
    return f"{figure.name:<30} {value:>10} {bound:<8} {verdict:<6} {figure.how}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
