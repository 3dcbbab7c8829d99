"""Errors to put into the generated files of a robot, one small change each.

They are for the robot of ``test_agreement.victim``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass

URDF = "urdf/robot.urdf"
MJCF = "mjcf/robot.xml"
SCENE = "mjcf/scene.xml"
Change = Callable[[ET.Element], None]


@dataclass(frozen=True)
class SeededError:
    name: str
    file: str
    apply: Change


def _one(root: ET.Element, path: str) -> ET.Element:
    element = root.find(path)
    assert element is not None, path
    return element


def _parent(root: ET.Element, child: ET.Element) -> ET.Element:
    return next(element for element in root.iter() if child in list(element))


def put(path: str, key: str, value: str) -> Change:
    """Set an attribute."""
    return lambda root: _one(root, path).set(key, value)


def edit(path: str, key: str, change: Callable[[list[float]], list[float]]) -> Change:
    """Change the numbers in an attribute."""

    def run(root: ET.Element) -> None:
        element = _one(root, path)
        values = [float(v) for v in element.get(key, "").split()]
        element.set(key, " ".join(repr(v) for v in change(values)))

    return run


def drop(path: str) -> Change:
    """Remove an element."""

    def run(root: ET.Element) -> None:
        element = _one(root, path)
        _parent(root, element).remove(element)

    return run


def drop_key(path: str, key: str) -> Change:
    def run(root: ET.Element) -> None:
        del _one(root, path).attrib[key]

    return run


def swap(one: str, two: str, key: str) -> Change:
    """Exchange an attribute of two elements."""

    def run(root: ET.Element) -> None:
        a, b = _one(root, one), _one(root, two)
        first, second = a.get(key, ""), b.get(key, "")
        a.set(key, second)
        b.set(key, first)

    return run


def text(path: str, value: str) -> Change:
    def run(root: ET.Element) -> None:
        _one(root, path).text = value

    return run


def move(path: str, target: str) -> Change:
    """Move an element below another one."""

    def run(root: ET.Element) -> None:
        element = _one(root, path)
        _parent(root, element).remove(element)
        _one(root, target).append(element)

    return run


def rename(path: str, tag: str) -> Change:
    def run(root: ET.Element) -> None:
        _one(root, path).tag = tag

    return run


def add(path: str, tag: str, **attributes: str) -> Change:
    return lambda root: _one(root, path).append(ET.Element(tag, attributes))


def scaled(factor: float) -> Callable[[list[float]], list[float]]:
    return lambda values: [factor * v for v in values]


def shifted(index: int, by: float) -> Callable[[list[float]], list[float]]:
    return lambda values: [v + by if i == index else v for i, v in enumerate(values)]


def reordered(*order: int) -> Callable[[list[float]], list[float]]:
    return lambda values: [values[i] for i in order]


def _link(name: str, inner: str = "") -> str:
    return f"link[@name='{name}']{inner}"


def _joint(name: str, inner: str = "") -> str:
    return f"joint[@name='{name}']{inner}"


def _body(name: str, inner: str = "") -> str:
    return f".//body[@name='{name}']{inner}"


def _hinge(name: str) -> str:
    return f".//worldbody//joint[@name='{name}']"


def _degrees(values: list[float]) -> list[float]:
    return [57.29577951308232 * v for v in values]


_URDF: dict[str, Change] = {
    "urdf_mass": edit(_link("w0_leg", "/inertial/mass"), "value", scaled(1.0001)),
    "urdf_inertial_lost": drop(_link("w1_tyre", "/inertial")),
    "urdf_centre_of_mass": edit(_link("w0_leg", "/inertial/origin"), "xyz", shifted(1, 1e-6)),
    "urdf_inertial_turned": put(_link("w0_leg", "/inertial/origin"), "rpy", "0 0 0.01"),
    "urdf_inertia_entry": edit(_link("w0_leg", "/inertial/inertia"), "izz", scaled(1.001)),
    "urdf_inertia_sign": edit(_link("frame_body", "/inertial/inertia"), "ixy", scaled(-1)),
    "urdf_axis_sign": edit(_joint("w0_axle", "/axis"), "xyz", scaled(-1)),
    "urdf_axis_other": put(_joint("w1_axle", "/axis"), "xyz", "1 0 0"),
    "urdf_axis_tilted": put(_joint("w0_turn", "/axis"), "xyz", "0 0.001 1"),
    "urdf_joint_moved": edit(_joint("w0_travel", "/origin"), "xyz", shifted(0, 1e-6)),
    "urdf_joint_mirrored": edit(_joint("w1_travel", "/origin"), "xyz", scaled(-1)),
    "urdf_rpy_sign": edit(_joint("extra0_joint", "/origin"), "rpy", scaled(-1)),
    "urdf_rpy_order": edit(_joint("extra1_joint", "/origin"), "rpy", reordered(2, 1, 0)),
    "urdf_lower_limit": edit(_joint("w0_turn", "/limit"), "lower", scaled(0.999)),
    "urdf_upper_in_degrees": edit(_joint("w1_turn", "/limit"), "upper", _degrees),
    "urdf_limits_swapped_joints": swap(
        _joint("w0_travel", "/limit"), _joint("w0_turn", "/limit"), "upper"
    ),
    "urdf_effort": edit(_joint("w0_axle", "/limit"), "effort", scaled(2)),
    "urdf_effort_of_spring": edit(_joint("w0_travel", "/limit"), "effort", scaled(1.1)),
    "urdf_velocity": edit(_joint("w0_axle", "/limit"), "velocity", scaled(9.55)),
    "urdf_velocity_of_steering": edit(_joint("w0_turn", "/limit"), "velocity", scaled(0.5)),
    "urdf_limit_lost": drop(_joint("w2_axle", "/limit")),
    "urdf_damping": edit(_joint("w0_travel", "/dynamics"), "damping", scaled(0.1)),
    "urdf_friction": edit(_joint("w2_axle", "/dynamics"), "friction", shifted(0, 0.01)),
    "urdf_dynamics_lost": drop(_joint("w3_turn", "/dynamics")),
    "urdf_revolute_to_continuous": put(_joint("w0_turn"), "type", "continuous"),
    "urdf_continuous_to_fixed": put(_joint("w3_axle"), "type", "fixed"),
    "urdf_prismatic_to_revolute": put(_joint("w0_travel"), "type", "revolute"),
    "urdf_wrong_parent": put(_joint("w3_turn", "/parent"), "link", "w2_leg"),
    "urdf_children_swapped": swap(
        _joint("w0_travel", "/child"), _joint("w1_travel", "/child"), "link"
    ),
    "urdf_names_swapped": swap(_joint("w0_axle"), _joint("w1_axle"), "name"),
    "urdf_link_renamed": put(_link("w3_leg"), "name", "w3_log"),
    "urdf_joint_lost": drop(_joint("w3_axle")),
    "urdf_visual_lost": drop(_link("w0_leg", "/visual")),
    "urdf_visual_moved": edit(_link("w0_leg", "/visual/origin"), "xyz", shifted(2, 1e-6)),
    "urdf_visual_turned": edit(_link("w0_leg", "/visual/origin"), "rpy", shifted(0, 1e-6)),
    "urdf_visual_size": edit(
        _link("frame_body", "/visual/geometry/box"), "size", reordered(1, 0, 2)
    ),
    "urdf_mesh_scale": edit(".//visual/geometry/mesh", "scale", scaled(1000)),
    "urdf_mesh_missing": put(".//visual/geometry/mesh", "filename", "../meshes/none.stl"),
    "urdf_mesh_other": put(".//visual/geometry/mesh", "filename", "../meshes/tip.stl"),
    "urdf_colour": put("material/color", "rgba", "0.5 0.5 0.6 1"),
    "urdf_material_other": put(_link("w0_tyre", "/visual/material"), "name", "color_808080"),
    "urdf_collision_lost": drop(_link("frame_body", "/collision")),
    "urdf_collision_radius": edit(
        _link("w0_tyre", "/collision/geometry/cylinder"), "radius", scaled(0.5)
    ),
    "urdf_collision_turned": put(_link("w0_tyre", "/collision/origin"), "rpy", "0 0 0"),
    "urdf_mimic_multiplier": edit(".//joint/mimic", "multiplier", scaled(-1)),
    "urdf_mimic_offset": edit(".//joint/mimic", "offset", shifted(0, 0.01)),
    "urdf_mimic_lost": drop(".//joint/mimic"),
    "urdf_hint_lost": drop("mujoco"),
    "urdf_spring_lost": drop("gazebo[@reference='w0_travel']"),
    "urdf_spring_reference_sign": text("gazebo[@reference='w0_travel']/springReference", "0.02"),
    "urdf_tyre_friction": text("gazebo[@reference='w2_tyre']/mu1", "1.0"),
    "urdf_root_with_mass": move(_link("w3_leg", "/inertial"), _link("base_link")),
}

_MJCF: dict[str, Change] = {
    "mjcf_mass": edit(_body("w0_leg", "/inertial"), "mass", scaled(1.0001)),
    "mjcf_inertia_order": edit(
        _body("w0_leg", "/inertial"), "fullinertia", reordered(0, 1, 2, 3, 5, 4)
    ),
    "mjcf_inertia_sign": edit(
        _body("frame_body", "/inertial"),
        "fullinertia",
        lambda v: [*v[:3], -v[3], -v[4], -v[5]],
    ),
    "mjcf_centre_of_mass": edit(_body("w0_leg", "/inertial"), "pos", shifted(0, 1e-6)),
    "mjcf_body_moved": edit(_body("w2_tyre"), "pos", shifted(1, 1e-6)),
    "mjcf_quat_order": edit(_body("extra0_body"), "quat", reordered(1, 2, 3, 0)),
    "mjcf_quat_conjugate": edit(
        _body("extra1_body"), "quat", lambda v: [v[0], -v[1], -v[2], -v[3]]
    ),
    "mjcf_wrong_parent": move(_body("w3_leg"), _body("w2_leg")),
    "mjcf_bodies_swapped": swap(_body("w0_tyre"), _body("w1_tyre"), "name"),
    "mjcf_free_joint_lost": drop(".//freejoint"),
    "mjcf_axis_sign": edit(_hinge("w0_axle"), "axis", scaled(-1)),
    "mjcf_axis_other": put(_hinge("w1_turn"), "axis", "0 1 0"),
    "mjcf_anchor": put(_hinge("w2_axle"), "pos", "0 0.01 0"),
    "mjcf_hinge_to_slide": put(_hinge("w3_axle"), "type", "slide"),
    "mjcf_range_in_degrees": edit(_hinge("w0_turn"), "range", _degrees),
    "mjcf_range_lost": drop_key(_hinge("w0_turn"), "range"),
    "mjcf_damping": edit(_hinge("w0_travel"), "damping", scaled(0.1)),
    "mjcf_armature_lost": drop_key(_hinge("w0_axle"), "armature"),
    "mjcf_rolling_loss": edit(_hinge("w2_axle"), "frictionloss", scaled(0.5)),
    "mjcf_stiffness": edit(_hinge("w0_travel"), "stiffness", scaled(1.01)),
    "mjcf_spring_reference_sign": edit(_hinge("w0_travel"), "springref", scaled(-1)),
    "mjcf_mimic_lost": drop("equality/joint"),
    "mjcf_mimic_factor": edit("equality/joint", "polycoef", reordered(1, 0, 2, 3, 4)),
    "mjcf_visual_full_size": edit(_body("frame_body", "/geom"), "size", scaled(2)),
    "mjcf_visual_moved": edit(_body("w0_leg", "/geom"), "pos", shifted(2, 1e-6)),
    "mjcf_visual_lost": drop(_body("w0_leg", "/geom")),
    "mjcf_visual_material": put(_body("w0_tyre", "/geom"), "material", "color_808080"),
    "mjcf_visual_touches": drop_key("default/default[@class='visual']/geom", "contype"),
    "mjcf_collision_lost": drop(_body("frame_body", "/geom[@class='collision']")),
    "mjcf_collision_meets_itself": edit(
        _body("frame_body", "/geom[@class='collision']"), "contype", shifted(0, 1)
    ),
    "mjcf_mesh_scale": edit("asset/mesh", "scale", scaled(1.01)),
    "mjcf_mesh_missing": put("asset/mesh", "file", "../meshes/none.stl"),
    "mjcf_tread_radius": edit(
        _body("w0_tyre", "/geom[@class='wheel']"), "size", lambda v: [v[0] + 1e-4, v[1], v[2]]
    ),
    "mjcf_tread_width": edit(
        _body("w0_tyre", "/geom[@class='wheel']"), "size", lambda v: [v[0], v[1], 2 * v[2]]
    ),
    "mjcf_tread_turned": drop_key(_body("w0_tyre", "/geom[@class='wheel']"), "quat"),
    "mjcf_tread_shifted": put(_body("w0_tyre", "/geom[@class='wheel']"), "pos", "0 0.01 0"),
    "mjcf_tread_twice": add(
        _body("w2_tyre"), "geom", type="sphere", size="0.1", mass="0", group="3"
    ),
    "mjcf_tread_friction": edit(
        _body("w0_tyre", "/geom[@class='wheel']"), "friction", lambda v: [0.5, *v[1:]]
    ),
    "mjcf_tread_torsion": edit(
        _body("w0_tyre", "/geom[@class='wheel']"), "friction", lambda v: [v[0], 0.8, v[2]]
    ),
    "mjcf_contact_dimensions": put("default/default[@class='wheel']/geom", "condim", "3"),
    "mjcf_solimp": put("default/default[@class='wheel']/geom", "solimp", "0.9 0.95 0.001"),
    "mjcf_solref": put("default/default[@class='wheel']/geom", "solref", "0.02 1"),
    "mjcf_pyramidal_cone": put("option", "cone", "pyramidal"),
    "mjcf_impratio": put("option", "impratio", "10"),
    "mjcf_actuator_lost": drop("actuator/intvelocity"),
    "mjcf_actuators_swapped": swap(
        "actuator/intvelocity[@name='w0_propulsion']",
        "actuator/intvelocity[@name='w1_propulsion']",
        "joint",
    ),
    "mjcf_gear": put("actuator/intvelocity", "gear", "-1"),
    "mjcf_torque": edit("actuator/intvelocity", "forcerange", scaled(42)),
    "mjcf_speed": edit("actuator/intvelocity", "ctrlrange", scaled(0.2)),
    "mjcf_kp": edit("actuator/intvelocity", "kp", scaled(2)),
    "mjcf_kv": edit("actuator/intvelocity", "kv", scaled(0.5)),
    "mjcf_no_integrator": rename("actuator/intvelocity", "velocity"),
    "mjcf_steering_range": edit("actuator/position", "ctrlrange", scaled(0.5)),
    "mjcf_steering_stiffness": put("actuator/position", "kp", "400"),
    "mjcf_sensor_lost": drop("sensor/jointpos"),
    "mjcf_sensor_of_other_joint": swap("sensor/jointpos[1]", "sensor/jointpos[2]", "joint"),
    "mjcf_gyro_lost": drop("sensor/gyro"),
    "mjcf_site_elsewhere": move(".//site[@name='scan']", _body("frame_body")),
    "mjcf_camera_view": edit(".//camera", "fovy", scaled(1.5)),
}

_SCENE: dict[str, Change] = {
    "scene_home_too_low": edit("keyframe/key", "qpos", shifted(2, -1e-4)),
    "scene_home_lost": drop("keyframe"),
    "scene_ground_higher": put("worldbody/geom[@name='ground']", "pos", "0 0 0.001"),
    "scene_moon": add(".", "option", gravity="0 0 -1.62"),
}

SEEDED_ERRORS: tuple[SeededError, ...] = tuple(
    SeededError(name, file, change)
    for file, changes in ((URDF, _URDF), (MJCF, _MJCF), (SCENE, _SCENE))
    for name, change in changes.items()
)
