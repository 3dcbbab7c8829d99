"""Mesh files: copied, converted and refused ones."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from tests.slow import one_quick_of
from thorvaldc.compiler.shapes.meshes import load_mesh
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Mesh
from thorvaldc.model.stl import binary_stl

ASKED = Span("module.yaml", 7, 3, 7, 20)
P = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0)]
TETRAHEDRON = [(P[0], P[2], P[1]), (P[0], P[1], P[3]), (P[0], P[3], P[2]), (P[1], P[2], P[3])]


def load(path: Path, **more: object) -> tuple[Mesh | None, Report]:
    report = Report()
    return load_mesh(path, ASKED, report, display=path.name, **more), report  # type: ignore[arg-type]


def names(report: Report) -> list[str]:
    return [d.code.name for d in report]


def corners(stl: bytes) -> list[tuple[float, ...]]:
    assert len(stl) == 84 + 50 * struct.unpack_from("<I", stl, 80)[0]
    return [r[i : i + 3] for r in struct.iter_unpack("<12x9f2x", stl[84:]) for i in (0, 3, 6)]


def bounds(stl: bytes) -> list[tuple[float, float]]:
    return [(round(min(a), 6), round(max(a), 6)) for a in zip(*corners(stl), strict=True)]


def write(path: Path, data: bytes | str) -> Path:
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def test_binary_stl_passes_through_unchanged(tmp_path: Path) -> None:
    data = binary_stl(TETRAHEDRON)
    mesh, report = load(write(tmp_path / "leg cover.STL", data))
    assert mesh is not None
    assert mesh.data == data
    assert mesh.name == f"leg_cover_{mesh.sha256[:8]}.stl"
    assert len(report) == 0


def test_two_files_of_one_name_have_different_mesh_names(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    first_mesh, _ = load(write(tmp_path / "a.stl", binary_stl(TETRAHEDRON)))
    two, _ = load(write(tmp_path / "b" / "a.stl", binary_stl(TETRAHEDRON[::-1])))
    assert first_mesh is not None
    assert two is not None
    assert first_mesh.name != two.name


def test_text_stl_becomes_binary(tmp_path: Path) -> None:
    text = "solid part\n"
    for triangle in TETRAHEDRON:
        text += " facet normal 0 0 0\n  outer loop\n"
        text += "".join(f"   vertex {x:e} {y:e} {z:e}\n" for x, y, z in triangle)
        text += "  endloop\n endfacet\n"
    mesh, report = load(write(tmp_path / "t.stl", text + "endsolid part\n"))
    assert mesh is not None
    assert len(report) == 0
    assert corners(mesh.data) == [p for t in TETRAHEDRON for p in t]


OBJ = "mtllib a.mtl\no a\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in P)
OBJ += "usemtl red\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def test_obj_without_references_to_material_files(tmp_path: Path) -> None:
    mesh, report = load(write(tmp_path / "a.obj", OBJ))
    assert mesh is not None
    assert len(report) == 0
    assert mesh.name.endswith(".obj")
    assert mesh.data.decode() == OBJ.replace("mtllib a.mtl\n", "").replace("usemtl red\n", "")


def collada(unit: str, up: str) -> str:
    points = " ".join(f"{c}" for p in P for c in p)
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
 <asset><created>2000-01-01T00:00:00</created><modified>2000-01-01T00:00:00</modified>
  <unit name="u" meter="{unit}"/><up_axis>{up}</up_axis></asset>
 <library_geometries><geometry id="g" name="g"><mesh>
  <source id="p"><float_array id="pa" count="12">{points}</float_array>
   <technique_common><accessor source="#pa" count="4" stride="3">
    <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
   </accessor></technique_common></source>
  <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
  <triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/>
   <p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles></mesh></geometry></library_geometries>
 <library_visual_scenes><visual_scene id="s"><node id="n"><translate>10 0 0</translate>
  <instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
 <scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""


@pytest.mark.parametrize(
    ("unit", "up", "expected"),
    [
        ("0.01", "Z_UP", [(0.1, 0.11), (0, 0.02), (0, 0.03)]),
        ("1", "Y_UP", [(10, 11), (-3, 0), (0, 2)]),
        pytest.param("1", "X_UP", [(-2, 0), (-3, 0), (10, 11)], marks=pytest.mark.slow),
    ],
)
def test_collada_is_converted_with_its_unit_and_up_axis(
    tmp_path: Path, unit: str, up: str, expected: list[tuple[float, float]]
) -> None:
    mesh, report = load(write(tmp_path / "a.dae", collada(unit, up)))
    assert mesh is not None, [d.message for d in report]
    assert mesh.name.endswith(".stl")
    assert bounds(mesh.data) == expected


def nested_collada(levels: int) -> str:
    """Returns a Collada file in which each node contains the next node twice."""
    nodes = "".join(
        f'<node id="n{i}"><instance_node url="#n{i + 1}"/><instance_node url="#n{i + 1}"/></node>'
        for i in range(levels)
    )
    nodes += f'<node id="n{levels}"><instance_geometry url="#g"/></node>'
    return (
        collada("1", "Z_UP")
        .replace(
            "<library_visual_scenes>",
            f"<library_nodes>{nodes}</library_nodes><library_visual_scenes>",
        )
        .replace(
            '<instance_geometry url="#g"/></node></visual',
            '<instance_node url="#n0"/></node></visual',
        )
    )


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory limits require Linux")
def test_a_small_file_of_nested_instances_is_stopped(tmp_path: Path) -> None:
    mesh, report = load(write(tmp_path / "few.dae", nested_collada(2)))
    assert mesh is not None, [d.message for d in report]
    assert len(corners(mesh.data)) == 3 * 4 * 4
    mesh, report = load(write(tmp_path / "many.dae", nested_collada(40)))
    assert mesh is None
    assert names(report) == ["mesh-large"]  # and not the limit of time


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("f 1 2 9", "a vertex that does not exist (line 7)"),
        ("f 1 2 -9", "a vertex that does not exist (line 7)"),
        ("f 0 1 2", "a vertex that does not exist (line 7)"),
        ("f 1 2", "a vertex that does not exist (line 7)"),
        ("f 1 2 x", "not a list of vertices (line 7)"),
        ("v 1e39 0 0", "too large for a float32"),
    ],
)
def test_an_obj_file_that_mujoco_cannot_read(tmp_path: Path, more: str, words: str) -> None:
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in P)
    text = vertices + "f 1/1 3//1 -3\nf 1 2 4 # the base\n"
    mesh, report = load(write(tmp_path / "good.obj", text))
    assert mesh is not None, [d.message for d in report]
    mesh, report = load(write(tmp_path / "bad.obj", text + more + "\n"))
    assert mesh is None
    assert names(report) == ["mesh-invalid"]
    assert words in next(d.message for d in report)


def test_ply_is_converted(tmp_path: Path) -> None:
    ply = "ply\nformat ascii 1.0\nelement vertex 4\n"
    ply += "".join(f"property float {a}\n" for a in "xyz")
    ply += "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    ply += "".join(f"{x} {y} {z}\n" for x, y, z in P)
    ply += "3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
    mesh, report = load(write(tmp_path / "a.ply", ply))
    assert mesh is not None, [d.message for d in report]
    assert bounds(mesh.data) == [(0, 1), (0, 2), (0, 3)]


NAN = bytearray(binary_stl(TETRAHEDRON))
struct.pack_into("<f", NAN, 84 + 50 + 12 + 20, float("nan"))


@pytest.mark.parametrize(
    ("name", "data", "code", "words"),
    one_quick_of(
        3,
        [
            ("a.step", b"ISO-10303-21;", "mesh-format", "`step`"),
            ("a", b"", "mesh-format", "``"),
            ("a.stl", b"", "mesh-invalid", "0 bytes"),
            ("a.stl", binary_stl([]), "mesh-invalid", "0 triangles"),
            ("a.stl", binary_stl(TETRAHEDRON)[:-1], "mesh-invalid", "truncated"),
            ("a.stl", bytes(NAN), "mesh-invalid", "finite"),
            ("a.stl", b"solid x\nfacet\nvertex 1 2\n", "mesh-invalid", "three numbers"),
            (
                "a.stl",
                b"solid x\nfacet\n" + b"vertex 1 2 3\n" * 4 + b"vertex 1 2 x\n",
                "mesh-invalid",
                "three numbers (number 5)",
            ),
            (
                "a.stl",
                b"\0" * 80 + struct.pack("<I", 200001) + bytes(50 * 200001),
                "mesh-large",
                "200001",
            ),
            ("a.obj", b"v 0 0 0\n", "mesh-invalid", "1 vertices"),
            ("a.obj", b"v 0 0 oops\n", "mesh-invalid", "line 1"),
            ("a.dae", b"<COLLADA", "mesh-invalid", "dae"),
            ("a.dae", b"", "mesh-invalid", "dae"),
            ("a.glb", b"glTF....", "mesh-invalid", "glb"),
            ("a.ply", b"ply\nwhat", "mesh-invalid", "ply"),
        ],
    ),
    ids=lambda value: str(value)[:40],
)
def test_invalid_mesh_is_refused(
    tmp_path: Path, name: str, data: bytes, code: str, words: str
) -> None:
    mesh, report = load(write(tmp_path / name, data))
    assert mesh is None
    assert names(report) == [code]
    (diagnostic,) = report
    assert words in diagnostic.message
    assert name in diagnostic.message
    assert diagnostic.span == ASKED


def test_missing_file_is_reported_at_the_span_that_names_it(tmp_path: Path) -> None:
    mesh, report = load(tmp_path / "meshes" / "none.stl")
    assert mesh is None
    assert names(report) == ["mesh-missing"]
    assert next(iter(report)).span == ASKED
    (tmp_path / "folder.stl").mkdir()
    assert names(load(tmp_path / "folder.stl")[1]) == ["mesh-missing"]


def test_mesh_in_millimetres_is_reported_unless_scaled(tmp_path: Path) -> None:
    big = [tuple((x * 240, y, z) for x, y, z in t) for t in TETRAHEDRON]
    path = write(tmp_path / "mm.stl", binary_stl(big))  # type: ignore[arg-type]
    mesh, report = load(path)
    assert mesh is not None
    assert names(report) == ["mesh-size"]
    assert "240 m" in next(iter(report)).message
    assert names(load(path, scale=(0.001, 0.001, 0.001))[1]) == []
    small = write(tmp_path / "small.stl", binary_stl(TETRAHEDRON))
    assert names(load(small, scale=(1.0, 12.0, 1.0))[1]) == ["mesh-size"]
    assert names(load(small, scale=(1.0, 8.0, 1.0))[1]) == []


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    path = write(tmp_path / "a.stl", binary_stl(TETRAHEDRON))
    first_mesh, _ = load(path)
    write(path, binary_stl(TETRAHEDRON[:3]))
    two, _ = load(path)
    assert first_mesh != two


def test_stl_needs_neither_numpy_nor_trimesh(tmp_path: Path) -> None:
    path = write(tmp_path / "a.stl", binary_stl(TETRAHEDRON))
    program = (
        "import sys; from pathlib import Path\n"
        "from thorvaldc.diagnostics import Report, Span\n"
        "from thorvaldc.compiler.shapes.meshes import load_mesh\n"
        f"assert load_mesh(Path({str(path)!r}), Span('x'), Report(), display='a.stl')\n"
        "assert not {'numpy', 'trimesh'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=300)


def test_interrupt_during_conversion_is_not_a_missing_package(tmp_path: Path) -> None:
    write(
        tmp_path / "trimesh.py",
        "import os, signal, time\nos.kill(os.getppid(), signal.SIGINT)\ntime.sleep(30)\n",
    )
    mesh = write(tmp_path / "a.dae", "<COLLADA/>")
    script = (
        "from pathlib import Path\n"
        "from thorvaldc.diagnostics import Report, Span\n"
        "from thorvaldc.compiler.shapes.meshes import load_mesh\n"
        f"load_mesh(Path({str(mesh)!r}), Span('x'), Report(), display='a.dae')\n"
        "print('went on')\n"
    )
    path = os.pathsep.join([str(tmp_path), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert done.stdout == ""
    assert done.stderr.endswith("KeyboardInterrupt\n")


def test_git_lfs_pointer_in_place_of_a_mesh(tmp_path: Path) -> None:
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:abc\nsize 123456\n"
    for name in ("a.stl", "a.dae"):
        _, report = load(write(tmp_path / name, pointer))
        (diagnostic,) = report
        assert diagnostic.message == f"mesh file `{name}` is a Git LFS pointer, not the mesh"
    _, report = load(write(tmp_path / "b.dae", "<html><body>404 not found</body></html>"))
    (diagnostic,) = report
    assert diagnostic.message == "mesh file `b.dae` is not a dae file, or has no triangles"


def test_sensor_mesh_in_millimetres_is_reported(tmp_path: Path) -> None:
    for largest, noticed in ((80.0, True), (20.5, True), (19.5, False)):
        corners = [tuple(tuple(largest / 3 * n for n in p) for p in t) for t in TETRAHEDRON]
        _, report = load(write(tmp_path / f"{largest}.stl", binary_stl(corners)))  # type: ignore[arg-type]
        assert names(report) == ["mesh-size"] * noticed
