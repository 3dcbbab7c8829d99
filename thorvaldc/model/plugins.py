"""Plug-ins: classes that this package and other installed Python packages provide by name.

Other Python packages can provide four kinds of classes: backends, base calculators, drivers of
motor controllers and batteries on the CAN bus, and simulated devices. Each kind of plug-in has one
``PluginTable``.

Rules if several packages provide a plug-in with the same name:

- A built-in name cannot be replaced. Installing a Python package must not change the build or the
  behaviour of a robot.
- If two packages offer different classes with the same name, the name cannot be loaded. The plug-in
  that drives a robot must not depend on the order of installed packages.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


T = TypeVar("T")


class PluginFailure(NamedTuple):
    """The reason why a plug-in cannot be loaded. The caller reports the reason to the user as a
    diagnostic.

    - ``unknown``: true if no package offers the name, false if the class of the plug-in cannot be
      used.
    """

    reason: str
    unknown: bool = False


class PluginTable(Generic[T]):
    """A table of the plug-in classes of one kind by name, from this package and from other
    packages.

    Other packages register their plug-in classes in an entry-point group of the package metadata.

    - ``group``: name of the entry-point group.
    - ``base_class``: every loaded class must be a concrete subclass of the base class.
    - ``builtin``: maps a built-in name to the text ``"module:attribute"``.

    A built-in plug-in class is imported only when it is used. The metadata of installed packages is
    read only for plug-in names that are not built-in. Reading the metadata takes more time than
    compiling a small robot.
    """

    def __init__(self, group: str, base_class: type[Any], builtin: Mapping[str, str]) -> None:
        self.group = group
        self.base_class = base_class
        self.builtin = dict(builtin)

    def names(self) -> list[str]:
        """All plug-in names in alphabetical order: the built-in names and the names from other
        packages."""
        offered: list[EntryPoint] = []
        with contextlib.suppress(Exception):  # `load` reports metadata that cannot be read
            offered = _entry_points(self.group)
        return sorted({*self.builtin, *(entry.name for entry in offered)})

    def load(self, name: str) -> type[T] | PluginFailure:
        """Import and return the plug-in class that has the name ``name``.

        Returns a ``PluginFailure`` with the reason if the plug-in class cannot be used.
        """
        try:
            if name in self.builtin:
                module, attribute = self.builtin[name].split(":")
                loaded = getattr(import_module(module), attribute)
            else:
                entries = [entry for entry in _entry_points(self.group) if entry.name == name]
                if not entries:
                    return PluginFailure(f"no package offers `{name}`", unknown=True)
                if len({entry.value for entry in entries}) > 1:
                    return PluginFailure(_conflict(entries))
                loaded = entries[0].load()
        except Exception as error:  # code of other packages may raise any exception
            return PluginFailure(f"cannot be loaded: {error or type(error).__name__}")
        if not (isinstance(loaded, type) and issubclass(loaded, self.base_class)):
            return PluginFailure(f"is no {self.base_class.__name__}")
        missing = sorted(getattr(loaded, "__abstractmethods__", ()))
        if missing:
            return PluginFailure(f"is incomplete: {loaded.__name__} lacks {', '.join(missing)}")
        return loaded


def _entry_points(group: str) -> list[EntryPoint]:
    from importlib.metadata import entry_points  # a slow import, and built-in names need none

    return list(entry_points(group=group))


def _conflict(entries: list[EntryPoint]) -> str:
    offers = sorted(
        f"{entry.dist.name if entry.dist else 'a package'} ({entry.value})" for entry in entries
    )
    return f"is offered by several packages: {', '.join(offers)}; uninstall all but one of them"


# -- folders with data beside the code: module library and templates --------------------------

_PACKAGE = Path(__file__).resolve().parent.parent


@cache
def data_folder(name: str) -> Path:
    """Return the path of the data folder ``modules`` or ``templates``.

    The folder of a source checkout is preferred to the copy in an installed package, because an
    editable installation may contain an outdated copy.
    """
    checkout = _PACKAGE.parent / name
    if (_PACKAGE.parent / "pyproject.toml").is_file() and checkout.is_dir():
        return checkout
    return _PACKAGE / "_data" / name
