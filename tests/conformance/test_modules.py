"""All modules of the library: sources, meshes, sizes, and each module type in a small robot."""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import trimesh
import yaml

from thorvaldc.compiler.catalogue import check_library
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot

ROOT = Path(__file__).resolve().parent.parent.parent
MODULES = ROOT / "modules"
NAMES = sorted(p.parent.relative_to(MODULES).as_posix() for p in MODULES.glob("*/*/module.yaml"))
MESHES = sorted(p.relative_to(ROOT).as_posix() for p in ROOT.glob("*/**/meshes/*.stl"))
MESHES = [m for m in MESHES if m.split("/")[0] in ("modules", "examples")]
ORIGINS = ("datasheet:", "measured:", "published:", "estimated:", "chosen:", "derived:")
MAX_BYTES = 300_000


def document(name: str) -> dict[str, Any]:
    """Returns the module.yaml of a module type."""
    content: dict[str, Any] = yaml.safe_load((MODULES / name / "module.yaml").read_text())
    return content


def parts_of(name: str) -> Iterator[dict[str, Any]]:
    for link in document(name).get("links", {}).values():
        yield from link.get("parts", [])


def compiled(folder: Path, modules: dict[str, Any], **sections: Any) -> Robot:
    """Compiles a robot with these modules and sections; fails on diagnostics, also warnings."""
    file = folder / "robot.yaml"
    accept = [{"code": "TV443", "reason": "a test of other modules, without a battery"}]
    if any(module["type"].startswith("battery/") for module in modules.values()):
        accept = []
    document = {"thorvaldc": 1, "name": "small", "accept": accept, "modules": modules, **sections}
    file.write_text(yaml.safe_dump(document))
    compilation = compile_file(file)
    # The tests mount modules where nothing is; tests/compiler/test_room_checks.py judges places.
    report = [d for d in compilation.report if d.code.name not in ("part-loose", "parts-overlap")]
    assert not report, [d.message for d in report]
    assert isinstance(compilation.model, Robot)
    return compilation.model


# x, y in base_link, m
POSITIONS = {"fl": (0.55, 0.45), "fr": (0.55, -0.45), "rl": (-0.55, 0.45), "rr": (-0.55, -0.45)}


def on_four(wheel: dict[str, Any], root: str = "frame/tube_rectangular") -> dict[str, Any]:
    """Returns a frame with four modules of one type."""
    modules: dict[str, Any] = {"base": {"type": root}}
    for name, (x, y) in POSITIONS.items():
        modules[name] = {**wheel, "mount": {"parent": "base", "xyz": [x, y, 0]}}
    return modules


STEERED = {"type": "assembly/steered_drive"}
CONTROLLERS = {
    "controller/propulsion_steering": ("propulsion", "steering"),
    "controller/cia402_propulsion_steering": ("propulsion", "steering"),
    "controller/cia402_propulsion": ("propulsion",),
}
REQUIRED_PARAMS = {"frame/tube": {"length": "1 m"}, "frame/beam": {"length": "1 m"}}


def small_robot(name: str) -> dict[str, Any]:
    """Returns a small robot with a module of this type, called ``base``, ``fl`` or ``it``."""
    content = document(name)
    if "mount" not in content and "modules" not in content:
        return on_four(STEERED, name)
    if name.startswith("wheel/") and "drive_flange" in content["mount"]["kinds"]:
        return on_four({"type": "assembly/steered_drive", "params": {"wheel": name}})
    if "wheel" in content or "modules" in content:
        return on_two({"type": name})
    modules = on_four(STEERED)
    mount = {"parent": "base", "xyz": [0, 0, 0.1]}
    modules["it"] = {"type": name, "mount": mount, "params": REQUIRED_PARAMS.get(name, {})}
    if name in CONTROLLERS:
        modules["fl"]["params"] = {"controller": "none"}
        modules["it"]["channels"] = {role: f"fl.{role}" for role in CONTROLLERS[name]}
    if name == "controller/cia402_propulsion":
        modules["other"] = {
            "type": "controller/propulsion_steering",
            "channels": {"steering": "fl.steering"},
        }
    return modules


def on_two(wheel: dict[str, Any]) -> dict[str, Any]:
    """Returns a frame with two modules of one type in front, and rear wheels that can turn."""
    fixed = wheel["type"] == "assembly/fixed_drive"
    modules = on_four({"type": "caster/swivel"} if fixed else STEERED)
    for name in ("fl", "fr"):
        modules[name] = {**modules[name], **wheel}
        if wheel["type"] == "wheel/passive":  # mounted at the height of its axle, without a leg
            modules[name]["mount"] = {"parent": "base", "xyz": [*POSITIONS[name], -0.5]}
    if fixed:
        channels = {"left": "fl.propulsion", "right": "fr.propulsion"}
        modules["both"] = {"type": "controller/propulsion_propulsion", "channels": channels}
    return modules


# Parts of assemblies: the tests of the assemblies include them.
PARTS = (
    "drive/standard",
    "steering/standard",
    "suspension/standard",
    "controller/propulsion_propulsion",
)


@pytest.mark.parametrize("name", [n for n in NAMES if n not in PARTS])
def test_small_robot_with_the_module_compiles(name: str, tmp_path: Path) -> None:
    robot = compiled(tmp_path, small_robot(name))
    names = {link.module.split(".")[0] for link in robot.links}
    assert names & {"it", "fl", "base"}
    assert all(wheel.load > 20.0 for wheel in robot.wheels)
    assert all(abs(wheel.contact_height) < 1e-9 for wheel in robot.wheels)


def test_check_of_the_library_reports_nothing() -> None:
    check = check_library(None)
    assert check.names == NAMES
    assert not list(check.report), [d.message for d in check.report]


@pytest.mark.parametrize("name", NAMES)
def test_module_folder_is_small(name: str) -> None:
    size = sum(p.stat().st_size for p in (MODULES / name).rglob("*") if p.is_file())
    assert size < MAX_BYTES


@pytest.mark.parametrize("name", NAMES)
def test_numbers_have_a_source(name: str) -> None:
    content = document(name)
    items = [p for p in content.get("params", {}).values() if "default" in p]
    items += [part for part in parts_of(name) if "mass" in part]
    items += list(content.get("motors", {}).values()) if "links" in content else []
    items += [content["wheel"]] if "wheel" in content else []
    for item in items:
        assert item.get("source", "").startswith(ORIGINS), item


@pytest.mark.parametrize("name", NAMES)
def test_meshes_are_used_and_exist(name: str) -> None:
    referenced = {
        part["shape"]["mesh"]["file"] for part in parts_of(name) if "mesh" in part.get("shape", {})
    }
    files = {f"meshes/{p.name}" for p in (MODULES / name / "meshes").glob("*")}
    assert referenced == files


@pytest.mark.parametrize("path", MESHES)
def test_mesh_is_closed(path: str) -> None:
    mesh = trimesh.load(io.BytesIO((ROOT / path).read_bytes()), file_type="stl", force="mesh")
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert float(abs(mesh.bounds).max()) < 1.5  # unit shapes and single parts, in metres
    assert len(mesh.faces) < 3000


def test_meshes_are_up_to_date() -> None:
    command = [sys.executable, str(ROOT / "workshop" / "make_meshes.py"), "--check"]
    process = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert (process.returncode, process.stdout, process.stderr) == (0, "", "")


def test_palette_has_exactly_the_used_colors() -> None:
    palette = yaml.safe_load((MODULES / "palette.yaml").read_text())
    used = {part["color"] for name in NAMES for part in parts_of(name) if "color" in part}
    assert {c for c in used if not c.startswith("#")} == set(palette)


@pytest.mark.parametrize("radius", [0.12, 0.2, 0.21])
@pytest.mark.parametrize("drive", ["steered_drive", "suspended_steered_drive"])
def test_frame_height_does_not_depend_on_the_wheels(
    drive: str, radius: float, tmp_path: Path
) -> None:
    """The frame is at 0.65 m and the contact point is below the mount, for every wheel radius."""
    wheel = {"type": "wheel/agri_200", "params": {"radius": radius}}
    robot = compiled(tmp_path, on_four({"type": f"assembly/{drive}", "params": {"wheel": wheel}}))
    assert robot.joint("base_mount").pose.xyz[2] == pytest.approx(0.65, abs=1e-9)
    for name, (x, y) in POSITIONS.items():
        (wheel_model,) = (w for w in robot.wheels if w.module.split(".")[0] == name)
        assert (
            wheel_model.x,
            wheel_model.y,
            wheel_model.trail,
            wheel_model.lateral_offset,
        ) == pytest.approx((x, y, 0, 0))


def test_a_leg_on_the_other_side_is_its_mirror_image(tmp_path: Path) -> None:
    modules = on_four(STEERED)
    modules["fl"]["params"] = {"leg_side": "right"}
    modules["fr"]["params"] = {"leg_side": "left"}
    robot = compiled(tmp_path, modules)
    for part in ("steering_housing", "drive_leg", "drive_hub"):
        left, right = robot.link(f"fl_{part}").inertial, robot.link(f"fr_{part}").inertial
        assert left is not None
        assert right is not None
        x, y, z = left.com
        assert right.com == pytest.approx((x, -y, z), abs=1e-12)
        ixx, iyy, izz, ixy, ixz, iyz = left.inertia
        assert right.inertia == pytest.approx((ixx, iyy, izz, -ixy, ixz, -iyz), abs=1e-12)


def test_leg_has_the_estimated_mass(tmp_path: Path) -> None:
    """Drive and steering module together have 18.04 kg; see modules/README.md."""
    robot = compiled(tmp_path, on_four(STEERED))
    leg = [link for link in robot.links if link.module.startswith(("fl.drive", "fl.steering"))]
    assert sum(link.inertial.mass for link in leg if link.inertial) == pytest.approx(18.04)


BIG_WHEEL = """\
thorvaldc: 1
description: Wheel of 0.4 m with a flotation tyre.
mount: {kinds: [drive_flange], link: tyre}
links:
  tyre:
    parts:
      - {shape: {mesh: {file: meshes/tyre.stl}}, color: tyre}
      - shape: {cylinder: {radius: 0.4, length: 0.3}}
        rpy: [90 deg, 0, 0]
        show: false
        collide: true
        mass: 19 kg
        source: "datasheet: tyre 14 kg, rim 5 kg"
wheel:
  {link: tyre, radius: 0.4, width: 0.3, friction: 0.8, rolling_resistance: 0.03,
   source: "datasheet: tyre"}
"""


def test_a_wheel_without_parameters_works(tmp_path: Path) -> None:
    """The legs read its radius from its section `wheel`."""
    module_folder = tmp_path / "my_modules" / "wheel" / "big_400"
    shutil.copytree(MODULES / "wheel" / "agri_200" / "meshes", module_folder / "meshes")
    (module_folder / "module.yaml").write_text(BIG_WHEEL)
    assert not list(check_library(tmp_path / "my_modules").report)
    modules = on_four({"type": "assembly/steered_drive", "params": {"wheel": "wheel/big_400"}})
    modules["base"]["params"] = {"length": "1.6 m", "width": "1.4 m"}
    robot = compiled(tmp_path, modules, library=["my_modules"])
    assert {w.radius for w in robot.wheels} == {0.4}
    assert robot.joint("base_mount").pose.xyz[2] == pytest.approx(2 * 0.4 + 0.22)
