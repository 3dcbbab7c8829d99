"""The keys that people mean by unknown keys of a document."""

from __future__ import annotations

from collections.abc import Iterable

from thorvaldc.diagnostics import nearest

# Keys of this language, and the keys of other tools and formats with the same meaning.  If a key
# has several meanings, the first in the table is preferred.
_SYNONYMS: dict[str, str] = {
    "scenario": "name",
    "thorvaldc": "version",
    "name": "robot_name",
    "can": "id node node_id can_node address",
    "id": "address",
    "mount": "parent port on attach attach_to",
    "xacro": "urdf file path include",
    "robot": "file path model",
    "type": "class kind module model",
    "kinds": "kind",
    "library": "include",
    "modules": "parts components",
    "robots": "members vehicles",
    "shape": "geometry",
    "color": "colour",
    "rpy": "rotation orientation euler angles",
    "xyz": "position translation origin pos",
    "mass": "weight",
    "rate": "frequency hz",
    "command_timeout": "timeout",
    "max_linear_velocity": "max_speed max_velocity speed_limit",
    "big_endian": "byte_order endianness endian motorola",
    "extended": "is_extended extended_id eff",
    "bitrate": "baud baudrate speed",
    "base_calculator": "controller",
    "duration": "time length",
    "at": "time t start",
    "until": "end",
    "vx": "v x speed_x",
    "wz": "omega",
    "yaw": "heading theta",
    "steering_offset": "offset",
    "end_error": "final_error",
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
    normal = unknown.lower().replace("-", "_")
    synonyms = [key for key, others in _SYNONYMS.items() if normal in others.split()]
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
