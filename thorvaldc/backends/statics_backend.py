"""The base class of backends for formats with a standing pose or wheel contacts."""

from __future__ import annotations

import abc
from collections.abc import Sequence

from thorvaldc.backends import Backend
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.statics.standing_pose import Statics, solve_statics


class StaticsBackend(Backend):
    """A backend that needs the statics: standing pose, wheel contacts, inertia on each joint.

    The compiler solves the statics once for each robot and passes them to all such backends.
    ``emit`` and ``emit_fleet`` are for callers that have only the model.
    """

    @abc.abstractmethod
    def emit_with_statics(self, robot: Robot, statics: Statics) -> dict[str, bytes]:
        """Return the files of one robot, as ``emit``."""

    def emit_fleet_with_statics(self, fleet: Fleet, statics: Sequence[Statics]) -> dict[str, bytes]:
        """Return the files of a fleet, as ``emit_fleet``.

        ``statics`` has those of each placement, in order.
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
