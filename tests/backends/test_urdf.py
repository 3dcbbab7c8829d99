from __future__ import annotations

import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tests.backend_files import files_of
from tests.backends.plans import ROBOTS, grafted
from tests.examples import SAMPLED_ROBOTS, example_robot
from tests.slow import one_quick_of
from thorvaldc.backends.urdf import Urdf
from thorvaldc.model import Robot

Written = Callable[[Robot], Path]
PLANNED = {"suspended": ROBOTS["suspended"], "casters": ROBOTS["casters"]} | {
    f"graft_{seed}": grafted(seed) for seed in (0, 7)
}
SAMPLE = [*SAMPLED_ROBOTS, *PLANNED]


def robot_of(name: str) -> Robot:
    return PLANNED[name] if name in PLANNED else example_robot(name)


@pytest.mark.parametrize("name", SAMPLE)
def test_check_urdf_accepts(name: str, written: Written, check_urdf: str) -> None:
    path = written(robot_of(name)) / "urdf" / "robot.urdf"
    process = subprocess.run([check_urdf, str(path)], capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    assert "Successfully Parsed XML" in process.stdout
    assert "error" not in process.stderr.lower(), process.stderr


@pytest.mark.parametrize("name", one_quick_of(4, SAMPLE))
def test_sdformat_accepts(name: str, written: Written, ign: str) -> None:
    path = written(robot_of(name)) / "urdf" / "robot.urdf"
    process = subprocess.run([ign, "sdf", "-k", str(path)], capture_output=True, text=True)
    assert "Valid" in process.stdout, process.stderr
    assert "Error" not in process.stderr, process.stderr


def test_springs_reach_sdformat(written: Written, ign: str) -> None:
    path = written(ROBOTS["suspended"]) / "urdf" / "robot.urdf"
    process = subprocess.run([ign, "sdf", "-p", str(path)], capture_output=True, text=True)
    assert process.stdout.count("<spring_stiffness>20000</spring_stiffness>") == 4


def test_extensions_of_extras_are_in_the_urdf() -> None:
    text = '<gazebo reference="frame_body"><sensor type="ray" name="a&amp;b"/></gazebo>'
    robot = replace(ROBOTS["square"], urdf_extensions=(text,))
    root = ET.fromstring(files_of(Urdf, robot)["urdf/robot.urdf"])
    sensor = root.find("gazebo[@reference='frame_body']/sensor")
    assert sensor is not None
    assert sensor.get("name") == "a&b"


def test_extensions_of_extras_have_the_name_space() -> None:
    text = (
        '<gazebo reference="frame_body"><sensor name="frame_body">'
        "<frameName>frame_body</frameName><topic>frame_body</topic></sensor></gazebo>"
    )
    joint = '<transmission name="t"><joint name="frame_mount"/><joint name="other"/></transmission>'
    robot = replace(ROBOTS["square"], urdf_extensions=(text, joint), namespace="r7")
    root = ET.fromstring(files_of(Urdf, robot)["urdf/robot.urdf"])
    gazebo = root.find("gazebo[@reference='r7/frame_body']")
    assert gazebo is not None
    assert gazebo.find("sensor[@name='frame_body']") is not None
    assert gazebo.findtext("sensor/frameName") == "r7/frame_body"
    assert gazebo.findtext("sensor/topic") == "frame_body"
    names = [e.get("name") for e in root.findall("transmission/joint")]
    assert names == ["r7/frame_mount", "other"]


def test_names_have_the_name_space() -> None:
    robot = replace(grafted(1), namespace="r7")
    root = ET.fromstring(files_of(Urdf, robot)["urdf/robot.urdf"])
    links = {link.get("name") for link in root.findall("link")}
    assert all(str(name).startswith("r7/") for name in links)
    for tag, key in (("parent", "link"), ("child", "link")):
        assert {e.get(key) for e in root.iter(tag)} <= links
    joints = {joint.get("name") for joint in root.findall("joint")}
    assert all(str(name).startswith("r7/") for name in joints)
    assert {m.get("joint") for m in root.iter("mimic")} <= joints
    assert {g.get("reference") for g in root.iter("gazebo")} <= links | joints


def test_repeated_emission_of_random_trees() -> None:
    assert files_of(Urdf, grafted(3)) == files_of(Urdf, grafted(3))
