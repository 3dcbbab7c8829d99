"""Draws pictures of a scene with MuJoCo, without a display."""

from __future__ import annotations

import importlib
import io
import math
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thorvaldc.model import Fleet, Robot, robots_by_name
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.pictures import PictureError

if TYPE_CHECKING:
    from thorvaldc.simulation.pictures.surfaces import Points


SAMPLING = 2
"""Factor by which a single picture is drawn larger and then scaled down, for smooth edges."""
LARGEST = 8000
"""Largest width and height of a picture in pixels."""
FIELD_OF_VIEW = math.radians(28.0)
MARGIN = 1.06
# Directions of the key light, which casts shadows, and of the fill light without shadows.  The
# components are ahead, right and up, in a frame that rotates with the azimuth of the camera.
KEY = (0.57, 0.03, -1.0)
FILL = (-0.35, -0.86, -0.5)


@dataclass(frozen=True, slots=True)
class View:
    """A viewing direction of the camera in degrees.

    The azimuth of the camera is measured counter-clockwise from the x axis.  The elevation of the
    camera is positive upwards.
    """

    azimuth: float = 145.0
    elevation: float = -18.0


VIEWS = {
    "corner": View(),
    "front": View(180.0, -8.0),
    "rear": View(0.0, -8.0),
    "left": View(-90.0, -8.0),
    "right": View(90.0, -8.0),
    "top": View(90.0, -89.9),
}


def parse_view(text: str) -> View:
    """Parses a viewing direction: a name in ``VIEWS``, or ``azimuth,elevation`` in degrees.

    Raises ``ValueError`` if the text is invalid.
    """
    if text in VIEWS:
        return VIEWS[text]
    parts = text.split(",")
    try:
        azimuth, elevation = (float(part) for part in parts)
    except ValueError:
        azimuth = math.nan
    if not (math.isfinite(azimuth) and -90.0 <= elevation <= 90.0):
        names = ", ".join(VIEWS)
        raise ValueError(f"{text!r} is not {names}, or azimuth,elevation such as 145,-18")
    return View(azimuth % 360.0, min(max(elevation, -89.9), 89.9))


def parse_size(text: str) -> tuple[int, int]:
    """Parses the width and height of a picture in pixels, such as ``1000x700``.

    Raises ``ValueError`` if the text is invalid.
    """
    parts = text.lower().split("x")
    if len(parts) == 2 and all(part.isascii() and part.isdigit() for part in parts):
        width, height = int(parts[0]), int(parts[1])
        if 16 <= width <= LARGEST and 16 <= height <= LARGEST:
            return width, height
    raise ValueError(f"{text!r} is not a size such as 1000x700, of 16 to {LARGEST} pixels")


def render(
    model: Robot | Fleet,
    files: Mapping[str, bytes],
    size: tuple[int, int] = (1000, 700),
    view: View | None = None,
    *,
    twist: Twist = ZERO_TWIST,
    spin: float = 0.0,
) -> bytes:
    """Returns a PNG picture of a robot or a fleet in the home pose.

    ``files`` are the outputs of the ``mjcf`` backend.  The wheels are steered for the twist
    ``twist``.  Each wheel is turned by ``spin`` rad more than the previous wheel.  Raises
    ``DiagnosticError`` if MuJoCo cannot read the files, and ``PictureError`` if MuJoCo cannot draw.
    """
    from PIL import Image

    view = view or View()
    width, height = size
    large = (width * SAMPLING, height * SAMPLING)
    scene = picture_scene(files, large, view)
    _turn_wheels(model, scene, twist, spin)
    points = visible_points(scene)
    with renderer(scene, large, points) as drawing:
        drawing.update_scene(scene.data, fit_camera(points, view, width / height))
        pixels = drawing.render()
    image = Image.fromarray(pixels).resize(size, Image.Resampling.LANCZOS)
    image = image.quantize(256, Image.Quantize.MEDIANCUT, kmeans=2, dither=Image.Dither.NONE)
    png = io.BytesIO()
    image.save(png, "PNG", optimize=True)
    return png.getvalue()


def picture_scene(
    files: Path | str | Mapping[str, bytes],
    size: tuple[int, int],
    view: View,
    *,
    quick: bool = False,
) -> MujocoScene:
    """Loads a scene and adds lights for pictures.

    If ``quick`` is true, the pictures have no shadows and no smooth edges.
    """
    return MujocoScene(
        files, visuals=True, prepare=lambda spec: _set_lights(spec, view, size, quick)
    )


@contextmanager
def renderer(scene: MujocoScene, size: tuple[int, int], points: Points) -> Iterator[Any]:
    """Opens the renderer of MuJoCo for a scene.

    ``points`` (m) with the shape (n, 3) determine the extent of the scene.
    """
    import mujoco
    import numpy as np

    model = scene.model
    model.stat.center[:] = (points.min(axis=0) + points.max(axis=0)) / 2
    model.stat.extent = float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
    model.vis.map.znear = 0.01
    try:
        mujoco_renderer = mujoco.Renderer(model, size[1], size[0], max_geom=model.ngeom + 1000)
    except Exception as error:  # each OpenGL library raises its own kind of error
        reason = " ".join(str(error).split()) or type(error).__name__
        raise PictureError(f"MuJoCo cannot draw without a display: {reason}") from error
    with mujoco_renderer:
        yield mujoco_renderer


def _set_lights(spec: Any, view: View, size: tuple[int, int], quick: bool) -> None:
    """Sets the lights and the colour of the ground for pictures.

    The key light (the main light of the picture) casts a soft shadow.  The fill light comes from
    the side opposite to the key light.
    """
    import mujoco

    for light in list(spec.lights):
        spec.delete(light)
    turn = math.radians(view.azimuth)
    c, s = math.cos(turn), math.sin(turn)
    key, fill = (
        [along * c + right * s, along * s - right * c, up] for along, right, up in (KEY, FILL)
    )
    spec.worldbody.add_light(
        name="key",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[-8 * v for v in key],
        dir=key,
        diffuse=[0.62, 0.61, 0.58],
        specular=[0.25, 0.25, 0.25],
        castshadow=not quick,
    )
    spec.worldbody.add_light(
        name="fill",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[0, 0, 12],
        dir=fill,
        diffuse=[0.22, 0.24, 0.28],
        specular=[0.0, 0.0, 0.0],
        castshadow=False,
    )
    visual = spec.visual
    visual.headlight.ambient = [0.34, 0.34, 0.35]
    visual.headlight.diffuse = [0.22, 0.22, 0.22]
    visual.headlight.specular = [0.08, 0.08, 0.08]
    visual.global_.offwidth, visual.global_.offheight = size
    visual.global_.fovy = math.degrees(FIELD_OF_VIEW)
    visual.quality.shadowsize = 0 if quick else 8192
    visual.quality.offsamples = 0 if quick else 4
    visual.map.shadowclip = 1.0
    visual.map.shadowscale = 1.0
    visual.rgba.haze = [0.93, 0.94, 0.95, 1]
    for texture in spec.textures:
        if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            texture.rgb1, texture.rgb2 = [0.97, 0.98, 0.99], [0.90, 0.92, 0.94]
        else:
            texture.rgb1, texture.rgb2 = [0.80, 0.81, 0.78], [0.77, 0.78, 0.75]
            texture.markrgb = [0.71, 0.72, 0.69]


def _turn_wheels(model: Robot | Fleet, scene: MujocoScene, twist: Twist, spin: float) -> None:
    """Steers the wheels for the twist ``twist`` and turns the wheels about their spin joints.

    Each wheel is turned by ``spin`` rad more than the previous wheel.
    """
    position = scene.data.qpos
    for robot in robots_by_name(model).values():
        prefix = robot.prefix
        for index, wheel in enumerate(robot.wheels):
            axle = scene.index("joint", prefix + wheel.spin_joint, robot)
            position[scene.model.jnt_qposadr[axle]] += spin * (index + 1)
            if wheel.steering_joint is not None and any(twist):
                angle = math.atan2(twist.vy + twist.wz * wheel.x, twist.vx - twist.wz * wheel.y)
                joint = scene.index("joint", prefix + wheel.steering_joint, robot)
                steering = wheel.steering_sign * (angle - wheel.heading)
                position[scene.model.jnt_qposadr[joint]] = steering
    scene.forward()


def visible_points(scene: MujocoScene) -> Points:
    """Returns the corner points of all visible geoms of movable bodies.

    The points are in the world frame (m), with the shape (n, 3).
    """
    import mujoco
    import numpy as np

    model, data = scene.model, scene.data
    points = []
    for g in range(model.ngeom):
        if model.geom_group[g] > 2 or model.geom_bodyid[g] == 0:
            continue
        if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[g]
            start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            local = model.mesh_vert[start : start + count].astype(np.float64)
        else:
            centre, half = model.geom_aabb[g][:3], model.geom_aabb[g][3:]
            signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
            local = centre + signs * half
        points.append(local @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g])
    return np.vstack(points) if points else np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])


def fit_camera(points: Points, view: View, aspect: float) -> Any:
    """Returns a camera (``MjvCamera``) that shows all points in the centre of the picture.

    Let c be the look-at point of the camera, and d the distance of the camera from c.  A point has
    the coordinates (x, y, depth) relative to c, along the camera axes right, up and forward.  The
    point is in the picture if |x| <= (d + depth) tan(fov_x / 2) and
    |y| <= (d + depth) tan(fov_y / 2).

    The first step computes the smallest camera distance d, the maximum of
    |x| / tan(fov_x / 2) - depth and |y| / tan(fov_y / 2) - depth over all points.  The second step
    moves the look-at point c to the centre of the projected points.  The function repeats both
    steps until the camera converges.
    """
    import mujoco
    import numpy as np

    a, e = math.radians(view.azimuth), math.radians(view.elevation)
    forward = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([math.sin(a), -math.cos(a), 0.0])
    up = np.cross(right, forward)
    tan_y = math.tan(FIELD_OF_VIEW / 2) / MARGIN
    tan_x = tan_y * aspect
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    distance = 1.0
    for _ in range(20):
        relative = points - centre
        x, y, depth = relative @ right, relative @ up, relative @ forward
        distance = float(np.max(np.maximum(np.abs(x) / tan_x, np.abs(y) / tan_y) - depth))
        px, py = x / (distance + depth), y / (distance + depth)
        centre = centre + distance * (
            right * (px.max() + px.min()) / 2 + up * (py.max() + py.min()) / 2
        )
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = centre
    camera.distance = distance
    camera.azimuth = view.azimuth
    camera.elevation = view.elevation
    return camera


# -- OpenGL without a display ----------------------------------------------------------------------

VARIABLE = "MUJOCO_GL"
_PROBE = "import mujoco; mujoco.GLContext(8, 8).make_current()"
_MISSING = (
    "cannot draw without a display: neither EGL nor OSMesa works"
    " (on Debian and Ubuntu: apt install libosmesa6, or libegl1 libgl1 libgl1-mesa-dri)"
)


def choose_opengl_backend() -> None:
    """Sets the environment variable ``MUJOCO_GL`` to an OpenGL backend that works.

    Call the function before MuJoCo is imported, if possible.  The function does not change a value
    that the user sets.  On Linux the function tries EGL first, then OSMesa.  Each backend is tried
    in a separate process, because the libraries of a backend stay loaded after a failure.  Raises
    ``PictureError`` if no backend works.
    """
    if sys.platform != "linux":
        return
    user_choice = os.environ.get(VARIABLE, "")
    is_imported = "mujoco" in sys.modules
    if is_imported and user_choice:
        return
    for name in [user_choice] if user_choice else ["egl", "osmesa"]:
        if _works(name):
            os.environ[VARIABLE] = name
            if is_imported:
                _reload_mujoco_context()
            return
    if user_choice:
        raise PictureError(f"MuJoCo cannot draw with {VARIABLE}={user_choice}; unset or correct it")
    raise PictureError(_MISSING)


def _reload_mujoco_context() -> None:
    """Reloads the MuJoCo modules that read ``MUJOCO_GL`` on import."""
    for name in ("mujoco.rendering.classic.gl_context", "mujoco.gl_context"):
        module = sys.modules.get(name)
        if module is not None:
            importlib.reload(module)


def _works(name: str) -> bool:
    try:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env={**os.environ, VARIABLE: name},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=60.0,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return probe.returncode == 0


class BoundingBoxes:
    """Bounding boxes of the visible geoms that can move.

    The bounding boxes are a fast estimate of the extent of the robots.
    """

    def __init__(self, scene: MujocoScene) -> None:
        import numpy as np

        model = scene.model
        visible = (model.geom_group <= 2) & (model.geom_bodyid > 0)
        self._geoms = np.flatnonzero(visible)
        signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        centre, half = model.geom_aabb[visible, None, :3], model.geom_aabb[visible, None, 3:]
        self._local = centre + signs * half

    def corners(self, scene: MujocoScene) -> Points:
        """Returns the corners of all bounding boxes in the world frame (m), as an (n, 3) array."""
        import numpy as np

        if not len(self._geoms):
            return np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])
        rotations = scene.data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        positions = scene.data.geom_xpos[self._geoms][:, None, :]
        world: Points = (self._local @ rotations.transpose(0, 2, 1) + positions).reshape(-1, 3)
        return world
