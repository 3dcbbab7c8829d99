"""Finds the tools of this package by their folders, so that the core names none of them.

A tool is a folder ``thorvaldc/tools/<name>/``.  Its ``__init__.py`` declares what the tool adds to
the core, and imports nothing else of the tool:

- ``DOCUMENTS``: the function ``"module:function"`` that compiles a kind of document, by the kind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

PACKAGE = "thorvaldc.tools"
_FOLDER = Path(__file__).resolve().parents[1] / "tools"


def tools() -> Iterator[ModuleType]:
    """Yields the packages of the tools in alphabetical order."""
    for path in sorted(_FOLDER.glob("*/__init__.py")):
        yield import_module(f"{PACKAGE}.{path.parent.name}")


def load_target(package: str, target: str) -> Any:
    """Imports and returns the function of a target ``"module:function"`` in a package."""
    module, function = target.split(":")
    return getattr(import_module(f"{package}.{module}"), function)


def document_compiler(kind: str) -> Callable[..., Any] | None:
    """Returns the function of a tool that compiles a kind of document, or ``None``."""
    for tool in tools():
        target = getattr(tool, "DOCUMENTS", {}).get(kind)
        if target is not None:
            return load_target(tool.__name__, target)  # type: ignore[no-any-return]
    return None
