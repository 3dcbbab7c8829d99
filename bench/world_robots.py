"""Twelve families of robots for ``bench.broken_world``: examples, and descriptions that differ."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from bench.robots import built, example

if TYPE_CHECKING:
    from thorvaldc.model import Robot

_SIZE = "{length: 1.1 m, width: 0.9 m, cross_members: [0]}"
_FRAME = f"frame: {{type: frame/tube_rectangular, params: {_SIZE}}}"
_PLACE = "{parent: frame, xyz: [0, 0, 0.07], rpy: [0, 0, 90 deg]}"
_BATTERY = f"battery: {{type: battery/enclosure, mount: {_PLACE}, can: 1}}"
_CORNERS = ("front_left", "front_right", "rear_left", "rear_right")
_THREE = ("front_center", "rear_left", "rear_right")

_EXAMPLES = {
    "2 fixed, casters": "2wd0ws_greenhouse",
    "4 steered, wide": "4wd4ws_wide",
    "4 steered, narrow": "4wd4ws_slim",
    "6 steered": "6wd6ws",
    "9 steered": "9wd9ws",
    "tricycle": "1wd1ws_front",
    "car": "car",
    "2 fixed, 2 steered": "4wd2ws_tall",
}
_DESCRIPTIONS = {
    "4 skid": ("fixed_drive",) * 4,
    "6 skid": ("fixed_drive",) * 6,
    "3 steered": ("steered_drive",) * 3,
    "2 steered, diagonal": ("steered_drive", "", "", "steered_drive"),
}
"""Kinds of the wheels at ``_CORNERS``, at ``_THREE``, or at all corners and in the middle."""
NAMES = (*_EXAMPLES, *_DESCRIPTIONS)


def robot(name: str) -> tuple[Robot, dict[str, bytes]]:
    """Returns the robot of a family and its MJCF files."""
    if name in _EXAMPLES:
        return built(example(_EXAMPLES[name]))
    with TemporaryDirectory() as folder:
        path = Path(folder, "robot.yaml")
        path.write_text(_description(_DESCRIPTIONS[name]), encoding="utf-8")
        return built(path)


def _description(kinds: tuple[str, ...]) -> str:
    places = _THREE if len(kinds) == 3 else (*_CORNERS, "mid_left", "mid_right")
    lines = ["thorvaldc: 1", "name: bench_robot", "base_calculator: general", "modules:"]
    lines += [f"  {_FRAME}", f"  {_BATTERY}"]
    for i, (kind, place) in enumerate(zip(kinds, places, strict=False)):
        part = f"assembly/{kind}" if kind else "caster/swivel"
        lines.append(f"  w{i}: {{type: {part}, mount: frame.{place}{_can(kind, i)}}}")
    fixed = [i for i, kind in enumerate(kinds) if kind == "fixed_drive"]
    for left, right in zip(fixed[::2], fixed[1::2], strict=True):
        channels = f"{{left: w{left}.propulsion, right: w{right}.propulsion}}"
        module = f"type: controller/propulsion_propulsion, channels: {channels}, can: {left + 1}"
        lines.append(f"  controller_{left}: {{{module}}}")
    return "\n".join(lines) + "\n"


def _can(kind: str, number: int) -> str:
    return f", can: {number + 1}" if kind == "steered_drive" else ""
