"""Renders robots that drive: ``python workshop/render_drives.py``.

- ``docs/assets/rviz.png``: what RViz shows with the generated configuration.  RViz is not needed;
  the picture contains the displays of ``rviz/robot.rviz`` that have data from the base driver
  alone, which are the grid, the robot and the arrows of its odometry.
- ``docs/assets/scout.webp``: the robot of the README, whose file is the one that stands there.
"""

from __future__ import annotations

import io
import math
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.se2 import Pose2, Twist
from thorvaldc.simulation.physics.mujoco_base import MujocoBase
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.pictures import render

ROOT = Path(__file__).resolve().parent.parent
ASSETS = ROOT / "docs" / "assets"
Script = tuple[tuple[float, Twist], ...]
"""Durations (s) and twists, one after another."""

CURVE: Script = ((9.0, Twist(0.5, 0.0, 0.16)),)
STEP = 0.1  # m or rad between two arrows, as the display of RViz keeps them
LENGTH = 1.0  # m, of an arrow
RED = np.array([1.0, 0.1, 0.0, 1.0], dtype=np.float32)

DANCE: Script = (
    (0.3, Twist(0.0, 0.0, 0.0)),
    (2.2, Twist(0.9, 0.0, 0.7)),
    (2.0, Twist(0.6, 0.6, 0.0)),
    (2.4, Twist(0.0, 0.0, 1.2)),
    (2.0, Twist(0.0, -0.9, 0.0)),
    (0.8, Twist(0.0, 0.0, 0.0)),
)
FRAMES = 10.0  # 1/s
SMALL = (420, 300)
QUALITY = 40


def robot_of(file: Path) -> Robot:
    compilation = compile_file(file)
    if not isinstance(compilation.model, Robot):
        raise SystemExit("\n".join(f"{d.span}: {d.message}" for d in compilation.report))
    return compilation.model


def drive(robot: Robot, scene: MujocoScene, script: Script) -> Iterator[tuple[float, Pose2]]:
    """Drives a robot, and yields the time and the pose of the odometry after each control cycle."""
    driver = BaseDriver(robot, MujocoBase(robot, scene))
    now = end = 0.0
    for duration, twist in script:
        end += duration
        while now < end:
            driver.command(twist, now)
            yield now, driver.tick(now).pose
            now += 1.0 / robot.driver.rate


def pixels_of(drawing: Any, size: tuple[int, int]) -> Image.Image:
    return Image.fromarray(drawing.render()).resize(size, Image.Resampling.LANCZOS)


def add_arrow(scene: Any, pose: Pose2) -> None:
    import mujoco  # after the choice of its OpenGL library

    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    turn = np.array([[0.0, -s, c], [0.0, c, s], [1.0, 0.0, 0.0]])
    place = np.array([pose.x, pose.y, 0.05])
    geom = scene.geoms[scene.ngeom]
    kind, size = mujoco.mjtGeom.mjGEOM_ARROW, np.array([0.03, 0.03, LENGTH])
    mujoco.mjv_initGeom(geom, kind, size, place, turn.flatten(), RED)
    scene.ngeom += 1


def rviz() -> bytes:
    robot = robot_of(ROOT / "examples" / "4wd4ws_wide" / "robot.yaml")
    size, view = (1000, 600), render.View(205.0, -32.0)
    large = (size[0] * render.SAMPLING, size[1] * render.SAMPLING)
    scene = render.picture_scene(emit(robot, ["mjcf"], Report()), large, view)
    poses: list[Pose2] = []
    for _, pose in drive(robot, scene, CURVE):
        last = poses[-1] if poses else Pose2(math.inf, 0.0, 0.0)
        moved = math.hypot(pose.x - last.x, pose.y - last.y)
        if moved >= STEP or abs(pose.yaw - last.yaw) >= STEP:
            poses.append(pose)
    places = [(pose.x, pose.y, 0.0) for pose in poses]
    points = np.vstack([render.visible_points(scene), places])
    with render.renderer(scene, large, points) as drawing:
        drawing.update_scene(scene.data, render.fit_camera(points, view, size[0] / size[1]))
        for pose in poses:
            add_arrow(drawing.scene, pose)
        image = pixels_of(drawing, size)
    image = image.quantize(256, Image.Quantize.MEDIANCUT, kmeans=2, dither=Image.Dither.NONE)
    png = io.BytesIO()
    image.save(png, "PNG", optimize=True)
    return png.getvalue()


def scout() -> bytes:
    (text, *_) = re.findall(r"```yaml\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.S)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.yaml"
        file.write_text(text, "utf-8")
        robot = robot_of(file)
    view = render.View(135.0, -24.0)
    large = (SMALL[0] * render.SAMPLING, SMALL[1] * render.SAMPLING)
    scene = render.picture_scene(emit(robot, ["mjcf"], Report()), large, view)
    points = render.visible_points(scene)
    spread = points.max(axis=0) - points.min(axis=0)
    around = np.vstack([points, points + 0.2 * spread, points - 0.2 * spread])
    camera = render.fit_camera(around, view, SMALL[0] / SMALL[1])
    centre = np.array(camera.lookat)
    frames: list[Image.Image] = []
    with render.renderer(scene, large, around) as drawing:
        for time, pose in drive(robot, scene, DANCE):
            if time * FRAMES < len(frames):
                continue
            camera.lookat[:] = centre + np.array([pose.x, pose.y, 0.0])
            drawing.update_scene(scene.data, camera)
            frames.append(pixels_of(drawing, SMALL))
    webp = io.BytesIO()
    options = {"save_all": True, "append_images": frames[1:], "duration": round(1000 / FRAMES)}
    frames[0].save(webp, "WEBP", **options, loop=0, quality=QUALITY, method=6)
    return webp.getvalue()


def main() -> int:
    render.choose_opengl_backend()
    for name, picture in (("rviz.png", rviz), ("scout.webp", scout)):
        content = picture()
        (ASSETS / name).write_bytes(content)
        print(f"{name}: {len(content) // 1000} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
