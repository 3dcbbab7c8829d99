"""Renders the examples: ``python workshop/render_examples.py [NAME ...]``.

The script compiles each example and writes its picture to ``examples/<name>/picture.png``.
The environment variable ``MUJOCO_GL`` selects the OpenGL backend.  Without it, the script uses
EGL or OSMesa, whichever works.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.pictures.render import View, choose_opengl_backend, render

ROOT = Path(__file__).resolve().parent.parent
SPIN = 0.35  # rad between the angles of successive wheels, so that they do not look alike


class Look(NamedTuple):
    """The pose of the camera, and the twist that determines the steering angles."""

    view: View = View()
    twist: Twist = ZERO_TWIST


LOOKS = {
    "4wd4ws_wide": Look(twist=Twist(1.0, 0.0, 0.45)),
    "4wd2ws_tall": Look(View(150.0, -12.0), Twist(1.0, 0.0, 0.25)),
    "car": Look(twist=Twist(0.8, 0.0, 0.4)),
    "6wd6ws": Look(twist=Twist(1.0, 0.0, 0.4)),
    "1wd1ws_rear": Look(View(azimuth=40.0), Twist(1.0, 0.0, 0.4)),
    "1wd1ws_front": Look(twist=Twist(1.0, 0.0, 0.4)),
    "2wd0ws_greenhouse": Look(View(140.0, -20.0)),
    "4wd4ws_slim": Look(twist=Twist(1.0, 0.4, 0.0)),
    "9wd9ws": Look(View(elevation=-24.0), Twist(1.0, 0.0, 0.35)),
    "6wd6ws_asymmetric": Look(View(elevation=-22.0), Twist(1.0, 0.3, 0.3)),
    "odrive": Look(View(140.0, -20.0)),
    "vesc": Look(View(140.0, -20.0)),
    "jk_bms": Look(View(140.0, -20.0)),
    "lss": Look(View(140.0, -20.0)),
    "fleet_of_four": Look(View(150.0, -27.0)),
}


def render_example(name: str) -> bytes:
    """Returns the picture of an example as PNG; raises ``SystemExit`` if it does not compile."""
    folder = ROOT / "examples" / name
    file = next(folder / f for f in ("robot.yaml", "fleet.yaml") if (folder / f).is_file())
    compilation = compile_file(file)
    if compilation.model is None:
        raise SystemExit("\n".join(f"{d.span}: {d.message}" for d in compilation.report))
    look = LOOKS.get(name, Look())
    files = emit(compilation.model, ["mjcf"], Report())
    return render(compilation.model, files, view=look.view, twist=look.twist, spin=SPIN)


def main(names: list[str]) -> int:
    """Renders the named examples, by default all."""
    choose_opengl_backend()
    for name in names or sorted(p.name for p in (ROOT / "examples").iterdir() if p.is_dir()):
        picture = render_example(name)
        (ROOT / "examples" / name / "picture.png").write_bytes(picture)
        print(f"{name}: {len(picture) // 1000} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
