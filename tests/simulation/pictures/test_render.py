"""Pictures of a scene: the camera, the options and the drawn pixels."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import needs_tools
from tests.outside_tools import require
from thorvaldc.simulation.physics.mujoco_scene import SCENE, MujocoScene
from thorvaldc.simulation.pictures import PictureError, render
from thorvaldc.simulation.pictures.render import (
    FIELD_OF_VIEW,
    VIEWS,
    View,
    fit_camera,
    parse_size,
    parse_view,
    visible_points,
)
from thorvaldc.simulation.pictures.video import VideoRecorder, encoder


@pytest.mark.parametrize("view", [*VIEWS.values(), View(10.0, -45.0), View(77.0, 30.0)])
@pytest.mark.parametrize("aspect", [0.5, 1.6])
def test_all_points_are_in_the_picture(view: View, aspect: float) -> None:
    points = np.random.default_rng(3).uniform((-2.0, 1.0, 0.0), (3.0, 2.0, 1.5), (200, 3))
    camera = fit_camera(points, view, aspect)
    a, e = math.radians(camera.azimuth), math.radians(camera.elevation)
    ahead = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([math.sin(a), -math.cos(a), 0.0])
    from_eye = points - (camera.lookat - camera.distance * ahead)
    depth = from_eye @ ahead
    tan = math.tan(FIELD_OF_VIEW / 2)
    across = from_eye @ right / depth / (tan * aspect)
    along = from_eye @ np.cross(right, ahead) / depth / tan
    assert depth.min() > 0.0
    reach = [across.min(), across.max(), along.min(), along.max()]
    assert max(map(abs, reach)) == pytest.approx(1 / 1.06, abs=0.01)  # the points fill the picture
    assert abs(across.min() + across.max()) < 0.02
    assert abs(along.min() + along.max()) < 0.02


def test_visible_points_of_boxes_and_meshes() -> None:
    xml = b"""<mujoco>
      <asset><mesh name="m" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/></asset>
      <worldbody>
        <geom type="plane" size="9 9 1"/>
        <body pos="5 0 0"><freejoint/>
          <geom type="box" size="0.5 0.25 2" mass="1"/>
          <geom type="mesh" mesh="m" pos="-6 0 0" mass="1"/>
          <geom type="sphere" size="9" group="3" mass="1"/>
        </body>
      </worldbody>
    </mujoco>"""
    scene = MujocoScene({SCENE: xml}, visuals=True)
    points = visible_points(scene)
    assert points.min(axis=0) == pytest.approx([-1.0, -0.25, -2.0], abs=1e-6)
    assert points.max(axis=0) == pytest.approx([5.5, 1.0, 2.0], abs=1e-6)
    assert len(points) == 8 + 4  # the corners of the box and of the mesh


def test_views_and_sizes_as_text() -> None:
    assert parse_view("left") == VIEWS["left"]
    assert parse_view("-10,-30") == View(350.0, -30.0)
    assert parse_size("640X480") == (640, 480)
    for text in ("behind", "10", "10,100", "nan,0", "1,2,3", ""):
        with pytest.raises(ValueError, match="is not corner, front"):
            parse_view(text)
    for text in ("640", "640x", "8x8", "640x480x3", "9000x10", "-64x480", "٦٤x٦٤"):
        with pytest.raises(ValueError, match="is not a size such as"):
            parse_size(text)


@needs_tools
def test_a_picture_shows_the_robot(drawn: Path) -> None:
    from PIL import Image

    with Image.open(drawn / "robot.png") as picture:
        assert picture.size == (320, 240)
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3).astype(int)
    red = np.mean((pixels[:, 0] > 120) & (pixels[:, 1] < 80))  # the forks
    black = np.mean(pixels.max(axis=1) < 60)  # the tyres
    assert red > 0.005
    assert black > 0.02


@needs_tools
def test_a_gif_shows_the_robot_moving(drawn: Path) -> None:
    from PIL import Image

    with Image.open(drawn / "run.gif") as film:
        assert film.size == (640, 360)
        assert film.n_frames == 13  # type: ignore[attr-defined]
        assert film.info["duration"] == 80
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(12)
        last = np.asarray(film.convert("RGB")).astype(int)
    assert np.mean(abs(last - first).max(axis=2) > 40) > 0.01


@needs_tools
def test_an_mp4_has_its_size_and_rate(drawn: Path) -> None:
    data = (drawn / "run.mp4").read_bytes()
    assert data[4:8] == b"ftyp"
    output = subprocess.run(
        [encoder(), "-hide_banner", "-i", str(drawn / "run.mp4")],
        capture_output=True,
        text=True,
        errors="replace",
    ).stderr
    assert "960x540" in output
    assert "25 fps" in output


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a folder with pictures, drawn by the command in its own process.

    MuJoCo chooses what it draws by when it is imported, which the tests did long ago.
    """
    require("OpenGL")
    folder = tmp_path_factory.mktemp("drawn")
    robot = Path(__file__).parents[3] / "examples" / "4wd4ws_slim" / "robot.yaml"
    run = ["sim", str(robot), "--twist", "1,0,1", "--duration", "1", "--video"]
    for arguments in (
        ["render", str(robot), "-o", "robot.png", "--size", "320x240"],
        [*run, "run.gif"],
        [*run, "run.mp4"],
    ):
        subprocess.run(
            [sys.executable, "-m", "thorvaldc", *arguments],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": ":".join(p for p in sys.path if p)},
            check=True,
            capture_output=True,
        )
    assert sorted(p.name for p in folder.iterdir()) == ["robot.png", "run.gif", "run.mp4"]
    return folder


def test_egl_is_tried_first_then_osmesa_then_there_is_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delitem(sys.modules, "mujoco", raising=False)
    monkeypatch.setenv("MUJOCO_GL", "")
    tried: list[str] = []

    def works(name: str) -> bool:
        tried.append(name)
        return name == "osmesa"

    monkeypatch.setattr(render, "_works", works)
    render.choose_opengl_backend()
    assert tried == ["egl", "osmesa"]
    assert os.environ["MUJOCO_GL"] == "osmesa"
    monkeypatch.setattr(render, "_works", lambda name: False)
    with pytest.raises(PictureError, match="cannot draw with MUJOCO_GL=osmesa"):
        render.choose_opengl_backend()
    monkeypatch.setenv("MUJOCO_GL", "")
    with pytest.raises(PictureError, match="neither EGL nor OSMesa works"):
        render.choose_opengl_backend()


def test_without_an_encoder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(PictureError, match=r"or name a \.gif"):
        encoder()


def test_a_video_stores_positions_when_a_picture_is_due(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Scene:
        time = 0.0

        class data:
            qpos = np.zeros(3)

    film = VideoRecorder(10.0)
    for k in range(101):
        Scene.time = k * 0.01
        film.on_tick(Scene)  # type: ignore[arg-type]
    assert len(film._positions) == 11
    # After an error the existing file remains.
    old = tmp_path / "a.gif"
    old.write_bytes(b"old")
    monkeypatch.setattr(VideoRecorder, "_pictures", lambda *a: iter(()))
    with pytest.raises(StopIteration):
        film.write({}, old)
    assert old.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.gif"]
