"""A mesh is refused with a diagnostic, or MuJoCo loads it as a visual geometry."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest

from tests.slow import one_quick_of
from thorvaldc.compiler.shapes.meshes import load_mesh
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Vec3
from thorvaldc.model.stl import binary_stl

CORNERS: list[Vec3] = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]


def scaled(factor: float, offset: float = 0.0) -> list[Vec3]:
    return [(factor * x + offset, factor * y + offset, factor * z + offset) for x, y, z in CORNERS]


POINTS: dict[str, tuple[list[Vec3], bool]] = {  # with whether the mesh is accepted
    "solid": (CORNERS, True),
    "coplanar": ([*CORNERS[:3], (1.0, 1.0, 0.0)], True),
    "small": (scaled(1e-5), True),
    "far": (scaled(1.0, 1e6), True),
    "equal points": ([(1.0, 1.0, 1.0)] * 4, False),
    "two equal points": ([*CORNERS[:3], CORNERS[1]], False),
    "on a line": ([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (3.0, 0.0, 0.0)], False),
    "tiny": (scaled(1e-12), False),
    "huge": (scaled(1e10), False),
    "huger": (scaled(1e30), False),
}
OBJ_LINES = {
    "missing texture": ("f 1/9 2/9 3/9", True),
    "missing normal": ("f 1//9 2//9 3//9", True),
    "negative": ("f -1 -2 -3", True),
    "line and point": ("l 1 99\np 77", True),
    "zero": ("f 0 1 2", False),
    "index above": ("f 1 2 5", False),
    "index below": ("f -5 1 2", False),
    "two corners": ("f 1 2", False),
    "normal is no number": ("vn x y z", False),
    "normal is not finite": ("vn nan 0 1", False),
    "texture is not finite": ("vt inf 0", False),
}


def obj(points: list[Vec3], more: str = "") -> bytes:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    return "\n".join([*lines, more, ""]).encode()


def stl(points: list[Vec3]) -> bytes:
    return binary_stl([(points[a], points[b], points[c]) for a, b, c in FACES])


def ply(points: list[Vec3]) -> bytes:
    head = (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
        "property float z\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = [f"{x!r} {y!r} {z!r}" for x, y, z in points] + [f"3 {a} {b} {c}" for a, b, c in FACES]
    return (head + "\n".join(rows) + "\n").encode()


def is_accepted(path: Path, data: bytes) -> bool:
    """Returns whether the compiler accepts the mesh; MuJoCo must then load it."""
    path.write_bytes(data)
    report = Report()
    mesh = load_mesh(path, Span("robot.yaml"), report, display=path.name)
    if mesh is None:
        assert report.has_errors
        return False
    mujoco.MjModel.from_xml_string(
        f'<mujoco><asset><mesh name="m" file="{mesh.name}" inertia="shell"/></asset><worldbody>'
        '<geom type="mesh" mesh="m" contype="0" conaffinity="0"/></worldbody></mujoco>',
        {mesh.name: mesh.data},
    )
    return True


@pytest.mark.parametrize("name", one_quick_of(3, POINTS))
@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
def test_points(tmp_path: Path, suffix: str, name: str) -> None:
    points, accepted = POINTS[name]
    data = {"stl": stl, "obj": obj, "ply": ply}[suffix](points)
    assert is_accepted(tmp_path / f"m.{suffix}", data) == accepted


@pytest.mark.parametrize("name", one_quick_of(3, OBJ_LINES))
def test_lines_of_obj_files(tmp_path: Path, name: str) -> None:
    line, accepted = OBJ_LINES[name]
    assert is_accepted(tmp_path / "m.obj", obj(CORNERS, line)) == accepted
