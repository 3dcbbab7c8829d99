"""The web page of a robot: its data, and its display in a browser."""

from __future__ import annotations

import base64
import html
import json
import math
import re
import shutil
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.browser import OPTIONS
from tests.examples import example_fleet, example_robot
from tests.outside_tools import path_of
from thorvaldc.model import Fleet, JointServo, Pose, Robot, Sphere
from thorvaldc.model.statics.joint_tree import JointTree
from thorvaldc.simulation.pictures.surfaces import surface
from thorvaldc.simulation.pictures.triangles import is_closed, shape_triangles
from thorvaldc.simulation.web_viewer import view_page

NAME = "4wd4ws_wide"
ROOT = Path(__file__).parents[2]
VIEWER = ROOT / "templates" / "view" / "viewer.js"
HEADLESS = (
    "--headless",
    "--hide-scrollbars",
    "--window-size=1000,700",
    "--virtual-time-budget=4000",
)


def data(html: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.S)
    assert found is not None
    value: dict[str, Any] = json.loads(found[1])
    return value


def test_the_page_has_parts_joints_ids_and_surfaces() -> None:
    robot = example_robot(NAME)
    (design,) = data(view_page(robot))["designs"]
    mass = sum(link["mass"] for link in design["links"])
    assert mass == pytest.approx(robot.inertial.mass, abs=1e-3)
    ids = [(n["bus"], n["name"], n["id"], n["id_space"]) for n in design["nodes"]]
    assert ids == [(b.name, n.name, n.id, n.id_space) for b in robot.buses for n in b.nodes]
    assert ids
    assert {j["name"] for j in design["joints"]} == {j.name for j in robot.joints}
    limits = {j.name: (j.lower, j.upper) for j in robot.joints if j.type == "prismatic"}
    assert limits
    for joint in design["joints"]:
        expected = limits.get(joint["name"])
        if expected is not None:
            assert (joint["lower"], joint["upper"]) == pytest.approx(expected, abs=1e-6)
        elif joint["type"] == "continuous":
            assert (joint["lower"], joint["upper"]) == pytest.approx((-math.pi, math.pi), abs=1e-6)
    known = {robot.links[0].name}
    for joint in design["joints"]:  # the page computes the poses in this order
        assert joint["parent"] in known
        known.add(joint["child"])
    assert known == {link.name for link in robot.links}
    shapes = data(view_page(robot))["shapes"]
    visual = next(v for link in design["links"] for v in link["visuals"])
    points = np.frombuffer(base64.b64decode(shapes[visual["shape"]]["points"]), "<f4")
    faces = np.frombuffer(base64.b64decode(shapes[visual["shape"]]["faces"]), "<u4")
    assert faces.max() < len(points) / 3


def test_the_page_loads_nothing_and_is_deterministic() -> None:
    html = view_page(example_robot(NAME))
    viewer = VIEWER.read_text(encoding="utf-8")
    assert html.count(viewer) == 1
    # The bundle of three.js names its licence and the name space of XHTML; the policy of the page
    # lets it load nothing.
    page = html.replace(viewer, "")
    assert not re.findall(r"""(?:src|href)\s*=|url\(|import\s|fetch\(|https?://""", page)
    assert "default-src 'none'" in html
    assert view_page(example_robot(NAME)) == html


@pytest.mark.slow
def test_the_viewer_is_built_from_its_source(tmp_path: Path) -> None:
    npm = path_of("npm")
    folder = tmp_path / "viewer"
    shutil.copytree(ROOT / "viewer", folder, ignore=shutil.ignore_patterns("node_modules"))
    (tmp_path / "templates" / "view").mkdir(parents=True)
    for command in (["ci", "--silent"], ["run", "--silent", "build"]):
        subprocess.run([npm, *command], cwd=folder, check=True, capture_output=True, timeout=240)
    built = tmp_path / "templates" / "view" / "viewer.js"
    assert built.read_bytes() == VIEWER.read_bytes(), "run `npm run build` in viewer/"


def test_a_robot_before_a_change_is_in_the_page() -> None:
    after, before = example_robot(NAME), example_robot("4wd4ws_slim")
    value = data(view_page(after, before))
    assert value["name"] == after.name
    assert value["ghost"] == data(view_page(before))


def test_equal_robots_of_a_fleet_share_their_data() -> None:
    robot = example_robot(NAME)
    one, *_ = example_fleet("fleet_of_four").placements
    placements = tuple(
        replace(one, name=f"r{k}", pose=Pose((3.0 * k, 0.0, 0.0)), robot=robot) for k in range(5)
    )
    value = data(view_page(Fleet("five", "", placements)))
    assert len(value["designs"]) == 1
    assert [r["pose"][0] for r in value["robots"]] == [0.0, 3.0, 6.0, 9.0, 12.0]


def test_text_of_the_robot_is_not_html() -> None:
    nasty = "</script><script>document.title = 'taken'</script><!--"
    html = view_page(replace(example_robot(NAME), description=nasty))
    assert html.count("</script>") == 3
    assert data(html)["description"] == nasty


def test_surfaces_are_closed_and_of_the_right_size() -> None:
    robot = example_robot(NAME)
    shapes = [v.shape for link in robot.links for v in link.visuals]
    for shape in [*{type(s): s for s in shapes}.values(), Sphere(0.4)]:
        vertices, faces = surface(robot, shape)
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        volume = float(np.sum(np.cross(a, b) * c)) / 6.0
        assert volume > 0.0, shape  # the triangles face outwards
        points, [(i, j, k), *others] = shape_triangles(robot, shape)
        assert is_closed(points, [(i, j, k), *others]), shape
        assert not is_closed(points, others), shape  # a hole
        assert not is_closed(points, [(k, j, i), *others]), shape
    ball, _ = surface(robot, Sphere(0.4))
    assert np.linalg.norm(ball, axis=1) == pytest.approx(0.4)


# -- in a browser ------------------------------------------------------------------------------


@pytest.fixture
def browse(tmp_path: Path) -> Callable[..., tuple[str, Path]]:
    """Opens a page in a browser; returns the document and a picture."""
    program = path_of("chromium")

    def run(model: Robot | Fleet, shown: str = "") -> tuple[str, Path]:
        path = tmp_path / "view.html"
        path.write_text(view_page(model), encoding="utf-8")
        process = subprocess.run(
            [
                program,
                *OPTIONS,
                *HEADLESS,
                f"--user-data-dir={tmp_path / 'profile'}",
                "--dump-dom",
                f"--screenshot={tmp_path / 'view.png'}",
                f"{path.as_uri()}#{shown}",
            ],
            capture_output=True,
            timeout=300,
            cwd=tmp_path,
        )
        return process.stdout.decode(), tmp_path / "view.png"

    return run


def texts(document: str) -> str:
    return html.unescape(re.sub(r"<script.*?</script>|<[^>]*>", " ", document, flags=re.S))


def positions(document: str) -> Mapping[str, tuple[float, ...]]:
    """Returns the link positions that the page shows for the selected part."""
    found = re.findall(r"<div>(\S+) at (\S+), (\S+), (\S+) m</div>", document)
    return {name: tuple(map(float, xyz)) for name, *xyz in found}


def test_a_robot_in_the_browser(browse: Callable[..., tuple[str, Path]]) -> None:
    from PIL import Image

    robot = example_robot(NAME)
    wheel = robot.wheels[0]
    steering, travel = wheel.steering_joint, wheel.suspension_joint
    assert steering is not None
    assert travel is not None
    started = robot.wheels[1].steering_joint or ""
    servo = JointServo(started, "position", 0.5, robot.span)  # as of the joint of an arm
    robot = replace(robot, joint_servos=(servo,))
    module = robot.link(wheel.link).module
    document, picture = browse(
        robot, f"part={module}&names&joint:{steering}=0.7&joint:{travel}=0.03"
    )
    assert 'data-ready="yes"' in document
    triangles = sum(len(surface(robot, v.shape)[1]) for link in robot.links for v in link.visuals)
    assert f'data-triangles="{triangles}"' in document
    poses = JointTree(robot.links, robot.joints, {steering: 0.7, travel: 0.03}).pose
    shown_positions = positions(document)
    assert wheel.link in shown_positions
    for name, xyz in shown_positions.items():
        assert xyz == pytest.approx(poses[name].xyz, abs=6e-4)
    assert shown_positions[wheel.link] != pytest.approx(
        JointTree(robot.links, robot.joints).pose[wheel.link].xyz, abs=0.02
    )
    shown = texts(document)
    for word in [robot.name, module, steering, "40.1°", "28.6°", "30.0 mm", "190.6 kg"]:
        assert word in shown
    for bus in robot.buses:
        for node in bus.nodes:
            assert node.name in shown
    assert document.count('type="range"') == sum(j.type != "fixed" for j in robot.joints)
    with Image.open(picture) as seen:
        pixels = np.asarray(seen.convert("RGB"))[:, :600].reshape(-1, 3).astype(int)
    red = np.mean((pixels[:, 0] > 110) & (pixels[:, 1] < 80) & (pixels[:, 2] < 60))
    dark = np.mean(pixels.max(axis=1) < 60)
    orange = np.mean((pixels[:, 0] > 200) & (abs(pixels[:, 1] - 130) < 40) & (pixels[:, 2] < 60))
    assert red > 0.003  # the forks
    assert dark > 0.02  # the tyres
    assert orange > 0.0005  # the selected part


@pytest.mark.slow
def test_a_fleet_in_the_browser(browse: Callable[..., tuple[str, Path]]) -> None:
    fleet = example_fleet("fleet_of_four")
    six = next(p for p in fleet.placements if p.name == "six")
    module = six.robot.link(six.robot.wheels[0].link).module
    document, _ = browse(fleet, f"robot=six&part={module}")
    assert 'data-ready="yes"' in document
    assert re.findall(r'<option value="\d">(\w+)</option>', document) == [
        p.name for p in fleet.placements
    ]
    link = six.robot.wheels[0].link
    expected = (six.pose * JointTree(six.robot.links, six.robot.joints).pose[link]).xyz
    assert positions(document)[link] == pytest.approx(expected, abs=6e-4)
    assert f"{six.robot.inertial.mass:.1f} kg" in texts(document)
