"""Files of others that `import` and `modules from-...` read."""

from __future__ import annotations

from tests.fuzz.generator import ROOT, TEXT, XML, YAML, Kind
from tests.fuzz.products import meshes

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
