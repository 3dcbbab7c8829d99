"""Reads MJCF files with the object model of dm_control (``mjcf.from_path``)."""

from __future__ import annotations

from typing import Any

from dm_control import mjcf
from mujoco_reader import facts_of
from reader_program import main


def read(path: str, states: list[dict[str, float]]) -> dict[str, Any]:
    physics = mjcf.Physics.from_mjcf_model(mjcf.from_path(path))
    return facts_of(physics.model.ptr, states)


if __name__ == "__main__":
    main(read)
