"""Small mesh files that describe endless, huge or impossible meshes end with a diagnostic.

One process compiles a robot with all of them, and reports its time and memory.
"""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest

from tests.compiler.sandbox.test_worker_process import ROBOT
from tests.compiler.shapes.test_collision_meshes import gltf, obj, ply, with_index
from tests.compiler.shapes.test_meshes import collada, nested_collada
from tests.compiler.shapes.test_meshes_in_mujoco import CORNERS

PROCESSOR_SECONDS = 5
PROGRAM = f"""
import json, resource, sys, time
from thorvaldc.compiler.shapes import meshes
from thorvaldc.compiler.pipeline import compile_file
meshes.LIMITS["processor_seconds"] = {PROCESSOR_SECONDS}
start = time.monotonic()
report = compile_file(sys.argv[1]).report
seconds = time.monotonic() - start
# The resource usage of this process would include the memory of the process that started it.
own = int(open("/proc/self/status").read().partition("VmHWM:")[2].split()[0])
memory = [own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss]
print(json.dumps([[[d.code.name, d.message, d.hint] for d in report.errors], seconds, memory]))
"""
PLY = "ply\nformat {} 1.0\nelement vertex {}\n" + "".join(f"property float {a}\n" for a in "xyz")
PLY += "element face {}\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n"
DAE = collada("1", "Z_UP")


def changed_gltf(**changes: Any) -> bytes:
    """Returns a glTF file with other entries of its first accessor, buffer view or buffer."""
    document = json.loads(gltf(CORNERS))
    for key, entries in changes.items():
        first = document[key][0]
        first |= entries
        document[key][0] = {name: value for name, value in first.items() if value is not None}
    return json.dumps(document).encode()


def bomb() -> str:
    entities = '<!ENTITY e0 "aaaaaaaaaa">' + "".join(
        f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(10)
    )
    return DAE.replace("<COLLADA", f"<!DOCTYPE COLLADA [{entities}]><COLLADA", 1).replace(
        "<created>", "<created>&e10;"
    )


def hostile_files() -> dict[str, tuple[bytes | str, str, str]]:
    """Returns the content, the code and words of the message by the name of the file."""
    limit, invalid = "mesh-large", "mesh-invalid"
    external = '<!DOCTYPE COLLADA [<!ENTITY x SYSTEM "file:///etc/passwd">]><COLLADA'
    deep_nodes = '<node id="n">' + "<node>" * 30_000, "</node>" * 30_000 + "</node></visual"
    long_list = "v 0 0 0\n" * 700_000
    no_buffer = {"bufferView": None, "count": 400_000_000}
    return {
        # The next two reach the limit of time or that of memory first, as the computer is fast.
        "nested.dae": (nested_collada(40), limit, ""),
        "instances.dae": (
            DAE.replace('<instance_geometry url="#g"/>', '<instance_geometry url="#g"/>' * 50_000),
            limit,
            "",
        ),
        "bomb.dae": (bomb(), invalid, "cannot be read as dae"),
        "external.dae": (
            DAE.replace("<COLLADA", external, 1).replace("<created>", "<created>&x;"),
            invalid,
            "undefined entity",
        ),
        "deep.dae": (
            DAE.replace('<node id="n">', deep_nodes[0]).replace("</node></visual", deep_nodes[1]),
            invalid,
            "cannot be read as dae",
        ),
        "unit.dae": (collada("1e400", "Z_UP"), invalid, "not a finite number"),
        "unit_nan.dae": (collada("nan", "Z_UP"), invalid, "not a finite number"),
        "zip.dae": (b"", invalid, "is a zip archive"),
        "count.gltf": (changed_gltf(accessors={"count": 10**9}), invalid, "cannot be read as gltf"),
        "no_buffer.gltf": (changed_gltf(accessors=no_buffer), limit, "0.5 GB of memory"),
        "view.gltf": (changed_gltf(bufferViews={"byteLength": 10**12}), invalid, "gltf"),
        "offset.gltf": (changed_gltf(bufferViews={"byteOffset": -(10**9)}), invalid, "gltf"),
        "deep.gltf": ('{"a":' + "[" * 99_999 + "]" * 99_999 + "}", invalid, "gltf"),
        "passwd.gltf": (
            changed_gltf(buffers={"uri": "../../../../../../../etc/passwd"}),
            invalid,
            "is not below its folder",
        ),
        "absolute.gltf": (
            changed_gltf(buffers={"uri": "/etc/passwd"}),
            invalid,
            "is not below its folder",
        ),
        "missing.gltf": (changed_gltf(buffers={"uri": "x.bin"}), invalid, "`x.bin`, which cannot"),
        "vertices.ply": (PLY.format("ascii", 10**9, 4), invalid, "0 triangles"),
        "binary.ply": (PLY.format("binary_little_endian", 10**9, 4), invalid, "ply"),
        "faces.ply": (PLY.format("binary_little_endian", 1, 10**9), invalid, "ply"),
        "index.ply": (with_index("ply", 10**9), invalid, "ply"),
        "count.off": ("OFF\n1000000000 1000000000 0\n0 0 0\n", invalid, "off"),
        "index.off": (with_index("off", 10**9), invalid, "off"),
        "index.obj": (with_index("obj", 10**30), invalid, "does not exist (line 8)"),
        "digits.obj": (obj(CORNERS, "f 1 2 " + "9" * 99_999), invalid, "list of vertices (line 9)"),
        "float.obj": (obj(CORNERS, "v 1e400 0 0"), invalid, "not a finite number (line 9)"),
        "nan.obj": (obj(CORNERS, "v nan 0 0"), invalid, "not a finite number (line 9)"),
        "vertices.obj": (obj(CORNERS, long_list), limit, "more than 600000 vertices"),
        "polygon.obj": (obj(CORNERS, "f " + "1 2 3 " * 100_000), limit, "triangles"),
        "count.stl": (bytes(80) + struct.pack("<I", 2**32 - 1), invalid, "4294967295 triangles"),
        "float.stl": ("solid\nfacet\n" + "vertex 1e400 nan 0\n" * 6, invalid, "finite number"),
        "words.stl": ("solid\nfacet\n" + "vertex 0 0 0 " * 900_000, limit, "300000 triangles"),
        "good.ply": (ply(CORNERS), "", ""),
    }


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory require Linux")
@pytest.mark.timeout(300)
def test_every_hostile_mesh_has_a_diagnostic(tmp_path: Path) -> None:
    files = hostile_files()
    links = ""
    for i, (name, (data, _, _)) in enumerate(files.items()):
        (tmp_path / name).write_bytes(data.encode() if isinstance(data, str) else data)
        shape = f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'
        links += f'<link name="m{i}">{shape}</link><joint name="j{i}" type="fixed">'
        links += f'<parent link="frame_body"/><child link="m{i}"/></joint>\n'
    with zipfile.ZipFile(tmp_path / "zip.dae", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.dae", bytes(64 << 20))
    (tmp_path / "a.xacro").write_text(f'<robot name="r">{links}</robot>', encoding="utf-8")
    (tmp_path / "robot.yaml").write_text(ROBOT, encoding="utf-8")
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path / "robot.yaml")],
        capture_output=True,
        text=True,
        timeout=280,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert result.returncode == 0, result.stderr
    errors, seconds, memory = json.loads(result.stdout)
    names = [message.split()[2].strip("`") for _, message, _ in errors]
    assert names == [name for name, (_, code, _) in files.items() if code]
    for (code, message, hint), (name, (_, expected, words)) in zip(
        errors, files.items(), strict=False
    ):
        assert code == expected, message
        assert words in message, name
        assert hint, name
    assert seconds < 200.0  # of which each of two files takes the limit of processor time
    assert max(memory) < 512 << 10, memory
