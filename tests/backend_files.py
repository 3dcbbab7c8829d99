"""Runs one backend on a robot or a fleet."""

from __future__ import annotations

from typing import Any

from thorvaldc.backends import Backend
from thorvaldc.model import Bus, Fleet, FrameDefinition, Robot


def files_of(backend: type[Backend], model: Robot | Fleet) -> dict[str, bytes]:
    """Returns the files of a robot or a fleet."""
    return backend().emit(model) if isinstance(model, Robot) else backend().emit_fleet(model)


def dbc_of(robot: Robot, bus: Bus, files: dict[str, bytes]) -> bytes:
    """Returns the DBC of a bus of a robot from the files of the target ``can``."""
    return files["can/robot.dbc" if len(robot.buses) == 1 else f"can/{bus.name}.dbc"]


def dbc_message(database: Any, frame: FrameDefinition) -> Any:
    """Returns the message of cantools for a frame; 11-bit and 29-bit identifiers may be equal."""
    (message,) = (
        message
        for message in database.messages
        if (message.frame_id, message.is_extended_frame) == (frame.cob_id, frame.extended)
    )
    return message
