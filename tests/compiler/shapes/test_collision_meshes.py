"""Collision meshes of extras in every format: refused with a diagnostic, or MuJoCo loads them."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path

import mujoco
import pytest

from tests.compiler.sandbox.test_worker_process import ROBOT
from tests.compiler.shapes.test_meshes import collada
from tests.compiler.shapes.test_meshes_in_mujoco import CORNERS, FACES, obj, ply, scaled, stl
from tests.slow import mostly_slow
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import MeshShape, Robot, Vec3

FORMATS = ["obj", "gltf", "dae", "ply", "off", "stl"]
POINTS: dict[str, tuple[list[Vec3], str]] = {  # with the diagnostic
    "solid": (CORNERS, ""),
    "flat": ([*CORNERS[:3], (1.0, 1.0, 0.0)], "mesh-flat"),
    "nearly flat": ([*CORNERS[:3], (1.0, 1.0, 1e-9)], "mesh-flat"),
    "thin": ([*CORNERS[:3], (1.0, 1.0, 1e-4)], ""),
    "small": (scaled(1e-5), ""),
    "tiny": (scaled(1e-12), "mesh-invalid"),
    "large": (scaled(1e7), ""),
    "huge": (scaled(1e10), "mesh-invalid"),
    "far": (scaled(1.0, 1e6), ""),
    "too far": (scaled(1.0, 1e8), "mesh-invalid"),  # equal points as float32
    "equal points": ([(1.0, 1.0, 1.0)] * 4, "mesh-invalid"),
    "two equal points": ([*CORNERS[:3], CORNERS[1]], "mesh-invalid"),
    "on a line": ([(float(i), 0.0, 0.0) for i in range(4)], "mesh-invalid"),
    "not finite": ([*CORNERS[:3], (0.0, 0.0, float("nan"))], "mesh-invalid"),
}
INDICES = {"above": 9, "far above": 2**31 - 1, "negative": -9}


def off(points: list[Vec3]) -> bytes:
    lines = ["OFF", "4 4 6", *(f"{x!r} {y!r} {z!r}" for x, y, z in points)]
    return "\n".join([*lines, *(f"3 {a} {b} {c}" for a, b, c in FACES), ""]).encode()


def gltf(points: list[Vec3], last: int = 3) -> bytes:
    """Returns a glTF file; its y axis points up, and trimesh does not turn it."""
    indices = [*[i for face in FACES for i in face][:-1], last]
    data = struct.pack("<12f", *(n for p in points for n in p))
    data += struct.pack("<12I", *(i % 2**32 for i in indices))
    views = [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 48}]
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 12, "type": "SCALAR"},
    ]
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": accessors,
            "bufferViews": views,
            "buffers": [{"byteLength": len(data), "uri": uri}],
        }
    ).encode()


def dae(points: list[Vec3]) -> bytes:
    text = collada("1", "Z_UP").replace("<translate>10 0 0</translate>", "")
    head, rest = text.split('<float_array id="pa" count="12">')
    rest = rest.partition("</float_array>")[2]
    numbers = " ".join(repr(n) for p in points for n in p)
    return f'{head}<float_array id="pa" count="12">{numbers}</float_array>{rest}'.encode()


WRITE = {"stl": stl, "obj": obj, "ply": ply, "off": off, "gltf": gltf, "dae": dae}


def with_index(suffix: str, index: int) -> bytes:
    """Returns a mesh whose last triangle has a corner that does not exist."""
    if suffix == "gltf":
        return gltf(CORNERS, index)
    data = WRITE[suffix](CORNERS).decode()
    old, new = {
        "obj": ("f 2 3 4", f"f 2 3 {index}"),
        "dae": ("1 2 3</p>", f"1 2 {index}</p>"),
    }.get(suffix, ("3 1 2 3", f"3 1 2 {index}"))
    assert old in data
    return data.replace(old, new).encode()


def build(folder: Path, files: dict[str, bytes]) -> tuple[Robot | None, dict[str, set[str]]]:
    """Compiles a robot with a link for each mesh.

    Returns the model, and the errors by the name of the mesh file.
    """
    links = ""
    for i, (name, data) in enumerate(files.items()):
        (folder / name).write_bytes(data)
        shape = f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'
        links += f'<link name="m{i}">{shape}</link><joint name="j{i}" type="fixed">'
        links += f'<parent link="frame_body"/><child link="m{i}"/></joint>\n'
    (folder / "a.xacro").write_text(f'<robot name="r">{links}</robot>', encoding="utf-8")
    (folder / "robot.yaml").write_text(ROBOT, encoding="utf-8")
    compilation = compile_file(folder / "robot.yaml")
    names: dict[str, set[str]] = {}
    for diagnostic in compilation.report.errors:
        for name in files:
            if f"`{name}`" in diagnostic.message:
                names.setdefault(name, set()).add(diagnostic.code.name)
    model = compilation.model
    assert model is None or isinstance(model, Robot)
    return model, names


def check_mujoco(folder: Path, model: Robot | None, count: int) -> None:
    """Checks that MuJoCo loads the MJCF, and that the URDF names ``count`` collision meshes."""
    assert model is not None
    for name, data in emit(model, ["urdf", "mjcf"]).items():
        path = folder / "build" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    mujoco.MjModel.from_xml_path(str(folder / "build" / "mjcf" / "robot.xml"))
    urdf = (folder / "build" / "urdf" / "robot.urdf").read_text(encoding="utf-8")
    shapes = [c.shape for link in model.links for c in link.collisions]
    names = [shape.mesh for shape in shapes if isinstance(shape, MeshShape)]
    assert len(names) == count
    for name in names:
        assert f'filename="../meshes/{name}"' in urdf
        assert (folder / "build" / "meshes" / name).is_file()


@pytest.mark.parametrize("suffix", mostly_slow(FORMATS, 2, slow=1))
def test_points(tmp_path: Path, suffix: str) -> None:
    files = {f"{name}.{suffix}": WRITE[suffix](points) for name, (points, _) in POINTS.items()}
    refused = {f"{name}.{suffix}": {code} for name, (_, code) in POINTS.items() if code}
    model, names = build(tmp_path, files)
    assert model is None
    assert names == refused
    accepted = {name: data for name, data in files.items() if name not in refused}
    model, names = build(tmp_path, accepted)
    assert names == {}
    check_mujoco(tmp_path, model, len(accepted))


@pytest.mark.parametrize("suffix", mostly_slow(FORMATS[:-1], 2, slow=2))
def test_faces_with_wrong_indices(tmp_path: Path, suffix: str) -> None:
    """A face with a missing corner is refused, or the reader of the format drops the face."""
    files = {f"{name}.{suffix}": with_index(suffix, index) for name, index in INDICES.items()}
    _, names = build(tmp_path, files)
    accepted = {name: data for name, data in files.items() if name not in names}
    assert all(codes <= {"mesh-invalid", "mesh-flat"} for codes in names.values())
    if accepted:
        model, _ = build(tmp_path, accepted)
        check_mujoco(tmp_path, model, len(accepted))
