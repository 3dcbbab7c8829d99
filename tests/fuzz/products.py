"""Valid files of the kinds that other programs, and commands of thorvaldc, write."""

from __future__ import annotations

import functools
import io
import logging
import math
import struct
import sys
import tempfile
import zlib
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path

from tests.cli.conftest import GOOD
from thorvaldc.cli.main import run_command

ONE = """\
thorvaldc: 1
name: one_drive
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m, height: 650 mm}}
  fl: {type: assembly/steered_drive, mount: frame.front_left, params:
    {controller: controller/cia402_propulsion_steering}, can: {serial: "0x101"}}
  fr: {type: caster/swivel, mount: frame.front_right}
  rl: {type: caster/fixed, mount: frame.rear_left}
  rr: {type: caster/fixed, mount: frame.rear_right}
"""
COMMANDS = (
    "sim good.yaml --ideal --duration 1 --record record.csv",
    "sim good.yaml --ideal --duration 1 --record record.mcap",
    "sim good.yaml --ideal --open-loop --duration 6 --log joints.csv",
    "build one.yaml -o built",
    "can flash one.yaml --bus virtual:delivered --store flashed.json --apply --yes"
    " --journal whole.jsonl",
)


@functools.cache
def products() -> dict[str, bytes]:
    """Returns the files that ``COMMANDS`` write, and bags of ROS, by name."""
    with tempfile.TemporaryDirectory(prefix="thorvaldc_fuzz_") as folder, chdir(folder):
        Path("good.yaml").write_text(GOOD, encoding="utf-8")
        Path("one.yaml").write_text(ONE, encoding="utf-8")
        for line in COMMANDS:
            run_quietly(*line.split())
        files = {path.as_posix(): path.read_bytes() for path in Path().rglob("*") if path.is_file()}
        files |= _bags()
    return files


def run_quietly(*arguments: str) -> None:
    """Runs a command in this process.  Raises ``RuntimeError`` if it fails."""
    previous, sys.argv = sys.argv, ["thorvaldc", *arguments]
    output = io.StringIO()
    try:
        with redirect_stdout(output), redirect_stderr(output):
            status = run_command()
    finally:
        sys.argv = previous
    if status:
        raise RuntimeError(f"`{' '.join(arguments)}`: {output.getvalue()}")


def _bags() -> dict[str, bytes]:
    """Returns bags of twists, as ROS 1 and ROS 2 write them."""
    from rosbags.rosbag1 import Writer as FirstWriter
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store, first_store = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
    kind = "geometry_msgs/msg/Twist"
    vector = store.types["geometry_msgs/msg/Vector3"]
    message = store.types[kind](vector(0.5, 0.0, 0.0), vector(0.0, 0.0, 0.1))
    for name, plugin in (("bag_mcap", StoragePlugin.MCAP), ("bag_db3", StoragePlugin.SQLITE3)):
        with Writer(Path(name), version=9, storage_plugin=plugin) as writer:
            connection = writer.add_connection("/cmd_vel", kind, typestore=store)
            for k in range(6):
                writer.write(connection, 10**18 + k * 10**8, store.serialize_cdr(message, kind))
    first = FirstWriter(Path("twists.bag"))
    first.set_compression(FirstWriter.CompressionFormat.LZ4)
    with first:
        added = first.add_connection("/cmd_vel", kind, typestore=first_store)
        for k in range(6):
            first.write(added, 10**18 + k * 10**8, first_store.serialize_ros1(message, kind))
    return {
        path.as_posix(): path.read_bytes()
        for path in (*Path("bag_mcap").iterdir(), *Path("bag_db3").iterdir(), Path("twists.bag"))
    }


# -- bombs --------------------------------------------------------------------------------

MAGIC = b"\x89MCAP0\r\n"
BOMB_BYTES = 1_500_000_000


def _record(code: int, body: bytes) -> bytes:
    return struct.pack("<BQ", code, len(body)) + body


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def mcap_with_chunk(compression: str, data: bytes, size: int) -> bytes:
    """Returns an MCAP file with one chunk, which states ``size`` bytes when it is expanded."""
    chunk = struct.pack("<QQQI", 0, 1, size, 0) + _text(compression)
    chunk += struct.pack("<Q", len(data)) + data
    head = _record(1, _text("ros2") + _text("fuzz"))
    return MAGIC + head + _record(6, chunk) + _record(2, bytes(20)) + MAGIC


@functools.cache
def zeros(compression: str) -> bytes:
    """Returns ``BOMB_BYTES`` zeros, compressed."""
    import lz4.frame
    import zstandard

    if compression == "lz4":
        with lz4.frame.LZ4FrameCompressor() as packer:
            parts = [packer.begin()]
            parts += [packer.compress(bytes(1 << 24)) for _ in range(BOMB_BYTES >> 24)]
            return b"".join([*parts, packer.flush()])
    stream = zstandard.ZstdCompressor(level=1).compressobj()
    parts = [stream.compress(bytes(1 << 24)) for _ in range(BOMB_BYTES >> 24)]
    return b"".join([*parts, stream.flush()])


@functools.cache
def bombs() -> tuple[bytes, ...]:
    """Returns small MCAP files whose chunks expand to gigabytes, or state so."""
    import zstandard

    small = zstandard.ZstdCompressor().compress(b"\x05" + bytes(100))
    return (
        mcap_with_chunk("zstd", zeros("zstd"), BOMB_BYTES),
        mcap_with_chunk("zstd", zeros("zstd"), 100),
        mcap_with_chunk("lz4", zeros("lz4"), BOMB_BYTES),
        mcap_with_chunk("lz4", zeros("lz4"), 100),
        mcap_with_chunk("zstd", small, 2**63),
        mcap_with_chunk("", b"\x05" + bytes(100), 2**40),
    )


# -- meshes -------------------------------------------------------------------------------


@functools.cache
def meshes() -> dict[str, bytes]:
    """Returns a mesh in each format, by its suffix."""
    import trimesh

    logging.disable()  # trimesh tells of a package that it can do without
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.2)
    exported = {}
    for suffix in ("stl", "obj", "ply", "off", "glb", "dae"):
        data = ball.export(file_type=suffix)
        exported[suffix] = data if isinstance(data, bytes) else data.encode()
    gltf = trimesh.Scene(ball).export(file_type="gltf", merge_buffers=True)
    exported["gltf"] = _with_buffer(gltf)
    exported["text.stl"] = _text_stl()
    return exported


def _with_buffer(files: dict[str, bytes]) -> bytes:
    """Returns a glTF file whose buffer is a data URI."""
    import base64

    (name,) = (name for name in files if name.endswith(".bin"))
    uri = b"data:application/octet-stream;base64," + base64.b64encode(files[name])
    return files["model.gltf"].replace(name.encode(), uri)


def _text_stl() -> bytes:
    corners = [(0.2 * math.cos(k), 0.2 * math.sin(k), 0.0) for k in range(6)]
    lines = ["solid cone"]
    for tip in ((0.0, 0.0, 0.3), (0.0, 0.0, -0.3)):
        for k in range(6):
            lines += ["facet normal 0 0 0", "outer loop"]
            for x, y, z in (corners[k], corners[(k + 1) % 6], tip):
                lines.append(f"vertex {x:.6f} {y:.6f} {z:.6f}")
            lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid cone", ""]).encode()


def png_bomb() -> bytes:
    """Returns a PNG picture of 30,000 by 30,000 pixels for the texture of a mesh."""

    def part(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    head = struct.pack(">IIBBBBB", 30_000, 30_000, 1, 0, 0, 0, 0)
    rows = zlib.compress(bytes(30_000 * 3_751))
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", rows) + part(b"IEND", b"")
