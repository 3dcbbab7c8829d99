"""The files of one backend, emitted as the pipeline does it."""

from __future__ import annotations

from thorvaldc.backends import Backend
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.statics.standing_pose import solve_statics


def files_of(backend: type[Backend], model: Robot | Fleet) -> dict[str, bytes]:
    """The files of a robot or a fleet, with its statics solved."""
    if isinstance(model, Robot):
        return backend().emit(model, solve_statics(model))
    return backend().emit_fleet(model, [solve_statics(p.robot) for p in model.placements])
