"""Backends: from the model to the files of a target.  Each is one file and one row of a table."""

from __future__ import annotations

import abc
from collections.abc import Iterable
from typing import ClassVar, NamedTuple

from thorvaldc.diagnostics import Diagnostic
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.plugins import PluginFailure, PluginTable


class Backend(abc.ABC):
    """Writes the files of one target.

    Pure: a backend reads no disk, clock, random numbers or environment, and the same model
    gives the same bytes.  ``name`` and ``summary`` (one line) describe the target.
    """

    name: ClassVar[str]
    summary: ClassVar[str]

    @abc.abstractmethod
    def emit(self, robot: Robot) -> dict[str, bytes]:
        """Return the files of one robot by their POSIX path relative to the build folder."""

    def emit_fleet(self, fleet: Fleet) -> dict[str, bytes]:
        """Return the files of a fleet; by default those of each robot in a folder of its name."""
        return {
            f"{placement.name}/{path}": data
            for placement in fleet.placements
            for path, data in self.emit(placement.robot).items()
        }

    def unsupported(self, robot: Robot) -> Iterable[Diagnostic]:
        """Return a diagnostic for each property of the robot that the format cannot express."""
        return ()


class Target(NamedTuple):
    """A built-in target: its class as ``"module:class"``; whether ``build`` writes it by default.

    The name and the summary of the target are those of its class.
    """

    backend: str
    default: bool = True


# The only list of built-in targets.  The order is that of ``build``'s report.
TARGETS: dict[str, Target] = {
    "urdf": Target("thorvaldc.backends.urdf:Urdf"),
    "mjcf": Target("thorvaldc.backends.mjcf:Mjcf"),
    "ros2": Target("thorvaldc.backends.ros2:Ros2"),
    "can": Target("thorvaldc.backends.can:Can"),
}
DEFAULT_TARGETS = tuple(name for name, target in TARGETS.items() if target.default)
PLUGINS: PluginTable[Backend] = PluginTable(
    "thorvaldc.backends", Backend, {name: target.backend for name, target in TARGETS.items()}
)


class TargetError(KeyError):
    """There is no such target, or its backend cannot be used; the message gives the reason."""

    def __str__(self) -> str:
        return str(self.args[0])  # ``KeyError`` would show it in quotes


def names() -> list[str]:
    """Return all targets, built-in and plugged-in, in alphabetical order."""
    return PLUGINS.names()


def load(name: str) -> Backend:
    """Return the backend of a target.  Raises ``TargetError``, a ``KeyError``."""
    backend_class = PLUGINS.load(name)
    if isinstance(backend_class, PluginFailure):
        if backend_class.unknown:
            raise TargetError(f"there is no target {name!r}; there are {', '.join(names())}")
        raise TargetError(f"the backend of target {name!r} {backend_class.reason}")
    return backend_class()
