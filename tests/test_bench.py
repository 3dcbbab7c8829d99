"""The bench is run by hand: that its parts fit together is told here."""

from __future__ import annotations

import importlib
import pkgutil

import pytest

import bench

PARTS = [m.name for m in pkgutil.iter_modules(bench.__path__) if m.name != "__main__"]


@pytest.mark.parametrize("name", PARTS)
def test_a_part_of_the_bench_can_be_imported(name: str) -> None:
    importlib.import_module(f"bench.{name}")
