"""One package for equal robots: the name space is an argument of each launch file."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.backends.ros2.launch_double import Context, LaunchError, run
from tests.backends.ros2.packages import install, launch, variant, write
from tests.backends.ros2.test_launch_files import launch_names
from tests.examples import SAMPLED_ROBOTS
from tests.slow import mostly_slow
from thorvaldc.backends import ros2_package_files, ros2_parts
from thorvaldc.backends.mjcf import ros2_control_files
from thorvaldc.backends.ros2 import in_any_name_space
from thorvaldc.backends.ros2_controllers import CONTROLLER_FILE, controller_parameters
from thorvaldc.backends.ros2_parameters import parameter_file
from thorvaldc.backends.sdf import model_text
from thorvaldc.backends.urdf import urdf_text
from thorvaldc.model import Robot

ARGUMENTS = {
    "base": {
        "base": ["ideal", "bus", "topics"],
        "joint_topics": ["gazebo", "joint_states"],
        "urdf": ["robot.urdf", "robot_mock.urdf", "robot_mujoco.urdf"],
        "enable_odom_tf": ["true", "false"],
    },
    "gazebo": {"controller": ["base_driver", "standard"], "world": ["", "my.sdf"]},
    "ros2_control": {"hardware": ["mock", "mujoco"]},
    "teleop": {"stamped": ["true", "false"]},
    "navigation": {"localization": ["slam", "gnss", "amcl"]},
}
"""Values of the arguments that decide what a launch file starts."""


def combinations(robot: Robot) -> Iterator[tuple[str, dict[str, str]]]:
    """Yields each launch file with each combination of its arguments."""
    for file in launch_names(robot):
        values = ARGUMENTS.get(file, {})
        for chosen in itertools.product(*values.values()):
            yield file, {**dict(zip(values, chosen, strict=True)), **rviz(file)}


def rviz(file: str) -> dict[str, str]:
    return (
        {"rviz": "true", "diagnostics": "true"}
        if file in ("base", "ideal", "mujoco", "robot", "virtual")
        else {}
    )


def description(context: Context, robot: Robot, folder: Path) -> list[str]:
    """Returns a text of everything that is started: names, files, parameters and arguments."""
    share = folder / robot.ros.package

    def text(value: object) -> str:
        """Returns a value with the contents of the files that only this launch has made."""
        plain = str(value).replace(f"{share}/", "SHARE/")
        copy = re.compile(rf"/\S*/{robot.ros.package}_\w{{8}}/\w+\.\w+")
        return copy.sub(lambda match: text(Path(match[0]).read_text(encoding="utf-8")), plain)

    return [
        text(
            (
                *(node.package, node.executable, node.name, node.namespace, node.remappings),
                *(node.parameters, node.sources, node.arguments),
                *(path.read_text(encoding="utf-8") for path in node.files),
            )
        )
        for node in context.started
    ]


def accepted(robot: Robot, folder: Path, file: str, **arguments: str) -> Context | None:
    """Executes a launch file; returns ``None`` if it has no such argument or choice."""
    try:
        return launch(robot, folder, file, **arguments)
    except LaunchError as error:
        if "declares no argument" in str(error) or "choices are" in str(error):
            return None
        raise


@pytest.mark.parametrize("name", mostly_slow(["4wd4ws_wide", "2wd0ws_greenhouse", "car"]))
@pytest.mark.parametrize("default", ["", "a"])
def test_a_package_starts_a_robot_as_a_package_of_its_name_space(
    name: str, default: str, tmp_path: Path
) -> None:
    one = variant(name, namespace=default, odom_tf="ekf")
    other = variant(name, namespace="b", odom_tf="ekf")
    count = 0
    for file, arguments in combinations(one):
        context = accepted(one, tmp_path / "one", file, **arguments, namespace="b")
        expected = accepted(other, tmp_path / "other", file, **arguments)
        if context is None or expected is None:
            assert context is expected
            continue
        started = description(context, one, tmp_path / "one")
        assert started == description(expected, other, tmp_path / "other"), (file, arguments)
        assert not any("$(" in text for text in started), (file, arguments)
        count += 1
    assert count > 15


@pytest.mark.parametrize("name", mostly_slow(["2wd0ws_greenhouse", "4wd4ws_wide"]))
def test_two_robots_of_a_package_differ_by_their_name_spaces_only(
    name: str, tmp_path: Path
) -> None:
    robot = variant(name, namespace="a")
    for file, arguments in combinations(robot):
        spaces = ("first_robot", "second_robot")
        runs = [accepted(robot, tmp_path, file, **arguments, namespace=space) for space in spaces]
        if (one := runs[0]) is None or (other := runs[1]) is None:
            continue
        texts = [description(context, robot, tmp_path) for context in (one, other)]
        assert [text.replace("first_robot", "second_robot") for text in texts[0]] == texts[1]
        for node in one.started:
            assert node.namespace == "first_robot"
            if node.executable in ("base_driver", "joint_guard"):
                assert node.parameters["use_node_namespace"] is True


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
@pytest.mark.parametrize("namespace", ["", "r1", "farm/r1"])
def test_the_files_are_those_of_a_robot_in_the_name_space(
    name: str, namespace: str, tmp_path: Path
) -> None:
    """Descriptions, models and parameters are those of the model in this name space."""
    robot = variant(name, namespace="other")
    expected = variant(name, namespace=namespace)
    package, share = robot.ros.package, str(tmp_path / robot.ros.package)
    meshes = f"package://{package}/meshes"
    nodes = {
        file: {
            n.name: n for n in launch(robot, tmp_path, file, **more, namespace=namespace).started
        }
        for file, more in (
            ("ideal", {"rviz": "true"}),
            ("gazebo", {}),
            ("ros2_control", {"hardware": "mujoco"}),
        )
    }
    ideal, control = nodes["ideal"], nodes["ros2_control"]
    urdf = ideal["robot_state_publisher"].parameters["robot_description"]
    assert urdf == urdf_text(expected, meshes)
    config = Path(ideal["rviz2"].arguments[1]).read_text(encoding="utf-8")
    assert config == ros2_package_files.rviz_text(expected, ros2_parts.parts_of(expected))
    create = nodes["gazebo"]["create"].arguments
    title = re.compile('<model name="[^"]*"')
    sdf = model_text(expected, f"model://{package}/meshes")
    assert title.sub("", create[3]) == title.sub("", sdf)
    assert create[1] == namespace.replace("/", "_") or robot.name
    bridge = Path(nodes["gazebo"]["gz_bridge"].parameters["config_file"])
    for topic in ros2_parts.bridged_topics(expected):
        assert f'gz_topic_name: "{topic.gazebo}"' in bridge.read_text(encoding="utf-8")
    urdf = control["robot_state_publisher"].parameters["robot_description"]
    (scene,) = re.findall(r'name="mujoco_model">([^<]*)<', urdf)
    assert urdf == urdf_text(expected, meshes, "mujoco", share).replace(
        f"{share}/mjcf/scene.xml", scene
    )
    for path, data in ros2_control_files(expected).items():
        copy = Path(scene).with_name(Path(path).name).read_text(encoding="utf-8")
        assert copy.replace(f"{share}/meshes", "../meshes") == data.decode()
    (parameters,) = control["controller_manager"].files
    written = controller_parameters(expected)[CONTROLLER_FILE]
    assert parameters.read_text(encoding="utf-8") == parameter_file(written)


@pytest.mark.parametrize(
    ("namespace", "full"), [("r2", "r2"), ("/r2/", "r2"), ("/farm/r2", "farm/r2"), ("/", "")]
)
def test_slashes_around_a_name_space_do_not_matter(
    namespace: str, full: str, tmp_path: Path
) -> None:
    robot = variant("car", namespace="r1")
    for node in launch(robot, tmp_path, "ideal", namespace=namespace).started:
        assert node.namespace == full
        prefix = f"{full}/" if full else ""
        if text := node.parameters.get("robot_description"):
            assert f'<link name="{prefix}base_link"' in text


@pytest.mark.parametrize("namespace", ["a b", "1st", "r-1", "r1/$(x)"])
def test_a_name_space_that_ros_does_not_allow_is_an_error(namespace: str, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="expected names of letters, digits and underscores"):
        launch(variant("car"), tmp_path, "ideal", namespace=namespace)


FARM = """\
from launch import LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import PushRosNamespace
def include(file, **arguments):
    source = PythonLaunchDescriptionSource(file)
    return IncludeLaunchDescription(source, launch_arguments=arguments.items())
def generate_launch_description():
    first, other = {files}
    return LaunchDescription([
        include(first),
        include(other),
        GroupAction([PushRosNamespace("farm"), include(first), include(first, namespace="/r6")]),
    ])
"""


def test_a_launch_file_of_a_user_starts_several_robots(tmp_path: Path) -> None:
    """The name space of one robot is not that of the next; a group is a part of it."""
    first, other = variant("car", namespace="r1"), variant("4wd4ws_slim", namespace="r2")
    shares = install(first, tmp_path) | install(other, tmp_path)
    files = tuple(str(share / "launch" / "ideal.launch.py") for share in shares.values())
    text = FARM.replace("{files}", repr(files)).encode()
    path = write(tmp_path, {"farm.launch.py": text}) / "farm.launch.py"
    nodes = [node for node in run(path, shares).started if node.name == "robot_state_publisher"]
    spaces = ["r1", "r2", "farm/r1", "r6"]
    assert [node.namespace for node in nodes] == spaces
    for node, space in zip(nodes, spaces, strict=True):
        assert f'<link name="{space}/base_link"' in node.parameters["robot_description"]
        assert f"/{space}/robot_state_publisher:" in node.files[0].read_text(encoding="utf-8")


def test_launch_evaluates_nothing_that_a_robot_file_contains() -> None:
    """The grammar of launch: a backslash before `$` and before a backslash is an escape."""
    text = r'''note: "$(command reboot) \n"'''
    files = in_any_name_space(variant("4wd4ws_wide"), {"config/a.yaml": text})
    assert files == {"config/a.yaml": rb'''note: "\$(command reboot) \\n"'''}
