"""Writes the meshes of the library and the examples: ``python workshop/make_meshes.py [--check]``.

The meshes of a module go to ``modules/<type>/meshes/``, those of an example to
``examples/<name>/meshes/``.  ``--check`` writes nothing and exits with 1 if a file is not up
to date.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from mesh_drives import caster, drive, steering, suspension, tube_clamp
from mesh_frames import (
    battery,
    camera,
    end_cap,
    frame_clamps,
    gnss,
    imu,
    lidar,
    portal,
    sensor_hood,
    sheet_metal,
)
from mesh_solids import Meshes, to_stl
from mesh_wheels import agricultural_tyre, greenhouse_wheel, passive_wheel, rim, spokes, wheel_bolts

ROOT = Path(__file__).resolve().parent.parent

LIBRARY: dict[str, Callable[[], Meshes]] = {
    "wheel/agri_200": lambda: {
        "tyre": agricultural_tyre(14),
        "rim": rim(0.52),
        "spokes": spokes(0.52, 6),
        "bolts": wheel_bolts(0.155, 6),
    },
    "wheel/greenhouse_double": greenhouse_wheel,
    "wheel/passive": passive_wheel,
    "drive/standard": drive,
    "steering/standard": steering,
    "suspension/standard": suspension,
    "caster/swivel": lambda: caster(True),
    "caster/fixed": lambda: caster(False),
    "battery/enclosure": battery,
    "frame/tube_rectangular": frame_clamps,
    "frame/tube": lambda: {"end_cap": end_cap()},
    "frame/corner": lambda: {"clamp": tube_clamp(0.1, 0.1, 0.08).scaled(10.0, 10.0, 10.0)},
    "frame/portal": portal,
    "frame/sheet_metal": sheet_metal,
    "sensor/lidar_2d": lidar,
    "sensor/gnss_antenna": gnss,
    "sensor/imu": imu,
    "sensor/camera": camera,
}


EXAMPLES: dict[str, Callable[[], Meshes]] = {
    "4wd2ws_tall": sensor_hood,
}


def make_all() -> dict[str, bytes]:
    """Returns all mesh files, by path in the repository."""
    folders = {f"modules/{name}": make for name, make in LIBRARY.items()}
    folders |= {f"examples/{name}": make for name, make in EXAMPLES.items()}
    return {
        f"{folder}/meshes/{name}.stl": to_stl(solid)
        for folder, make in folders.items()
        for name, solid in make().items()
    }


def main(arguments: list[str]) -> int:
    """Writes the meshes, or with ``--check`` compares them with the files."""
    stale = 0
    for path, data in make_all().items():
        file = ROOT / path
        if file.is_file() and file.read_bytes() == data:
            continue
        stale += 1
        print(path, len(data))
        if "--check" not in arguments:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
    return 1 if stale and "--check" in arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
