"""Height maps: the ground of scenarios from PNG, GeoTIFF and STL files."""

from __future__ import annotations

import math
import random
import struct
import zlib
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.compiler.result import Compilation
from thorvaldc.compiler.scenario import height_maps
from thorvaldc.model import Fleet, HeightMap
from thorvaldc.model.stl import binary_stl
from thorvaldc.simulation.episode import Episode
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

ROOT = Path(__file__).resolve().parents[3]
SLIM = ROOT / "examples/4wd4ws_slim/robot.yaml"
SCENARIO = f"""thorvaldc: 1
scenario: trial
robots: {{cart: {{robot: {SLIM}, xyz: [%s]}}}}
duration: 3 s
world: {{ground: {{type: map, %s}}%s}}
script: [{{at: 0.5 s, vx: 0.5 m/s}}]
"""


def compiled(
    folder: Path, ground: str, more: str = "", start: str = "0 m, 0 m, 0 m"
) -> Compilation:
    path = folder / "scenario.yaml"
    path.write_text(SCENARIO % (start, ground, more), encoding="utf-8")
    return compile_file(path)


def fleet_of(compilation: Compilation) -> tuple[Fleet, HeightMap]:
    assert [str(d) for d in compilation.report.errors] == []
    fleet = compilation.model
    assert isinstance(fleet, Fleet)
    assert fleet.world is not None
    assert fleet.world.ground.heights is not None
    return fleet, fleet.world.ground.heights


def write_tiff(path: Path, heights: Any, tags: dict[int, Any]) -> None:
    directory = TiffImagePlugin.ImageFileDirectory_v2()
    for tag, value in tags.items():
        directory[tag] = value
        directory.tagtype[tag] = 2 if isinstance(value, str) else 12
    Image.fromarray(np.asarray(heights, np.float32)).save(path, tiffinfo=directory)


# Two lines of three pixels: the first line is the far left one of the ground.
SAMPLES = [[0, 40, 80], [120, 160, 200]]


def write_map(folder: Path, name: str) -> str:
    """Writes a file with the heights of ``SAMPLES`` / 100 (m), and returns the keys of the ground.

    The pixels have a distance of 2 m along x and 3 m along y.
    """
    pixels = np.array(SAMPLES)
    if name == "grey.png":
        Image.fromarray(pixels.astype(np.uint8)).save(folder / name)
        return "file: grey.png, size: [4 m, 3 m], height: 2.55 m"
    if name == "deep.png":
        Image.fromarray((pixels * 257).astype(np.uint16)).save(folder / name)
        return "file: deep.png, size: [4 m, 3 m], height: 2.55 m"
    if name == "field.tif":  # 212 m above the sea
        write_tiff(folder / name, 212.0 + pixels / 100, {33550: (2.0, 3.0, 0.0), 42113: "-9999"})
        return "file: field.tif"
    corners = [
        [(2.0 * i - 2.0, 1.5 - 3.0 * j, pixels[j][i] / 100) for i in range(3)] for j in range(2)
    ]
    triangles = [
        triangle
        for i in range(2)
        for triangle in (
            (corners[1][i], corners[1][i + 1], corners[0][i]),
            (corners[0][i], corners[1][i + 1], corners[0][i + 1]),
        )
    ]
    (folder / name).write_bytes(binary_stl(triangles))
    return f"file: {name}"


@pytest.mark.parametrize("name", ["grey.png", "deep.png", "field.tif", "field.stl"])
def test_heights_of_each_format(tmp_path: Path, name: str) -> None:
    _, heights = fleet_of(compiled(tmp_path, write_map(tmp_path, name)))
    assert heights.size == pytest.approx((4.0, 3.0))
    assert heights.center == (0.0, 0.0)
    for j, line in enumerate(SAMPLES):
        for i, sample in enumerate(line):
            x, y = 2.0 * i - 2.0, 1.5 - 3.0 * j
            assert heights.height(x, y) == pytest.approx(sample / 100, abs=1e-5)
    assert heights.height(0.5, 0.4) == pytest.approx(0.4 + 0.1 + 1.2 * 1.1 / 3, abs=1e-5)
    assert heights.height(2.1, 0.0) == 0.0  # beside the map


def hills(folder: Path) -> str:
    """Writes 40 m x 30 m of hills with heights up to 2 m, and returns the keys of the ground."""
    x, y = np.meshgrid(np.linspace(-20, 20, 201), np.linspace(15, -15, 151))
    write_tiff(folder / "hills.tif", np.sin(x / 4) * np.cos(y / 5), {33550: (0.2, 0.2, 0.0)})
    return "file: hills.tif"


def test_mujoco_has_the_heights_of_the_map(tmp_path: Path) -> None:
    """Measured by rays from above, with the robot away."""
    fleet, heights = fleet_of(compiled(tmp_path, hills(tmp_path), start="17 m, 12 m, 0 m"))
    scene = MujocoScene(emit(fleet, ["mjcf"]))
    model, data = scene.model, scene.data
    mujoco.mj_forward(model, data)
    numbers = random.Random(1)
    for _ in range(100):
        x, y = numbers.uniform(-19, 14), numbers.uniform(-14, 9)
        start, down = np.array([x, y, 10.0]), np.array([0.0, 0.0, -1.0])
        away = mujoco.mj_ray(model, data, start, down, None, 1, -1, np.zeros(1, np.int32))
        # MuJoCo cuts each cell into two triangles.
        assert 10.0 - away == pytest.approx(heights.height(x, y), abs=2e-3)


@pytest.mark.parametrize("start", ["0 m, 0 m, 0 m", "3 m, -4 m, 0 m", "-9 m, 5 m, 0 m"])
def test_a_robot_starts_with_its_wheels_on_the_ground(tmp_path: Path, start: str) -> None:
    fleet, heights = fleet_of(compiled(tmp_path, hills(tmp_path), start=start))
    (placement,) = fleet.placements
    gaps = []
    for wheel in placement.robot.wheels:
        x, y, z = placement.pose.apply((wheel.x, wheel.y, 0.0))
        gaps.append(z - heights.height(x, y))
    assert -5e-3 < min(gaps) < 5e-3  # one wheel stands
    assert max(gaps) < 0.03  # the ground is not a plane
    episode = Episode(fleet)
    before = episode.reset()
    after = episode.run(1.0)
    assert math.dist(before.posture, after.posture) < 0.05  # m, rad


def test_a_robot_climbs_a_ramp(tmp_path: Path) -> None:
    ramp = [
        ((-10.0, -5.0, 0.0), (10.0, -5.0, 2.0), (10.0, 5.0, 2.0)),
        ((-10.0, -5.0, 0.0), (10.0, 5.0, 2.0), (-10.0, 5.0, 0.0)),
    ]
    (tmp_path / "ramp.stl").write_bytes(binary_stl(ramp))
    compilation = compiled(tmp_path, "file: ramp.stl", start="-2 m, 0 m, 0 m")
    fleet, _ = fleet_of(compilation)
    assert fleet.placements[0].pose.rpy()[1] == pytest.approx(-math.atan(0.1), abs=1e-5)
    assert fleet.placements[0].pose.xyz[2] == pytest.approx(0.8, abs=1e-4)
    assert compilation.scenario is not None
    episode = Episode(compilation.scenario)
    start, end = episode.reset(), episode.run(3.0)
    assert end.pose_true.x > -1.2
    rise = end.posture[0] - start.posture[0]
    assert rise == pytest.approx(0.1 * (end.pose_true.x - start.pose_true.x), abs=0.02)


def test_obstacles_stand_on_the_map(tmp_path: Path) -> None:
    more = ", obstacles: {box: {shape: box, size: [1, 1, 1], xyz: [6, 3, 0]}}"
    fleet, heights = fleet_of(compiled(tmp_path, hills(tmp_path), more))
    assert fleet.world is not None
    (block,) = fleet.world.blocks
    assert block.pose.xyz[2] == pytest.approx(0.5 + heights.height(6.0, 3.0))


def test_gazebo_gets_the_same_heights(tmp_path: Path) -> None:
    fleet, heights = fleet_of(compiled(tmp_path, hills(tmp_path)))
    mesh = next(data for path, data in emit(fleet, ["sdf"]).items() if path.endswith("terrain.stl"))
    corners = {t[i : i + 3] for t in struct.iter_unpack("<12x9f2x", mesh[84:]) for i in (0, 3, 6)}
    assert len(corners) == 201 * 151
    for x, y, z in sorted(corners)[::1000]:
        assert z == pytest.approx(heights.height(x, y), abs=1e-4)


def png_bomb(columns: int, lines: int) -> bytes:
    """Returns a PNG file with fewer pixels than its header says."""
    data = b"\x89PNG\r\n\x1a\n"
    for content in (
        b"IHDR" + struct.pack(">IIBBBBB", columns, lines, 16, 0, 0, 0, 0),
        b"IDAT" + zlib.compress(bytes(1000)),
        b"IEND",
    ):
        checksum = struct.pack(">I", zlib.crc32(content))
        data += struct.pack(">I", len(content) - 4) + content + checksum
    return data


@pytest.mark.parametrize(
    ("ground", "text", "hint"),
    [
        ("size: [1, 1]", "a map has no `file`", "add `file: field.tif`"),
        ("file: nowhere.tif", "there is no file `nowhere.tif`", ""),
        ("file: scenario.yaml", "has the format `yaml`", "use one of png"),
        ("file: grey.png, size: [4, 3]", "does not state its `height`", "add it"),
        ("file: grey.png, height: 1", "does not state its `size`", "add it"),
        ("file: grey.png, size: [4, 0.5], height: 1", "has 4 m x 0.5 m", "in metres"),
        ("file: hills.tif, size: [4, 3]", "states its own `size`", "remove `size`"),
        ("file: hills.tif, height: 1", "states its own `height`", "remove `height`"),
        ("file: field.stl, size: [4, 3]", "states its own `size`", "remove `size`"),
        ("file: degrees.tif", "has 0.000002 m x 0.000001 m", "needs a projection in metres"),
        ("file: holes.tif", "has 2 of 6 pixels without a height", "gdal_fillnodata"),
        ("file: flat.tif, size: [4, 3]", "heights that differ by 0 m", "`type: plane`"),
        ("file: color.png, size: [4, 3], height: 1", "pixels of the mode RGB", "one channel"),
        ("file: cut.png, size: [4, 3], height: 1", "cannot be read as PNG", ""),
        ("file: bomb.png, size: [4, 3], height: 1", "at most 1000000 pixels", "cut it"),
        ("file: text.stl", "", ""),
        ("file: hills.tif, amplitude: 1 m", "`amplitude` has no effect on ground of type", ""),
    ],
)
def test_bad_maps(tmp_path: Path, ground: str, text: str, hint: str) -> None:
    for name in ("grey.png", "field.stl"):
        write_map(tmp_path, name)
    hills(tmp_path)
    write_tiff(tmp_path / "degrees.tif", SAMPLES, {33550: (1e-6, 1e-6, 0.0)})
    holed = [[-9999, 40, 80], [120, math.nan, 200]]
    write_tiff(tmp_path / "holes.tif", holed, {33550: (2.0, 3.0, 0.0), 42113: "-9999"})
    write_tiff(tmp_path / "flat.tif", [[1, 1], [1, 1]], {})
    Image.new("RGB", (3, 2)).save(tmp_path / "color.png")
    (tmp_path / "cut.png").write_bytes((tmp_path / "grey.png").read_bytes()[:45])
    (tmp_path / "bomb.png").write_bytes(png_bomb(60000, 60000))
    (tmp_path / "text.stl").write_text("no mesh")
    report = compiled(tmp_path, ground).report
    assert [d.span.line for d in report.errors if d.span] == [5]
    (error,) = report.errors
    assert text in error.message
    assert hint in (error.hint or "")


def test_kerbs_rails_and_zones_need_a_plane(tmp_path: Path) -> None:
    more = ", kerbs: [{from: [5, 0], to: [6, 0], height: 0.1}]"
    (error,) = compiled(tmp_path, hills(tmp_path), more).report.errors
    assert (error.code.name, error.message) == (
        "conflicting-keys",
        "ground of the type `map` has no `kerbs`",
    )


def test_images_need_pillow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(height_maps, "find_spec", lambda _: None)
    (error,) = compiled(tmp_path, hills(tmp_path)).report.errors
    assert "needs Pillow" in error.message
    fleet_of(compiled(tmp_path, write_map(tmp_path, "field.stl")))
