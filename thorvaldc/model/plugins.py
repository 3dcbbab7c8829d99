"""Plug-ins: classes by name, from this package and from other installed packages.

Other packages can offer four kinds of classes: backends, base calculators, classes for motor
controllers and batteries on the bus, and simulated devices. Each kind has one ``PluginTable``.

Two rules apply if several packages offer the same name:

- A built-in name cannot be replaced. A build or a robot must not change because somebody installs a
  package.
- If two packages offer different classes with the same name, the name cannot be loaded. The order
  of installed packages must not decide which class drives a robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")


class PluginFailure(NamedTuple):
    """The reason why a plug-in cannot be loaded. The caller puts the reason into a diagnostic.

    - ``unknown``: true if no package offers the name, false if the class of the plug-in cannot be
      used.
    """

    reason: str
    unknown: bool = False


class PluginTable(Generic[T]):
    """The classes of one kind by name, both built-in classes and classes from other packages.

    Other packages offer their classes in an entry-point group of the package metadata.

    - ``group``: name of the entry-point group.
    - ``base_class``: every loaded class must be a concrete subclass of the base class.
    - ``builtin``: maps a built-in name to the text ``"module:attribute"``.

    The table imports a built-in class when the class is loaded. The table reads the metadata of
    installed packages only for names that are not built-in. Reading the metadata takes more time
    than compiling a small robot.
    """

    def __init__(self, group: str, base_class: type[Any], builtin: Mapping[str, str]) -> None:
        self.group = group
        self.base_class = base_class
        self.builtin = dict(builtin)

    def names(self) -> list[str]:
        """All built-in names and names from other packages, in alphabetical order."""
        return sorted({*self.builtin, *(entry.name for entry in _entry_points(self.group))})

    def load(self, name: str) -> type[T] | PluginFailure:
        """Import and return the class that has the name ``name``.

        Returns a ``PluginFailure`` with the reason if the class cannot be used.
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
