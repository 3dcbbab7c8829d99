"""Backends write the files of a target, such as URDF, from the model of a robot.

Each backend is one Python module and one row of the table ``TARGETS``; further modules of a target
begin with its name, and its longer texts are in ``templates/``.  A backend computes no number that
the model has, and imports only ``model`` and ``diagnostics``.  Begin with ``Backend`` below, then
with ``urdf``, the shortest whole target.
"""

from __future__ import annotations

import abc
from collections.abc import Iterable
from typing import ClassVar

from thorvaldc.diagnostics import Diagnostic, nearest
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.plugins import PluginFailure, PluginTable


class Backend(abc.ABC):
    """A backend writes the files of one build target, such as `urdf`.

    A backend must not read files, the clock, random numbers or the environment. A backend therefore
    always writes the same bytes for the same model.

    - ``name``: name of the target.
    - ``summary``: description of the target on one line.
    """

    name: ClassVar[str]
    summary: ClassVar[str]

    @abc.abstractmethod
    def emit(self, robot: Robot) -> dict[str, bytes]:
        """Return the output files of one robot by their POSIX path relative to the build folder."""

    def emit_fleet(self, fleet: Fleet) -> dict[str, bytes]:
        """Return the output files of a fleet by their POSIX path relative to the build folder.

        By default, the output files of each robot of the fleet are in a folder with the robot's
        name.
        """
        return {
            f"{placement.name}/{path}": data
            for placement in fleet.placements
            for path, data in self.emit(placement.robot).items()
        }

    def unsupported(self, robot: Robot) -> Iterable[Diagnostic]:
        """Return a diagnostic for each property of the robot that the output format cannot
        express."""
        return ()


# All built-in build targets, in the order in which ``build`` prints the targets. The backend class
# has the name and a summary of the target as attributes.
TARGETS = {
    "urdf": "thorvaldc.backends.urdf:Urdf",
    "mjcf": "thorvaldc.backends.mjcf:Mjcf",
    "sdf": "thorvaldc.backends.sdf:Sdf",
    "ros2": "thorvaldc.backends.ros2:Ros2",
    "can": "thorvaldc.backends.can:Can",
    "computer": "thorvaldc.backends.computer:ComputerFiles",
    "datasheet": "thorvaldc.backends.datasheet:Datasheet",
}
DEFAULT_TARGETS = ("urdf", "mjcf", "ros2", "can")
PLUGINS: PluginTable[Backend] = PluginTable("thorvaldc.backends", Backend, TARGETS)


class TargetError(KeyError):
    """Error: the build target does not exist, or its backend cannot be used.

    The error message says why the backend cannot be used.
    """

    def __str__(self) -> str:
        return str(self.args[0])  # ``str`` of a ``KeyError`` would put the message in quotes.


def names() -> list[str]:
    """Return the names of all build targets in alphabetical order."""
    return PLUGINS.names()


_PROGRAMS = {
    "gazebo": "sdf",
    "gz": "sdf",
    "mujoco": "mjcf",
    "ros": "ros2",
    "rviz": "urdf",
    "xacro": "urdf",
    "dbc": "can",
    "canopen": "can",
    "pdf": "datasheet",
    "systemd": "computer",
    "udev": "computer",
}
"""Targets by the names of programs and formats that users may try."""


def load(name: str) -> Backend:
    """Return the backend of the build target ``name``.

    Raises ``TargetError`` if the build target does not exist or its backend cannot be used.
    """
    backend_class = PLUGINS.load(name)
    if isinstance(backend_class, PluginFailure):
        if backend_class.unknown:
            known = names()
            near = _PROGRAMS.get(name) or nearest(name, known)
            hint = f"did you mean `{near}`? " if near else ""
            raise TargetError(f"unknown target `{name}`; {hint}the targets are {', '.join(known)}")
        raise TargetError(f"the backend of target {name!r} {backend_class.reason}")
    return backend_class()
