"""Runs one backend on a robot or a fleet."""

from __future__ import annotations

from thorvaldc.backends import Backend
from thorvaldc.model import Fleet, Robot


def files_of(backend: type[Backend], model: Robot | Fleet) -> dict[str, bytes]:
    """Returns the files of a robot or a fleet."""
    return backend().emit(model) if isinstance(model, Robot) else backend().emit_fleet(model)
