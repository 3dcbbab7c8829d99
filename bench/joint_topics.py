"""The mission of 77 s over joint topics, in engines of another process that stand for Gazebo."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.figure import ROOT, Figure
from tests.examples import ROBOTS
from tests.ros.engines.test_gazebo import COUPLED, build, mission
from tests.ros.environments import DISTROS, ENVIRONMENTS

GROUP = "long"

SECONDS = 77.0
BOUND = 0.3
"""Largest error of the odometry in % of the path."""


def figures() -> Iterator[Figure]:
    distro = DISTROS[0]
    if not (ENVIRONMENTS / distro).exists():
        return
    for physics in ("mujoco", "dart"):
        if physics == "dart" and not (ROOT / ".venv" / "dart").exists():
            continue
        left_out = COUPLED if physics == "dart" else ()
        names = [name for name in ROBOTS if name not in left_out]
        results = {name: _result(distro, physics, name) for name in names}
        ratios = {name: 100.0 * r["distance"] / r["path"] for name, r in results.items()}
        worst = max(ratios, key=ratios.__getitem__)
        yield Figure(
            f"odometry over topics, {physics}",
            ratios[worst],
            "%",
            BOUND,
            "lower",
            f"of the path of {SECONDS:.0f} s, {worst}, the largest of {len(ratios)} examples",
        )
        slowest = max(results, key=lambda name: results[name]["p99_ms"])
        yield Figure(
            f"commands over topics, {physics}",
            results[slowest]["p99_ms"],
            "ms",
            None,
            "lower",
            f"from joint states to the last command, 99 of 100 cycles, {slowest}; median"
            f" {results[slowest]['p50_ms']:.1f} ms",
        )


def _result(distro: str, physics: str, name: str) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        package = build(name, Path(folder))
        return mission(distro, Path(folder), physics, package, SECONDS)
