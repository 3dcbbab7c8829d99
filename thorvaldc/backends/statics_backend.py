"""The base class of backends for formats with a standing pose or wheel contacts."""

from __future__ import annotations

import abc
from collections.abc import Sequence

from thorvaldc.backends import Backend
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.statics.standing_pose import Statics, solve_statics


class StaticsBackend(Backend):
    """A backend that needs the statics of a robot: the standing pose, the wheel contacts and the
    joint inertias.

    The compiler solves the statics of a robot once and passes the result to all backends of this
    class. Callers that have only the robot model call ``emit`` or ``emit_fleet``.
    """

    @abc.abstractmethod
    def emit_with_statics(self, robot: Robot, statics: Statics) -> dict[str, bytes]:
        """Return the output files of one robot by their POSIX path relative to the build folder."""

    def emit_fleet_with_statics(self, fleet: Fleet, statics: Sequence[Statics]) -> dict[str, bytes]:
        """Return the output files of a fleet by their POSIX path relative to the build folder.

        ``statics`` lists the statics of each robot, in the order of the fleet file.
        """
        return {
            f"{placement.name}/{path}": data
            for placement, robot_statics in zip(fleet.placements, statics, strict=True)
            for path, data in self.emit_with_statics(placement.robot, robot_statics).items()
        }

    def emit(self, robot: Robot) -> dict[str, bytes]:
        return self.emit_with_statics(robot, solve_statics(robot))

    def emit_fleet(self, fleet: Fleet) -> dict[str, bytes]:
        return self.emit_fleet_with_statics(
            fleet, [solve_statics(placement.robot) for placement in fleet.placements]
        )
