"""Files of others that commands make robots of, or that robots, modules and scenarios name."""

from __future__ import annotations

import io
import random
import tempfile
import zlib
from contextlib import chdir
from pathlib import Path

import numpy as np
from PIL import Image, TiffImagePlugin

from tests.cli.conftest import GOOD
from tests.fuzz.generator import BYTES, ROOT, TEXT, XML, YAML, Kind
from tests.fuzz.mutations import Mutation
from tests.fuzz.products import meshes, png_bomb, run_quietly
from thorvaldc.model.stl import binary_stl

TOOLS = ROOT / "tests/tools"
_BODY = """
  <link name="{0}"><inertial><mass value="{1}"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial>
    <collision><geometry>{2}</geometry></collision></link>"""
_HINGE = """
  <joint name="{0}" type="{1}"><origin xyz="{2}" rpy="{3}"/><parent link="base"/>
    <child link="{4}"/><axis xyz="0 0 1"/></joint>"""
CART = (
    '<robot name="cart">'
    + _BODY.format("base", 8, '<box size="0.5 0.3 0.1"/>')
    + _BODY.format("left", 1, '<cylinder radius="0.1" length="0.04"/>')
    + _BODY.format("right", 1, '<cylinder radius="0.1" length="0.04"/>')
    + _BODY.format("caster", 0.5, '<sphere radius="0.04"/>')
    + _BODY.format("camera", 0.2, '<mesh filename="mesh.stl" scale="0.1 0.1 0.1"/>')
    + _HINGE.format("left_spin", "continuous", "0.1 0.2 0", "-1.5708 0 0", "left")
    + _HINGE.format("right_spin", "continuous", "0.1 -0.2 0", "-1.5708 0 0", "right")
    + _HINGE.format("ball", "fixed", "-0.2 0 -0.06", "0 0 0", "caster")
    + _HINGE.format("mast", "fixed", "0.2 0 0.1", "0 0 0", "camera")
    + """
  <gazebo reference="camera"><sensor type="camera"><update_rate>10</update_rate></sensor></gazebo>
  <ros2_control name="c" type="system"><joint name="left_spin">
    <command_interface name="velocity"/></joint></ros2_control>
</robot>
"""
)
CONTROLLERS = b"""\
drive:
  ros__parameters:
    left_wheel_names: [left_spin]
    right_wheel_names: [right_spin]
    wheel_radius: 0.1
    wheel_separation: 0.4
    linear.x.max_velocity: 0.5
"""


def imported_kinds() -> list[Kind]:
    """Returns files of others from which commands make robots and modules."""
    originals = sorted((TOOLS / "importer/originals").glob("*.yaml"))
    files = {
        "cart.urdf": CART.encode(),
        "controllers.yaml": CONTROLLERS,
        "mesh.stl": meshes()["stl"],
    }
    command = ("import cart.urdf controllers.yaml -o out",)
    formats = {p.name: p.read_bytes() for p in sorted((TOOLS / "importer/formats").iterdir())}
    formats["cart.xml"] = formats["cart.xml"].replace(b'meshdir="../meshes"', b"")
    formats["lid.stl"] = meshes()["stl"]
    return [
        *(
            Kind(
                f"imported {format}",
                (f"import {name} -o out",),
                [(changed, formats)],
                XML,
                writes=("out",),
                weight=0.3,
            )
            for format, name, changed in (
                ("SDF", "cart.sdf", "cart.sdf"),
                ("MJCF", "cart.xml", "cart.xml"),
                ("included MJCF", "cart.xml", "wheels.xml"),
            )
        ),
        Kind("imported URDF", command, [("cart.urdf", files)], XML, writes=("out",), weight=0.7),
        Kind(
            "controllers", command, [("controllers.yaml", files)], YAML, writes=("out",), weight=0.3
        ),
        Kind(
            "original configuration",
            ("import original.yaml", "import original.yaml -o out/robot.yaml"),
            [("original.yaml", {"original.yaml": path.read_bytes()}) for path in originals],
            YAML,
            writes=("out",),
            weight=1.5,
        ),
        Kind(
            "DBC",
            ("modules from-dbc battery/mine mine.dbc --node BMS --library out",),
            [("mine.dbc", {"mine.dbc": (TOOLS / "device_files/battery.dbc").read_bytes()})],
            TEXT,
            writes=("out",),
        ),
        Kind(
            "EDS",
            ("modules from-eds controller/mine mine.eds --library out",),
            [
                ("mine.eds", {"mine.eds": (TOOLS / f"device_files/{name}.eds").read_bytes()})
                for name in ("io", "drive")
            ],
            TEXT,
            writes=("out",),
        ),
    ]


GROUND = """\
thorvaldc: 1
scenario: trial
robots: {cart: {robot: robot.yaml}}
duration: 0.1 s
world: {ground: {type: map, file: FILE}}
"""
STATED = ", size: [4 m, 3 m], height: 0.2 m}}"
MJCF = b"""\
<mujoco model="cart"><compiler angle="radian" autolimits="true"/>
  <default><joint damping="0.1"/><default class="wheel"><geom type="cylinder" size="0.1 0.02"/>
    </default></default>
  <asset><mesh name="hood" file="mesh.stl" scale="0.1 0.1 0.1"/><material name="m" rgba="1 0 0 1"/>
    <hfield name="h" nrow="2" ncol="2" size="1 1 0.1 0.1"/></asset>
  <worldbody><geom type="plane" size="1 1 0.1"/><body name="base" pos="0 0 0.1"><freejoint/>
    <geom type="mesh" mesh="hood" mass="1"/><inertial pos="0 0 0" mass="8" diaginertia="1 1 1"/>
    <body name="left" pos="0 0.2 0" euler="-1.57 0 0"><joint name="left_spin" axis="0 0 1"/>
      <geom class="wheel" material="m"/><site name="s"/></body>
    <body name="right" pos="0 -0.2 0" quat="0.7 -0.7 0 0"><joint name="right_spin" range="-1 1"
      axis="0 0 1"/><geom class="wheel"/><camera name="c" fovy="60"/></body></body></worldbody>
  <actuator><velocity name="l" joint="left_spin" kv="5" ctrlrange="-1 1"/>
    <motor name="r" joint="right_spin" gear="2"/></actuator>
  <equality><joint joint1="left_spin" joint2="right_spin" polycoef="0 1 0 0 0"/></equality>
  <sensor><gyro name="g" site="s"/></sensor><keyframe><key qpos="0 0 0 1 0 0 0 0 0"/></keyframe>
</mujoco>
"""


def named_kinds() -> list[Kind]:
    """Returns files of others that robots, modules and scenarios name, and MJCF to be audited."""
    arm = TOOLS / "audit/robots/grinding_arm"
    arm_files = {path.name: path.read_bytes() for path in arm.glob("*.xml")}
    other = {"cart.urdf": CART.encode(), "mesh.stl": meshes()["stl"]}  # the folder is not empty
    cart = {"cart.xml": MJCF, **other}
    ground = ("check scenario.yaml", "scenario scenario.yaml")
    maps = [(name, _ground(name, data)) for name, data in _maps().items()]
    devices = [_module_with_eds(name) for name in ("io", "drive")]
    return [
        Kind("height map", ground, maps, (*BYTES, *TEXT)),
        Kind(
            "PNG with checksums",
            ground,
            [(name, files) for name, files in maps if name.endswith(".png")],
            [_with_checksums(change) for change in BYTES],
            weight=0.5,
        ),
        Kind(
            "EDS of a module",
            (
                *("check robot.yaml", "modules check lib", "build robot.yaml -t can -o out"),
                *("can scan robot.yaml --bus virtual", "can verify robot.yaml --bus virtual"),
            ),
            devices,
            TEXT,
            writes=("out", "robot.lock.yaml"),
        ),
        Kind(
            "audited MJCF",
            ("audit .",),
            [("cart.xml", cart), *((name, {**arm_files, **other}) for name in arm_files)],
            XML,
        ),
    ]


def _maps() -> dict[str, bytes]:
    """Returns height maps of each format, and one that expands to gigabytes."""
    pixels = np.add.outer(np.arange(9), np.arange(12)) * 10.0
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    for tag, value in {33550: (2.0, 3.0, 0.0), 42113: "-9999"}.items():
        tags[tag], tags.tagtype[tag] = value, 2 if isinstance(value, str) else 12
    grey, deep, tiff, packed = (io.BytesIO() for _ in range(4))
    Image.fromarray(pixels.astype(np.uint8)).save(grey, "PNG")
    Image.fromarray((pixels * 200).astype(np.uint16)).save(deep, "PNG")
    Image.fromarray(pixels.astype(np.float32) / 1000).save(tiff, "TIFF", tiffinfo=tags)
    Image.fromarray(pixels.astype(np.float32) / 1000).save(
        packed, "TIFF", tiffinfo=tags, compression="tiff_adobe_deflate"
    )
    images = {"grey.png": grey, "deep.png": deep, "field.tif": tiff, "packed.tif": packed}
    return {
        **{name: image.getvalue() for name, image in images.items()},
        "bomb.png": png_bomb(),
        "field.stl": binary_stl(
            [((0, 0, 0), (9, 0, 0.1), (9, 9, 0)), ((0, 0, 0), (9, 9, 0), (0, 9, 0))]
        ),
    }


def _with_checksums(change: Mutation) -> Mutation:
    """Returns a change of a PNG file, after which the checksums of its chunks are correct."""

    def changed(rng: random.Random, data: bytes) -> bytes:
        image, start = bytearray(change(rng, data)), 8
        while start + 8 <= len(image):
            end = start + 8 + int.from_bytes(image[start : start + 4])
            image[end : end + 4] = zlib.crc32(image[start + 4 : end]).to_bytes(4)
            start = end + 4
        return bytes(image)

    changed.__name__ = f"{change.__name__}_with_checksums"
    return changed


def _ground(name: str, data: bytes) -> dict[str, bytes]:
    text = GROUND.replace("FILE}}", name + (STATED if name.endswith(".png") else "}}"))
    return {"robot.yaml": GOOD.encode(), "scenario.yaml": text.encode(), name: data}


def _module_with_eds(name: str) -> tuple[str, dict[str, bytes]]:
    """Returns a robot with the module of an EDS file, which is the file to change."""
    robot = f"{GOOD}  part: {{type: my/{name}, can: 9}}\nlibrary: [lib]\n"
    if name == "drive":
        robot = robot.replace("can: 9", "can: 9, params: {velocity_unit: 1 rpm}")
    with tempfile.TemporaryDirectory(prefix="thorvaldc_fuzz_") as folder, chdir(folder):
        eds = TOOLS / f"device_files/{name}.eds"
        run_quietly("modules", "from-eds", f"my/{name}", str(eds), "--library", "lib")
        made = {path.as_posix(): path.read_bytes() for path in Path("lib").rglob("*.*")}
    return f"lib/my/{name}/{name}.eds", {"robot.yaml": robot.encode(), **made}
