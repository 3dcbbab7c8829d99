"""SDF files: Drake reads the robot of the URDF; sensors, controllers, contact shapes, worlds."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.backend_files import files_of
from tests.backends.conftest import write
from tests.backends.drake_jobs import read_by_drake
from tests.backends.plans import ROBOTS as PLANS
from tests.backends.plans import SAMPLED_PLANS, Plan, build
from tests.examples import FLEETS, FOLDER, SAMPLED_ROBOTS, example_fleet, example_robot
from tests.slow import mostly_slow
from thorvaldc.backends.ros2_parts import bridged_topics
from thorvaldc.backends.sdf import Sdf, world_files
from thorvaldc.backends.sdf_robot import CAMERA
from thorvaldc.backends.urdf import Urdf
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Fleet, Pose, Robot
from thorvaldc.model.spatial import rotate


def robots() -> dict[str, Robot]:
    named = {name: example_robot(name) for name in SAMPLED_ROBOTS}
    for fleet in FLEETS[:1]:
        named |= {f"{fleet}-{p.name}": p.robot for p in example_fleet(fleet).placements}
    return named | {
        name: robot
        for name, robot in PLANS.items()
        if name in SAMPLED_PLANS and not has_mimics(robot)
    }


def has_mimics(robot: Robot) -> bool:
    return any(joint.mimic is not None for joint in robot.joints)


@pytest.mark.slow
def test_drake_reads_the_robot_of_the_urdf(tmp_path: Path) -> None:
    """Masses, inertias, axes, poses at random joint positions, and limits; every robot floats."""
    jobs = []
    for name, robot in robots().items():
        folder = write({**files_of(Urdf, robot), **files_of(Sdf, robot)}, tmp_path / name)
        urdf, sdf = folder / "urdf/robot.urdf", folder / "sdf/model.sdf"
        jobs.append({"kind": "compare", "urdf": str(urdf), "sdf": str(sdf)})
    results = read_by_drake(jobs)
    assert {n: d for n, d in zip(robots(), results, strict=True) if d} == {}


@pytest.mark.parametrize(
    "change", mostly_slow(["<mass>", "<ixx>", "<upper>", "<xyz>", "<pose relative_to"])
)
def test_drake_notices_changes(change: str, tmp_path: Path) -> None:
    robot = example_robot("4wd4ws_wide")
    folder = write({**files_of(Urdf, robot), **files_of(Sdf, robot)}, tmp_path)
    sdf = folder / "sdf/model.sdf"
    lines = sdf.read_text().splitlines()
    (index, *_) = (i for i, line in enumerate(lines) if change in line and "1e16" not in line)
    head, _, rest = lines[index].partition(">")
    values, _, tail = rest.partition("<")
    numbers = [float(value) for value in values.split()]
    if change == "<xyz>":
        numbers = numbers[1:] + numbers[:1]
    else:
        numbers[0] += 0.001
    lines[index] = f"{head}>{' '.join(map(str, numbers))}<{tail}"
    sdf.write_text("\n".join(lines))
    job = {"kind": "compare", "urdf": str(folder / "urdf/robot.urdf"), "sdf": str(sdf)}
    assert read_by_drake([job])[0]


def scenario_fleet(name: str) -> Fleet:
    fleet = compile_file(FOLDER / "scenarios" / f"{name}.yaml").model
    assert isinstance(fleet, Fleet)
    return fleet


def test_massless_links_are_frames() -> None:
    robot = example_robot("4wd4ws_wide")
    model = ElementTree.fromstring(files_of(Sdf, robot)["sdf/model.sdf"]).find("model")
    assert model is not None
    links = {link.get("name") for link in model.findall("link")}
    frames = {frame.get("name") for frame in model.findall("frame")}
    assert links | frames == {link.name for link in robot.links}
    assert not links & frames
    masses = [float(element.text or "") for element in model.iter("mass")]
    assert math.fsum(masses) == pytest.approx(robot.inertial.mass)
    assert len(masses) == len(links)


def test_sensors_have_their_properties_and_frames() -> None:
    robot = example_robot("4wd4ws_wide")
    root = ElementTree.fromstring(files_of(Sdf, robot)["sdf/model.sdf"])
    sensors = {str(sensor.get("name")): sensor for sensor in root.iter("sensor")}
    assert set(sensors) == {sensor.name for sensor in robot.sensors}
    for sensor in robot.sensors:
        element, values = sensors[sensor.name], dict(sensor.properties)
        assert element.findtext("gz_frame_id") == sensor.link
        assert float(element.findtext("update_rate") or "") == values["rate"]
        if sensor.type == "lidar_2d":
            half = float(values["field_of_view"]) / 2
            horizontal = element.find("lidar/scan/horizontal")
            assert horizontal is not None
            assert float(horizontal.findtext("max_angle") or "") == pytest.approx(half)
            samples = int(horizontal.findtext("samples") or "")
            step = 2 * half / (samples - 1)
            assert step == pytest.approx(float(values["angular_resolution"]), rel=1e-3)
    systems = {plugin.get("name") for plugin in world(robot).iter("plugin")}
    assert "gz::sim::systems::Sensors" in systems
    assert "gz::sim::systems::Imu" in systems


def world(model: Robot | Fleet) -> ElementTree.Element:
    return ElementTree.fromstring(files_of(Sdf, model)["sdf/world.sdf"])


def test_a_camera_looks_along_z_of_its_optical_frame() -> None:
    assert rotate(CAMERA.quat, (1.0, 0.0, 0.0)) == pytest.approx((0.0, 0.0, 1.0))
    assert rotate(CAMERA.quat, (0.0, 0.0, 1.0)) == pytest.approx((0.0, -1.0, 0.0))


def test_each_motor_has_a_controller() -> None:
    robot = example_robot("4wd4ws_wide")
    root = ElementTree.fromstring(files_of(Sdf, robot)["sdf/model.sdf"])
    controllers = {
        plugin.findtext("joint_name"): str(plugin.get("name")).rpartition(":")[2]
        for plugin in root.iter("plugin")
        if plugin.find("topic") is not None and "Controller" in str(plugin.get("name"))
    }
    assert controllers == {
        actuator.joint: "JointController"
        if actuator.role == "propulsion"
        else "JointPositionController"
        for actuator in robot.actuators
    }


# Elements that the systems of Gazebo read, from the sources of gz-sim on 2026-07-02.
SYSTEM_ELEMENTS = {
    "JointController": "joint_name topic cmd_max cmd_min initial_velocity use_force_commands",
    "JointPositionController": "joint_name topic cmd_max cmd_min initial_position "
    "use_velocity_commands p_gain i_gain d_gain i_max i_min cmd_offset",
    "JointStatePublisher": "joint_name topic update_rate",
    "OdometryPublisher": "odom_frame robot_base_frame odom_topic odom_publish_frequency "
    "dimensions tf_topic xyz_offset rpy_offset gaussian_noise odom_covariance_topic",
}


def test_systems_of_gazebo_know_their_elements() -> None:
    for robot in robots().values():
        root = ElementTree.fromstring(files_of(Sdf, robot)["sdf/model.sdf"])
        for plugin in root.iter("plugin"):
            library, name = str(plugin.get("filename")), str(plugin.get("name"))
            assert name.startswith("gz::sim::systems::")
            name = name.removeprefix("gz::sim::systems::")
            words = library.removeprefix("gz-sim-").removesuffix("-system").split("-")
            assert "".join(map(str.capitalize, words)) == name
            assert {element.tag for element in plugin} <= set(SYSTEM_ELEMENTS[name].split())


@pytest.mark.parametrize("camber", [0.0, 0.1, -0.2])
def test_sphere_of_a_tyre_touches_where_the_wheel_rolls(camber: float) -> None:
    """The lowest point of the sphere lies on the rolling circle, also with camber."""
    plans = [Plan(0.5, y, camber=camber) for y in (0.4, -0.4)] + [Plan(-0.5, 0.0)]
    robot = build(plans)
    root = ElementTree.fromstring(files_of(Sdf, robot)["sdf/model.sdf"])
    wheel = robot.wheels[0]
    for collision in root.iter("collision"):
        if collision.get("name") == f"{wheel.link}_collision_0":
            break
    radius = float(collision.findtext("geometry/sphere/radius") or "")
    pose = [float(value) for value in (collision.findtext("pose") or "0 0 0 0 0 0").split()]
    assert radius == pytest.approx(wheel.radius / math.cos(camber))
    assert math.hypot(*pose[:3]) == pytest.approx(abs(wheel.radius * math.tan(camber)))


def test_fleet_has_one_world_with_all_robots() -> None:
    fleet = example_fleet(FLEETS[0])
    models = world(fleet).findall("world/model")
    names = [model.get("name") for model in models]
    assert set(names) == {"ground", *(placement.robot.namespace for placement in fleet.placements)}
    for placement in fleet.placements:
        (model,) = (m for m in models if m.get("name") == placement.robot.namespace)
        pose = [float(value) for value in (model.findtext("pose") or "0 0 0").split()]
        assert pose[:3] == pytest.approx(placement.pose.xyz)


def test_a_slope_inclines_gravity_and_rough_ground_is_a_mesh() -> None:
    files = files_of(Sdf, scenario_fleet("field_edge"))
    gravity = ElementTree.fromstring(files["sdf/world.sdf"]).findtext("world/gravity")
    assert gravity is not None
    x, y, z = map(float, gravity.split())
    angle = math.radians(4.0)  # uphill along y
    assert (x, y, z) == pytest.approx((0.0, -9.81 * math.sin(angle), -9.81 * math.cos(angle)))
    data = files["sdf/terrain.stl"]
    (count,) = struct.unpack_from("<I", data, 80)
    assert len(data) == 84 + 50 * count
    triangles = [struct.unpack_from("<12f", data, 84 + 50 * i) for i in range(count)]
    assert all(triangle[2] > 0.0 for triangle in triangles)  # normals point up
    xs, ys, zs = ([v for t in triangles for v in t[3 + k :: 3]] for k in range(3))
    assert (min(xs), max(xs), min(ys), max(ys)) == pytest.approx((-20.0, 20.0, -12.0, 12.0))
    assert (min(zs), max(zs)) == pytest.approx((-0.015, 0.015), abs=1e-6)


@pytest.mark.slow
def test_a_world_without_robots_has_all_else() -> None:
    fleet = scenario_fleet("field_edge")
    robots = [placement.robot for placement in fleet.placements]
    poses = [placement.pose for placement in fleet.placements]
    files = world_files(fleet.name, robots, fleet.world, poses)
    complete = files_of(Sdf, fleet)
    assert files["sdf/terrain.stl"] == complete["sdf/terrain.stl"]
    expected = world(fleet).find("world")
    empty = ElementTree.fromstring(files["sdf/world.sdf"]).find("world")
    assert expected is not None
    assert empty is not None
    spaces = {robot.namespace or robot.name for robot in robots}
    kept = [e for e in expected if e.tag != "model" or e.get("name") not in spaces]
    assert list(map(canonical, empty)) == list(map(canonical, kept))


def canonical(element: ElementTree.Element) -> str:
    return ElementTree.canonicalize(ElementTree.tostring(element, "unicode"), strip_text=True)


# -- sensors of extras -----------------------------------------------------------------

SCAN = """<gazebo reference="{link}">
  <sensor name="scan" type="ray"><pose>0.1 0 0 0 0 1.5</pose><update_rate>15</update_rate>
    <ray><scan><horizontal><samples>360</samples></horizontal></scan></ray>
    <plugin name="ros" filename="libgazebo_ros_ray_sensor.so"/></sensor>
  <sensor name="view" type="camera"><topic>/front/image</topic><camera/></sensor>
</gazebo>"""


def with_extensions(*texts: str, namespace: str = "r1") -> Robot:
    robot = example_robot("2wd0ws_greenhouse")
    return replace(robot, namespace=namespace, urdf_extensions=texts)


def test_sensors_of_extras_are_in_the_model_with_their_frames() -> None:
    robot = with_extensions("")
    fixed = next(j for j in robot.joints if j.type == "fixed" and j.pose != Pose())
    robot = with_extensions(SCAN.format(link=fixed.child), '<transmission name="t"/>')
    model = ElementTree.fromstring(files_of(Sdf, robot)["sdf/model.sdf"]).find("model")
    assert model is not None
    frames = {str(frame.get("name")): frame for frame in model.findall("frame")}
    frame = frames[f"r1/{fixed.child}"]
    link = next(e for e in model.findall("link") if e.get("name") == frame.get("attached_to"))
    sensors = {str(sensor.get("name")): sensor for sensor in link.findall("sensor")}
    scan, view = sensors["r1/scan"], sensors["r1/view"]
    assert scan.get("type") == "gpu_lidar"
    assert scan.findtext("lidar/scan/horizontal/samples") == "360"
    assert scan.findtext("topic") == "r1/scan"
    assert scan.findtext("gz_frame_id") == f"r1/{fixed.child}"
    x, y, z, roll, pitch, yaw = map(float, str(frame.findtext("pose")).split())
    at = Pose.from_xyz_rpy((x, y, z), (roll, pitch, yaw))
    x, y, z, roll, pitch, yaw = map(float, str(scan.findtext("pose")).split())
    assert math.dist((x, y, z), at.apply((0.1, 0.0, 0.0))) < 1e-9
    assert math.remainder(yaw - at.rpy()[2] - 1.5, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert view.findtext("topic") == "/front/image"
    assert not list(model.iterfind(".//sensor/plugin"))
    world = ElementTree.fromstring(files_of(Sdf, robot)["sdf/world.sdf"])
    assert [p for p in world.iter("plugin") if str(p.get("name")).endswith("::Sensors")]
    topics = {(t.ros, t.gazebo): t.ros_type for t in bridged_topics(robot)}
    assert topics["scan", "r1/scan"] == "sensor_msgs/msg/LaserScan"
    assert topics["front/image", "/front/image"] == "sensor_msgs/msg/Image"


@pytest.mark.parametrize(
    ("text", "part"),
    [
        (
            SCAN.format(link="base_link"),
            "<plugin> libgazebo_ros_ray_sensor.so of the sensor `scan`",
        ),
        ('<gazebo><plugin filename="move.so"/></gazebo>', "<plugin> move.so"),
        ('<gazebo reference="base_link"><mu1>1</mu1></gazebo>', "<mu1> of `base_link`"),
        (
            '<gazebo reference="base_link"><sensor name="b" type="contact"/></gazebo>',
            "<sensor> `b` (Gazebo has no sensor `contact` of a link)",
        ),
        (
            '<gazebo reference="base_link"><sensor name="b" type="imu"><pose>1 2</pose></sensor>'
            "</gazebo>",
            "<sensor> `b` (its <pose> is not six numbers in m and rad)",
        ),
        ('<gazebo reference="base_link"><sensor type="imu"/></gazebo>', "(without a name)"),
        ('<gazebo reference="nowhere"><sensor name="b" type="imu"/></gazebo>', "of `nowhere`"),
        ("<other/>", "1 x <other>"),
    ],
)
def test_what_is_not_in_the_model_is_named(text: str, part: str) -> None:
    (diagnostic,) = Sdf().unsupported(with_extensions(text))
    assert part in diagnostic.message
    files_of(Sdf, with_extensions(text))


def test_sensors_of_one_name_are_not_repeated() -> None:
    text = '<gazebo reference="base_link"><sensor name="b" type="imu"/></gazebo>'
    (diagnostic,) = Sdf().unsupported(with_extensions(text, text))
    assert "<sensor> `b` (a second one of this name)" in diagnostic.message
    assert list(Sdf().unsupported(with_extensions(text))) == []
