"""Backends: from the model to files.  One file and one line in the table each."""

from __future__ import annotations

import abc
from collections.abc import Iterable
from typing import ClassVar

from thorvaldc.diagnostics import Diagnostic
from thorvaldc.model import Fleet, Robot

# Name of the target -> "module:class".  Backends from outside come by the entry
# point group `thorvaldc.backends`; these are named here so that a build need not
# read the metadata of every installed package.
BUILTIN: dict[str, str] = {
    "urdf": "thorvaldc.backends.urdf:Urdf",
    "mjcf": "thorvaldc.backends.mjcf:Mjcf",
    "ros2": "thorvaldc.backends.ros2:Ros2",
    "can": "thorvaldc.backends.can:Can",
}
ENTRY_POINT_GROUP = "thorvaldc.backends"


class Backend(abc.ABC):
    """Writes one target.  Pure: no disk, clock, randomness or environment."""

    name: ClassVar[str]
    summary: ClassVar[str]

    @abc.abstractmethod
    def emit(self, robot: Robot) -> dict[str, bytes]:
        """Files of one robot by their path relative to the build folder."""

    def emit_fleet(self, fleet: Fleet) -> dict[str, bytes]:
        """Files of a fleet; by default each robot's own, in a folder of its name."""
        return {
            f"{placement.name}/{path}": data
            for placement in fleet.placements
            for path, data in self.emit(placement.robot).items()
        }

    def unsupported(self, robot: Robot) -> Iterable[Diagnostic]:
        """What of this robot the format cannot say, as warnings."""
        return ()


def names() -> list[str]:
    """All targets, built in and from outside, in alphabetical order."""
    from importlib.metadata import entry_points

    return sorted({*BUILTIN, *(e.name for e in entry_points(group=ENTRY_POINT_GROUP))})


def load(name: str) -> Backend:
    """The backend of that name.  Raises ``KeyError`` for an unknown one."""
    if name in BUILTIN:
        from importlib import import_module

        module, attribute = BUILTIN[name].split(":")
        backend: Backend = getattr(import_module(module), attribute)()
        return backend
    from importlib.metadata import entry_points

    for entry in entry_points(group=ENTRY_POINT_GROUP):
        if entry.name == name:
            found: Backend = entry.load()()
            return found
    raise KeyError(name)
