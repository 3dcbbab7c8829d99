"""Finds the key that was meant by an unknown key, also by names that other tools use."""

from __future__ import annotations

from collections.abc import Iterable

from thorvaldc.diagnostics.suggest import nearest

# Keys of other tools and formats, and the keys of this language with the same meaning.
_SYNONYMS: dict[str, tuple[str, ...]] = {
    "name": ("scenario",),
    "version": ("thorvaldc",),
    "robot_name": ("name",),
    "id": ("can",),
    "node": ("can",),
    "node_id": ("can",),
    "can_node": ("can",),
    "address": ("can", "id"),
    "parent": ("mount",),
    "port": ("mount",),
    "on": ("mount",),
    "attach": ("mount",),
    "attach_to": ("mount",),
    "class": ("type",),
    "kind": ("type", "kinds"),
    "module": ("type",),
    "parts": ("modules",),
    "components": ("modules",),
    "rotation": ("rpy",),
    "orientation": ("rpy",),
    "euler": ("rpy",),
    "angles": ("rpy",),
    "position": ("xyz",),
    "translation": ("xyz",),
    "origin": ("xyz",),
    "pos": ("xyz",),
    "weight": ("mass",),
    "frequency": ("rate",),
    "hz": ("rate",),
    "timeout": ("command_timeout",),
    "max_speed": ("max_linear_velocity",),
    "max_velocity": ("max_linear_velocity",),
    "speed_limit": ("max_linear_velocity",),
    "baud": ("bitrate",),
    "baudrate": ("bitrate",),
    "speed": ("bitrate",),
    "controller": ("base_calculator",),
    "urdf": ("xacro",),
    "file": ("xacro", "robot"),
    "path": ("xacro", "robot"),
    "model": ("robot", "type"),
    "include": ("xacro", "library"),
    "time": ("duration", "at"),
    "length": ("duration",),
    "t": ("at",),
    "start": ("at",),
    "end": ("until",),
    "v": ("vx",),
    "x": ("vx",),
    "speed_x": ("vx",),
    "omega": ("wz",),
    "heading": ("yaw",),
    "theta": ("yaw",),
    "members": ("robots",),
    "vehicles": ("robots",),
    "offset": ("steering_offset",),
    "final_error": ("end_error",),
    "geometry": ("shape",),
    "colour": ("color",),
}


def meant_key(
    unknown: str, entries: Iterable[str], known: Iterable[str], required: Iterable[str]
) -> str | None:
    """Returns the key that was probably meant by an unknown key, or ``None``.

    - ``entries``: keys of the mapping.
    - ``known``: keys that the schema defines.
    - ``required``: keys that the schema requires.  A missing required key is preferred.
    """
    present = set(entries)
    absent = [key for key in known if key not in present]
    needed = [key for key in required if key not in present]
    synonyms = _SYNONYMS.get(unknown.lower().replace("-", "_"), ())
    for candidates in (needed, absent):
        meant = next((key for key in synonyms if key in candidates), None)
        meant = meant or nearest(unknown, candidates)
        if meant is not None:
            return meant
    return None


def misspelt_keys(
    entries: Iterable[str], known: Iterable[str], required: Iterable[str]
) -> dict[str, str]:
    """Returns the required key that each unknown key of a mapping probably means.

    The parameters are those of ``meant_key``.  Two unknown keys never mean the same key.
    """
    entries, known, required = list(entries), list(known), list(required)
    meant_keys: dict[str, str] = {}
    for key in entries:
        if key not in known:
            meant = meant_key(key, [*entries, *meant_keys.values()], known, required)
            if meant in required:
                meant_keys[key] = str(meant)
    return meant_keys
