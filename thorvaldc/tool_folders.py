"""Finds the tools of this package by their folders, so that the core names none of them, and what
other packages add to the core by their entry points.

A tool is a folder ``thorvaldc/tools/<name>/``.  Its ``__init__.py`` declares what the tool adds to
the core, and imports nothing else of the tool:

- ``COMMANDS``: rows of the command table.
- ``DOCUMENTS``: the function ``"module:function"`` that compiles a kind of document, by the kind.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

_FOLDER = Path(__file__).resolve().parent / "tools"


class PluginError(Exception):
    """What another package adds to thorvaldc cannot be used; the message has the reason."""


class CommandEntry(NamedTuple):
    """A row of the command table.

    - ``name``: name of the command, after the name of its group: ``build``, ``can scan``.
    - ``target``: function of the command as ``module:function`` in ``package``, or empty for a
      group of commands.
    - ``help``: help text on one line, for the list of commands and for the help of the command.
    """

    name: str
    target: str
    help: str
    hidden: bool = False
    package: str = "thorvaldc.cli"

    @property
    def group(self) -> str:
        """Name of the group of the command, or empty."""
        return self.name.rpartition(" ")[0]

    @property
    def word(self) -> str:
        """Name of the command within its group."""
        return self.name.rpartition(" ")[2]


def tools() -> Iterator[ModuleType]:
    """Yields the packages of the tools in alphabetical order."""
    for path in sorted(_FOLDER.glob("*/__init__.py")):
        yield import_module(f"thorvaldc.tools.{path.parent.name}")


def tool_commands(group: str | None = None) -> list[CommandEntry]:
    """Returns the rows of the tools in the command table: those of a group, or all.

    The commands are in alphabetical order, and those of a group in the order of the tool.
    """
    entries = [
        entry._replace(package=tool.__name__)
        for tool in tools()
        for entry in getattr(tool, "COMMANDS", ())
        if group is None or entry.group == group
    ]
    return sorted(entries, key=lambda entry: entry.name.partition(" ")[0])


def load_target(entry: CommandEntry) -> Any:
    """Imports and returns the function of a command."""
    return _load(entry.package, entry.target)


def _load(package: str, target: str) -> Any:
    module, function = target.split(":")
    return getattr(import_module(f"{package}.{module}".lstrip(".")), function)


def document_compiler(kind: str) -> Callable[..., Any] | None:
    """Returns the function of a tool that compiles a kind of document, or ``None``."""
    for tool in tools():
        target = getattr(tool, "DOCUMENTS", {}).get(kind)
        if target is not None:
            return _load(tool.__name__, target)  # type: ignore[no-any-return]
    return None


def plugin_entries(group: str) -> list[EntryPoint]:
    """Returns the entry points of other packages in a group, such as ``thorvaldc.commands``.

    The module ``importlib.metadata`` takes 25 ms, a third of ``thorvaldc --help``.  So it is
    imported only if the metadata of a package contains the name of the group.
    """
    if not any(_contains(folder, group.encode()) for folder in sys.path):
        return []
    from importlib.metadata import entry_points

    return list(entry_points(group=group))


def _contains(folder: str, group: bytes) -> bool:
    try:
        with os.scandir(folder or ".") as entries:
            files = [f"{e.path}/entry_points.txt" for e in entries if e.name.endswith("-info")]
        return any(group in Path(file).read_bytes() for file in files if os.path.isfile(file))
    except FileNotFoundError:
        return False
    except OSError:  # an archive, or metadata that cannot be read
        return True
