"""Plug-ins: classes by name, from this package and from other installed packages.

Four kinds of classes can come from other packages: backends, base calculators, motor controllers
and batteries on the bus, and simulated devices.  Each kind has one ``PluginTable``.

Rules for a name that is offered more than once:

- A built-in name cannot be replaced.  A build or a robot must not change because
  somebody installs a package.
- If two packages offer different classes under one name, the name cannot be loaded.  The
  order of installed packages must not decide which class drives a robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")


class PluginFailure(NamedTuple):
    """The reason why a plug-in cannot be loaded, for the caller's diagnostic.

    ``unknown``: no package offers this name.  Otherwise a package offers it, and
    its class cannot be used.
    """

    reason: str
    unknown: bool = False


class PluginTable(Generic[T]):
    """The classes of one kind by name: the built-in ones and those of an entry-point group.

    ``builtin`` maps names to ``"module:attribute"``.  A built-in class is imported when it is
    loaded, and the metadata of installed packages are read only for other names: this
    takes more time than compiling a small robot.  Every loaded class must be a
    concrete subclass of ``base_class``.
    """

    def __init__(self, group: str, base_class: type[Any], builtin: Mapping[str, str]) -> None:
        self.group = group
        self.base_class = base_class
        self.builtin = dict(builtin)

    def names(self) -> list[str]:
        """All names, built-in and plugged-in, in alphabetical order."""
        return sorted({*self.builtin, *(entry.name for entry in _entry_points(self.group))})

    def load(self, name: str) -> type[T] | PluginFailure:
        """Import the class of this name, or return the reason why that is not possible."""
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
        except Exception as error:  # the import runs code of other packages: anything can happen
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
