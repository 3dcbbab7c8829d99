"""Renders the examples: ``python tools/render_examples.py [NAME ...]``.

Each example is compiled, its MJCF scene loaded and a picture written to
``examples/<name>/picture.png``.  ``MUJOCO_GL`` is ``egl`` unless it is set.
"""

from __future__ import annotations

import io
import math
import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from thorvaldc.diagnostics import Report
from thorvaldc.model import Fleet, Robot
from thorvaldc.pipeline import compile_file, emit

os.environ.setdefault("MUJOCO_GL", "egl")
import mujoco

ROOT = Path(__file__).resolve().parent.parent
WIDTH, HEIGHT = 1000, 700
SAMPLING = 2  # rendered larger, then scaled down
FIELD_OF_VIEW = math.radians(28.0)
MARGIN = 1.06
# Directions of the light with the shadow and of the one without, in the camera's
# heading: ahead, to the right, up.
KEY = (0.57, 0.03, -1.0)
FILL = (-0.35, -0.86, -0.5)

Points = npt.NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """Camera angles in degrees; the twist (m/s, m/s, rad/s) that the wheels are turned for."""

    azimuth: float = 145.0
    elevation: float = -18.0
    twist: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spin: float = 0.35


VIEWS = {
    "4wd4ws_wide": View(twist=(1.0, 0.0, 0.45)),
    "4wd2ws_tall": View(azimuth=150.0, elevation=-12.0, twist=(1.0, 0.0, 0.25)),
    "6wd6ws": View(twist=(1.0, 0.0, 0.4)),
    "1wd1ws_rear": View(azimuth=40.0, twist=(1.0, 0.0, 0.4)),
    "1wd1ws_front": View(twist=(1.0, 0.0, 0.4)),
    "2wd0ws_greenhouse": View(azimuth=140.0, elevation=-20.0),
    "4wd4ws_slim": View(twist=(1.0, 0.4, 0.0)),
    "9wd9ws": View(elevation=-24.0, twist=(1.0, 0.0, 0.35)),
    "6wd6ws_asymmetric": View(elevation=-22.0, twist=(1.0, 0.3, 0.3)),
    "fleet_of_four": View(azimuth=150.0, elevation=-27.0),
}


def render(name: str) -> bytes:
    """The picture of an example as PNG.  ``SystemExit`` where it does not compile."""
    folder = ROOT / "examples" / name
    file = next(folder / f for f in ("robot.yaml", "fleet.yaml") if (folder / f).is_file())
    compilation = compile_file(file)
    if compilation.model is None:
        raise SystemExit("\n".join(f"{d.span}: {d.message}" for d in compilation.report))
    view = VIEWS.get(name, View())
    with tempfile.TemporaryDirectory() as made:
        for path, data in emit(compilation.model, ["mjcf"], Report()).items():
            target = Path(made) / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
        spec = mujoco.MjSpec.from_file(str(Path(made) / "mjcf" / "scene.xml"))
        _set_lights(spec, view)
        model = spec.compile()
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    _turn_wheels(compilation.model, model, data, view)
    mujoco.mj_forward(model, data)
    return _picture(model, data, view)


def _set_lights(spec: mujoco.MjSpec, view: View) -> None:
    """A key light with a soft shadow, a fill from the other side, a plain ground."""
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
        castshadow=True,
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
    visual.global_.offwidth = WIDTH * SAMPLING
    visual.global_.offheight = HEIGHT * SAMPLING
    visual.global_.fovy = math.degrees(FIELD_OF_VIEW)
    visual.quality.shadowsize = 8192
    visual.quality.offsamples = 4
    visual.map.shadowclip = 1.0
    visual.map.shadowscale = 1.0
    visual.rgba.haze = [0.93, 0.94, 0.95, 1]
    for texture in spec.textures:
        if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            texture.rgb1, texture.rgb2 = [0.97, 0.98, 0.99], [0.90, 0.92, 0.94]
        else:
            texture.rgb1, texture.rgb2 = [0.80, 0.81, 0.78], [0.77, 0.78, 0.75]
            texture.markrgb = [0.71, 0.72, 0.69]


def _turn_wheels(model: Robot | Fleet, mj: mujoco.MjModel, data: mujoco.MjData, view: View) -> None:
    """Steer the wheels for the view's twist, and turn each a little further than the last."""
    robots = [p.robot for p in model.placements] if isinstance(model, Fleet) else [model]
    vx, vy, w = view.twist
    for robot in robots:
        prefix = f"{robot.namespace}/" if robot.namespace else ""
        for index, wheel in enumerate(robot.wheels):
            spin = mj.joint(prefix + wheel.spin_joint)
            data.qpos[spin.qposadr[0]] = view.spin * (index + 1)
            if wheel.steering_joint is not None and (vx or vy or w):
                angle = math.atan2(vy + w * wheel.x, vx - w * wheel.y) - wheel.heading
                joint = mj.joint(prefix + wheel.steering_joint)
                data.qpos[joint.qposadr[0]] = wheel.steering_sign * angle


def _visible_points(model: mujoco.MjModel, data: mujoco.MjData) -> Points:
    """World coordinates of the corners of everything that is shown but the ground."""
    found = []
    for g in range(model.ngeom):
        if model.geom_group[g] > 2 or model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[g]
            start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            local = model.mesh_vert[start : start + count].astype(np.float64)
        else:
            centre, half = model.geom_aabb[g][:3], model.geom_aabb[g][3:]
            signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
            local = centre + signs * half
        found.append(local @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g])
    return np.vstack(found)


def _aim(points: Points, view: View) -> mujoco.MjvCamera:
    """A camera that has all points in the picture and them in its middle."""
    a, e = math.radians(view.azimuth), math.radians(view.elevation)
    forward = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([math.sin(a), -math.cos(a), 0.0])
    up = np.cross(right, forward)
    tan_y = math.tan(FIELD_OF_VIEW / 2) / MARGIN
    tan_x = tan_y * WIDTH / HEIGHT
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


def _picture(model: mujoco.MjModel, data: mujoco.MjData, view: View) -> bytes:
    points = _visible_points(model, data)
    model.stat.center[:] = (points.min(axis=0) + points.max(axis=0)) / 2
    model.stat.extent = float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
    model.vis.map.znear = 0.01
    with mujoco.Renderer(model, HEIGHT * SAMPLING, WIDTH * SAMPLING) as renderer:
        renderer.update_scene(data, _aim(points, view))
        pixels = renderer.render()
    image = Image.fromarray(pixels).resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)
    image = image.quantize(256, Image.Quantize.MEDIANCUT, kmeans=2, dither=Image.Dither.NONE)
    out = io.BytesIO()
    image.save(out, "PNG", optimize=True)
    return out.getvalue()


def main(names: list[str]) -> int:
    """Render the examples named, or all."""
    for name in names or sorted(p.name for p in (ROOT / "examples").iterdir() if p.is_dir()):
        picture = render(name)
        (ROOT / "examples" / name / "picture.png").write_bytes(picture)
        print(f"{name}: {len(picture) // 1000} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
