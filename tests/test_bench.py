"""The bench runs only on request; these tests detect modules that cannot be imported any more."""

from __future__ import annotations

import importlib
import pkgutil

import pytest

import bench

MODULES = [m.name for m in pkgutil.iter_modules(bench.__path__) if m.name != "__main__"]


@pytest.mark.parametrize("name", MODULES)
def test_module_of_the_bench_can_be_imported(name: str) -> None:
    importlib.import_module(f"bench.{name}")
