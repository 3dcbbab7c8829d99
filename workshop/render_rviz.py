"""Renders what RViz shows with the generated configuration: ``python workshop/render_rviz.py``.

RViz is not needed: the picture contains the displays of ``rviz/robot.rviz`` that have data from the
base driver alone, which are the grid, the robot and the arrows of its odometry.
"""

from __future__ import annotations

import io
import math
import sys
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
PICTURE = ROOT / "docs" / "assets" / "rviz.png"
SIZE = (1000, 600)
VIEW = render.View(205.0, -32.0)
TWIST = Twist(0.5, 0.0, 0.16)
DURATION = 9.0  # s
STEP = 0.1  # m or rad between two arrows, as the display of RViz keeps them
LENGTH = 1.0  # m, of an arrow
RED = np.array([1.0, 0.1, 0.0, 1.0])


def drive(robot: Robot, scene: MujocoScene) -> list[Pose2]:
    """Drives a curve, and returns the poses of the odometry that RViz keeps."""
    driver = BaseDriver(robot, MujocoBase(robot, scene))
    poses: list[Pose2] = []
    for cycle in range(round(DURATION * robot.driver.rate)):
        now = cycle / robot.driver.rate
        driver.command(TWIST, now)
        pose = driver.tick(now).pose
        if (
            not poses
            or max(
                math.hypot(pose.x - poses[-1].x, pose.y - poses[-1].y),
                abs(pose.yaw - poses[-1].yaw),
            )
            >= STEP
        ):
            poses.append(pose)
    return poses


def add_arrow(scene: Any, pose: Pose2) -> None:
    import mujoco  # after the choice of its OpenGL library

    turn = np.array(
        [
            [0.0, -math.sin(pose.yaw), math.cos(pose.yaw)],
            [0.0, math.cos(pose.yaw), math.sin(pose.yaw)],
            [1.0, 0.0, 0.0],
        ]
    )
    size = np.array([0.03, 0.03, LENGTH])
    place = np.array([pose.x, pose.y, 0.05])
    geom = scene.geoms[scene.ngeom]
    kind = mujoco.mjtGeom.mjGEOM_ARROW
    mujoco.mjv_initGeom(geom, kind, size, place, turn.flatten(), RED.astype(np.float32))
    scene.ngeom += 1


def main() -> int:
    render.choose_opengl_backend()
    robot = compile_file(ROOT / "examples" / "4wd4ws_wide" / "robot.yaml").model
    assert isinstance(robot, Robot)
    large = (SIZE[0] * render.SAMPLING, SIZE[1] * render.SAMPLING)
    scene = render.picture_scene(emit(robot, ["mjcf"], Report()), large, VIEW)
    poses = drive(robot, scene)
    points = np.vstack([render.visible_points(scene), [(pose.x, pose.y, 0.0) for pose in poses]])
    with render.renderer(scene, large, points) as drawing:
        drawing.update_scene(scene.data, render.fit_camera(points, VIEW, SIZE[0] / SIZE[1]))
        for pose in poses:
            add_arrow(drawing.scene, pose)
        image = Image.fromarray(drawing.render()).resize(SIZE, Image.Resampling.LANCZOS)
    image = image.quantize(256, Image.Quantize.MEDIANCUT, kmeans=2, dither=Image.Dither.NONE)
    png = io.BytesIO()
    image.save(png, "PNG", optimize=True)
    PICTURE.write_bytes(png.getvalue())
    return 0


if __name__ == "__main__":
    sys.exit(main())
