"""Original configuration files become robots: exact positions, the same bus, no value lost."""

from __future__ import annotations

import functools
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from thorvaldc.backends import DEFAULT_TARGETS
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.diagnostics import Diagnostic, Report
from thorvaldc.model import FrameDefinition, Pose, Robot, Signal
from thorvaldc.tools.importer.original_import import ImportResult, import_original

ORIGINALS = Path(__file__).parent / "originals"
GOOD = sorted(path.stem for path in ORIGINALS.glob("*.yaml"))


def convert(path: Path) -> tuple[ImportResult, Report]:
    result = import_original(path)
    return result, result.report


def convert_text(tmp_path: Path, text: str) -> tuple[ImportResult, Report]:
    path = tmp_path / "original.yaml"
    path.write_text(text, encoding="utf-8")
    return convert(path)


def compiled(tmp_path: Path, text: str | None) -> Robot:
    assert text is not None
    path = tmp_path / "robot.yaml"
    path.write_text(text, encoding="utf-8")
    compilation = compile_file(path)
    assert not compilation.report.errors, [str(d) for d in compilation.report.errors]
    assert isinstance(compilation.model, Robot)
    return compilation.model


@functools.cache
def built(name: str) -> tuple[ImportResult, Report, Robot]:
    """Imports and compiles one of the original files."""
    result, report = convert(ORIGINALS / f"{name}.yaml")
    with tempfile.TemporaryDirectory() as folder:
        return result, report, compiled(Path(folder), result.text)


@pytest.fixture
def standard() -> Robot:
    return built("standard")[2]


def poses(robot: Robot) -> dict[str, Pose]:
    """Returns the poses of all link frames in base_link, with all joints at zero."""
    link_poses = {"base_link": Pose()}
    for joint in robot.joints:
        link_poses[joint.child] = link_poses[joint.parent] * joint.pose
    return link_poses


def frame(robot: Robot, cob_id: int) -> FrameDefinition:
    (definition,) = [f for bus in robot.buses for f in bus.frames if f.cob_id == cob_id]
    return definition


def signal(robot: Robot, cob_id: int, name: str) -> Signal:
    (matching_signal,) = [s for s in frame(robot, cob_id).signals if s.name.endswith(name)]
    return matching_signal


def find(report: Report, code: str, *words: str) -> Diagnostic:
    """Returns the first diagnostic with this code whose message contains all words."""
    matches = [d for d in report if d.code.name == code and all(w in d.message for w in words)]
    assert matches, [(d.code.name, d.message) for d in report]
    return matches[0]


# -- all original files ----------------------------------------------------------------------


@pytest.mark.parametrize("name", GOOD)
def test_imported_robot_builds_for_all_targets(name: str) -> None:
    _, report, robot = built(name)
    assert not report.errors, [d.message for d in report.errors]
    assert emit(robot, DEFAULT_TARGETS, Report())


def leaves(value: Any, key: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    if isinstance(value, dict) and value:
        for name, child in value.items():
            yield from leaves(child, (*key, str(name)))
    elif isinstance(value, list) and value:
        for i, child in enumerate(value):
            yield from leaves(child, (*key, str(i)))
    else:
        yield key


@pytest.mark.parametrize("name", GOOD)
def test_no_value_is_dropped_silently(name: str) -> None:
    path = ORIGINALS / f"{name}.yaml"
    result, report, _ = built(name)
    plain = yaml.safe_load(path.read_text(encoding="utf-8"))
    spans = {label.span for d in report for label in d.labels} | {d.span for d in report}
    reported_lines = {span.line for span in spans if span is not None}
    for key in leaves(plain, ()):
        conversion = result.conversions.get(key)
        assert conversion is not None, key
        if conversion.reason not in ("", "unknown"):
            assert conversion.span.line in reported_lines, key
    assert set(result.conversions) == set(leaves(plain, ()))


@pytest.mark.parametrize("name", GOOD)
def test_wheels_are_at_the_positions_of_the_file(name: str) -> None:
    _, _, robot = built(name)
    plain = yaml.safe_load((ORIGINALS / f"{name}.yaml").read_text(encoding="utf-8"))
    while "motor_drives" not in plain:
        plain = next(iter(plain.values()))
    expected = sorted(
        (float(d["x"]), float(d["y"]), float(d.get("r_wheel", 0.2)))
        for d in plain["motor_drives"].values()
    )
    positions = [
        (w.x, w.y, w.radius) for w in robot.wheels if w.driven and not w.module.endswith("mirrored")
    ]
    if name == "one_entry":
        positions = [w for w in positions if w[1] > 0]
    assert sorted(positions) == expected
    assert all(w.contact_height == 0.0 for w in robot.wheels)
    assert all(w.trail == 0.0 and w.lateral_offset == 0.0 for w in robot.wheels if w.driven)


def test_two_imports_write_the_same_text() -> None:
    texts = {convert(ORIGINALS / "standard.yaml")[0].text for _ in range(2)}
    assert len(texts) == 1
    text = texts.pop()
    assert text is not None
    assert str(ORIGINALS) not in text


# -- the standard robot ---------------------------------------------------------------


def test_frame_and_its_parts_have_the_poses_of_the_file(standard: Robot) -> None:
    link_poses = poses(standard)
    assert link_poses["frame_body"].xyz == (0.0, 0.0, 0.65)
    assert link_poses["pipe1_tube"].xyz == (0.425, 0.0, 0.65)
    assert link_poses["pipe1_tube"].rotate((1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0))
    assert link_poses["corner3_clamp"].xyz == (-0.425, 0.445, 0.65)
    assert link_poses["corner1_clamp"].rotate((1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0))
    assert link_poses["corner3_clamp"].rotate((1.0, 0.0, 0.0)) == pytest.approx((0.0, -1.0, 0.0))
    assert link_poses["beam0_beam"].xyz == (0.0, -0.449, 0.65)


def test_the_bus_has_the_ids_of_the_original(standard: Robot) -> None:
    for node in (1, 2, 3, 4):
        for base in (0x200, 0x300, 0x400, 0x500, 0x180, 0x280, 0x380, 0x480, 0x580, 0x600, 0x700):
            assert frame(standard, base + node)
    for base in (0x3C0, 0x3D0, 0x3E0):
        for battery in (1, 3):
            assert frame(standard, base + battery)
    ids = [f.cob_id for bus in standard.buses for f in bus.frames]
    assert len(ids) == len(set(ids))
    assert {n.id for bus in standard.buses for n in bus.nodes if n.protocol == "thorvald_io"} == {
        20,
        21,
    }


def test_the_bus_has_the_scalings_of_the_original(standard: Robot) -> None:
    rpm = math.pi / 30
    # RPDO1: 1000 * motor speed / max motor speed; the value is the wheel speed
    assert signal(standard, 0x201, "speed").scale == pytest.approx(3000 * rpm / 1000 / 42)
    assert signal(standard, 0x204, "speed").scale == pytest.approx(2800 * rpm / 1000 / 36.5)
    # RPDO4: 1000 * steering angle / limit
    assert signal(standard, 0x501, "position").scale == pytest.approx(3.078027759 / 1000)
    assert signal(standard, 0x504, "position").scale == pytest.approx(2.5 / 1000)
    # TPDO1: motor speed in rpm; angle: counts * 2 pi / (4 * pulses per turn * gear ratio)
    assert signal(standard, 0x183, "propulsion_velocity").scale == pytest.approx(rpm / 42)
    for cob_id, ppr in ((0x181, 1024), (0x182, 4096)):
        scale = signal(standard, cob_id, "steering_position").scale
        assert scale == pytest.approx(2 * math.pi / (4 * ppr * 42.8571429))


def test_every_number_of_a_drive_is_converted(standard: Robot) -> None:
    motors = {a.name: a for a in standard.actuators}
    third = next(a for n, a in motors.items() if n.startswith("drive2") and "propulsion" in n)
    assert third.encoder_ppr == 4096
    fourth = next(a for n, a in motors.items() if n.startswith("drive3") and a.role == "propulsion")
    assert fourth.gear_ratio == 36.5
    assert fourth.motor_max_speed == pytest.approx(2800 * math.pi / 30)
    assert fourth.max_acceleration == pytest.approx(1.5 / 0.2)
    steering = next(a for n, a in motors.items() if n.startswith("drive3") and a.role == "steering")
    assert steering.max_velocity == 3.0
    joint = standard.joint(steering.joint)
    assert (joint.lower, joint.upper) == (-2.5, 2.5)


def test_legs_and_motors_are_inside(standard: Robot) -> None:
    link_poses = poses(standard)
    for link in standard.links:
        if link.name.endswith("_drive_leg") and link.inertial is not None:
            _, y, _ = link_poses[link.name].apply(link.inertial.com)
            wheel = next(w for w in standard.wheels if w.module.split(".")[0] in link.name)
            assert abs(y) < abs(wheel.y), link.name


def test_batteries_with_and_without(standard: Robot) -> None:
    """The old form of an id: 345 is battery 1, and -1 is an enclosure without a battery."""
    link_poses = poses(standard)
    nodes = {b.module: b.node for b in standard.batteries}
    assert [module for module, node in nodes.items() if node is None] == ["bat1"]
    assert {n.id for bus in standard.buses for n in bus.nodes if n.id_space == "kc_battery"} == {
        1,
        3,
    }
    assert link_poses["bat0_box"].xyz == (0.0, 0.445, 0.72)
    assert link_poses["bat2_box"].xyz == (0.1, 0.0, 0.75)
    assert link_poses["bat1_box"].rotate((1.0, 0.0, 0.0)) == pytest.approx((-1.0, 0.0, 0.0))


def test_measurement_frames_have_the_poses_of_the_file(standard: Robot) -> None:
    link_poses = poses(standard)
    links = {s.module: link_poses[s.link] for s in standard.sensors}
    expected = Pose.from_xyz_rpy((0.55, 0.1, 0.4), (math.pi, 0.0, math.pi / 4))
    assert links["lidar_front"].xyz == pytest.approx(expected.xyz)
    assert links["lidar_front"].rotate((1.0, 2.0, 3.0)) == pytest.approx(expected.rotate((1, 2, 3)))
    assert links["lidar_back"].xyz == pytest.approx((-0.55, 0.0, 0.4))
    assert links["gnss_antenna_main"].xyz == pytest.approx((-0.4, 0.3, 1.2))
    assert links["gnss_antenna_aux"].xyz == pytest.approx((-0.4, -0.3, 0.66))
    assert links["imu"].xyz == pytest.approx((0.1, 0.02, 0.7))
    assert links["imu"].rotate((1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0))
    assert link_poses["camera1_body"].xyz == pytest.approx((0.6, 0.0, 0.8))


def test_io_board_has_the_initial_relay_states(standard: Robot) -> None:
    boards = {n.id: dict(n.properties) for bus in standard.buses for n in bus.nodes}
    assert boards[20]["relay_0_at_start"] is False
    assert boards[20]["relay_1_at_start"] is True


def test_values_that_cannot_be_converted_are_reported() -> None:
    _, report = convert(ORIGINALS / "standard.yaml")
    find(report, "import-left-out", "leg_mesh", "drive0")
    find(report, "import-left-out", "space", "not published")
    find(report, "import-left-out", "topic_prefix")
    find(report, "import-unknown-key", "`sprayer`", "3 values")
    assert [d.code.name for d in report].count("import-unknown-key") == 1


# -- the other files -----------------------------------------------------------------------


def test_ros_2_file_with_merge_keys() -> None:
    _, report, robot = built("slim")
    assert robot.name == "slim"
    assert robot.namespace == "slim_1"
    assert robot.driver.rate == 50.0
    assert poses(robot)["frame_body"].xyz == (0.0, 0.0, 0.85)
    find(report, "import-left-out", "can_interface_name")


def test_names_with_accents_and_two_radii() -> None:
    _, report, robot = built("six")
    assert robot.name == "thorvald_ost"
    assert [w.radius for w in robot.wheels] == [0.25, 0.2, 0.2, 0.25, 0.2, 0.2]
    assert robot.wheels[0].width == 0.2
    assert poses(robot)["frame_body"].xyz[2] == 0.65
    find(report, "import-assumed", "no pipes")


@pytest.mark.parametrize("name", ["greenhouse", "one_entry"])
def test_two_propulsion_motors_on_one_controller(name: str) -> None:
    _, report, robot = built(name)
    assert robot.calculator.name == "differential"
    (node,) = [n for bus in robot.buses for n in bus.nodes if n.protocol != "thorvald_kc_battery"]
    assert node.id == 1
    left, right = node.channels
    sides = {a.name: a.joint for a in robot.actuators}
    link_poses = poses(robot)
    for channel, sign in ((left, 1.0), (right, -1.0)):
        assert channel.actuator is not None
        child = robot.joint(sides[channel.actuator]).child
        assert link_poses[child].xyz[1] * sign > 0.0
    assert len([w for w in robot.wheels if w.driven]) == 2
    find(report, "import-assumed", "one line")
    if name == "one_entry":
        find(report, "import-assumed", "one position", "y = -0.4 m")
    else:
        find(report, "import-left-out", "str_lim", "no steering")


def test_two_entries_with_two_node_ids_become_two_wheels(tmp_path: Path) -> None:
    text = """
motor_drives:
  a: {node: 1, x: 0, y: 0.4, type: 1}
  b: {node: 2, x: 0, y: -0.4, type: 1}
pipes: {p: {x1: -0.4, y1: 0, x2: 0.4, y2: 0, height: 0.65}}
"""
    result, report = convert_text(tmp_path, text)
    robot = compiled(tmp_path, result.text)
    assert len([w for w in robot.wheels if w.driven]) == 2
    find(report, "import-assumed", "second motor")


def test_single_wheel_gets_casters() -> None:
    _, report, robot = built("one_wheel")
    assert len(robot.wheels) == 3
    find(report, "import-assumed", "passive wheels")


@pytest.mark.parametrize(
    ("positions", "has_casters"),
    [
        (((-0.4, -0.2), (0.0, 0.0), (0.4, 0.2)), True),
        (((-0.4, -0.2), (0.0, 0.0), (0.4, 0.4)), False),
        (((-0.4, 0.1), (0.0, 0.1), (0.4, 0.1)), True),
        (((0.1, -0.4), (0.1, 0.0), (0.4, 0.4)), False),
    ],
)
def test_wheels_on_a_line_get_casters(
    tmp_path: Path, positions: tuple[tuple[float, float], ...], has_casters: bool
) -> None:
    text = "motor_drives:\n"
    for i, (x, y) in enumerate(positions):
        text += f"  d{i}: {{node: {i + 1}, x: {x}, y: {y}, type: 0}}\n"
    text += "pipes: {p: {x1: -1, y1: 0, x2: 1, y2: 0, height: 0.65}}\n"
    result, _ = convert_text(tmp_path, text)
    assert result.text is not None
    assert ("caster" in result.text) is has_casters


@pytest.mark.parametrize(
    ("x", "casters"),
    [
        (0.14, "(0.74, 0) m and (-0.46, 0) m"),  # in the middle of the frame: before and behind
        (0.16, "(-0.64, 0.3) m and (-0.64, -0.3) m"),  # near one end: at the other end
        (-0.16, "(0.64, 0.3) m and (0.64, -0.3) m"),
        (-0.6, "(0.6, 0.3) m and (0.6, -0.3) m"),
    ],
)
def test_positions_of_casters(tmp_path: Path, x: float, casters: str) -> None:
    drives = "".join(
        f"  d{node}: {{node: {node}, x: {x}, y: {y}, type: 0}}\n"
        for node, y in ((1, 0.3), (2, -0.3))
    )
    frame = "pipes: {p: {x1: -1, y1: 0, x2: 1, y2: 0, height: 0.65}}\n"
    _, report = convert_text(tmp_path, f"motor_drives:\n{drives}{frame}")
    find(report, "import-assumed", f"are added at {casters}")


@pytest.mark.parametrize(
    ("calculator", "drive_type", "expected", "assumed"),
    [
        ("pltf_clc_std::PltfClcStd", 0, "general", False),
        ("pltf_clc_2wdiff::PltfClc2WDiff", 0, "general", True),
        ("pltf_clc_2wdiff::PltfClc2WDiff", 1, "general", True),
        ("pltf_clc_mine::Mine", 0, "general", True),
        ("", 0, "general", False),
    ],
)
def test_base_calculators(
    tmp_path: Path, calculator: str, drive_type: int, expected: str, assumed: bool
) -> None:
    text = f'base_calculator: "{calculator}"\nmotor_drives:\n'
    for i, (x, y) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
        text += f"  d{i}: {{node: {i + 1}, x: {x}, y: {y}, type: {drive_type}}}\n"
    text += "pipes: {p: {x1: -1, y1: 0, x2: 1, y2: 0, height: 0.65}}\n"
    result, report = convert_text(tmp_path, text)
    assert compiled(tmp_path, result.text).calculator.name == expected
    assert any(d.code.name == "import-assumed" for d in report) == assumed


# -- invalid files ------------------------------------------------------------------------

DRIVE = "d: {node: 1, x: 0.5, y: 0.5}"


@pytest.mark.parametrize(
    ("text", "code", "line", "words"),
    [
        ("", "yaml-empty", 1, "empty"),
        ("just text", "import-not-original", 1, "motor_drives"),
        ("- a\n- b\n", "import-not-original", 1, "motor_drives"),
        ("name: x\nmodules: {}\n", "import-not-original", 1, "motor_drives"),
        ("a: [1, 2\n", "yaml-syntax", 1, ""),
        ("motor_drives: &a {b: *a}\n", "yaml-recursive-alias", 1, ""),
        ("motor_drives: {}\n", "import-missing", 1, "empty"),
        ("motor_drives: 3\n", "import-value", 1, "mapping"),
        ("motor_drives:\n  d: 3\n", "import-value", 2, "mapping"),
        ("motor_drives:\n  d: {x: 1, y: 1}\n", "import-missing", 2, "`node`"),
        ("motor_drives:\n  d: {node: 1, y: 1}\n", "import-missing", 2, "`x`"),
        ("motor_drives:\n  d: {node: 1, x: left, y: 1}\n", "import-value", 2, "`left`"),
        ("motor_drives:\n  d: {node: 1, x: '0,5', y: 1}\n", "import-value", 2, "`0,5`"),
        ("motor_drives:\n  d: {node: 1, x: .nan, y: 1}\n", "import-value", 2, ".nan"),
        ("motor_drives:\n  d: {node: 0, x: 1, y: 1}\n", "import-value", 2, "from 1 to 127"),
        (
            "motor_drives:\n  d: {node: 1.5, x: 1, y: 1}\n",
            "import-value",
            2,
            "integer from 1 to 127",
        ),
        ("motor_drives:\n  d: {node: 1, x: 1, y: 1, type: 2}\n", "import-value", 2, "from 0 to 1"),
        (
            "motor_drives:\n  d: {node: 1, x: 1, y: 1, r_wheel: -0.2}\n",
            "import-value",
            2,
            "from 0.05",
        ),
        (
            "motor_drives:\n  d: {node: 1, x: 1, y: 1}\n  e: {node: 1, x: 2, y: 1}\n",
            "import-node-duplicate",
            3,
            "node id 1",
        ),
        (
            f"motor_drives:\n  {DRIVE}\nio:\n  i: {{id: 1}}\n",
            "import-node-duplicate",
            4,
            "`motor_drives.d`",
        ),
        (
            f"motor_drives:\n  {DRIVE}\nbeams:\n  b: {{start: d, end: e}}\n",
            "import-reference",
            4,
            "`e`",
        ),
        (
            f"motor_drives:\n  {DRIVE}\nbatteries:\n  b: {{node: 360}}\n",
            "import-value",
            4,
            "battery 16",
        ),
        (
            f"motor_drives:\n  {DRIVE}\nbatteries:\n  b: {{node: 1, with_battery: maybe}}\n",
            "import-value",
            4,
            "true or false",
        ),
        (
            f"motor_drives:\n  {DRIVE}\npipes:\n  p: {{x1: 0, y1: 0, x2: 0, y2: 0}}\n",
            "import-value",
            4,
            "shorter",
        ),
        (
            f"motor_drives:\n  {DRIVE}\npipes:\n  p: {{x1: 0, y1: 0, x2: 1}}\n",
            "import-missing",
            4,
            "`y2`",
        ),
    ],
)
def test_error_in_a_file_is_reported_at_its_line(
    tmp_path: Path, text: str, code: str, line: int, words: str
) -> None:
    result, report = convert_text(tmp_path, text)
    assert result.text is None
    diagnostic = find(report, code, words)
    assert diagnostic.span is not None
    assert diagnostic.span.line == line


def test_one_run_reports_all_errors(tmp_path: Path) -> None:
    text = """base_calculator: "pltf_clc_std::PltfClcStd"
motor_drives:
  a: {x: oops, y: 1}
  b: {node: 200, x: 1, y: 1}
batteries: {c: {z: high}}
"""
    _, report = convert_text(tmp_path, text)
    assert sorted((d.span.line if d.span else 0) for d in report.errors) == [3, 3, 4, 5]
    assert "import-unknown-key" not in [d.code.name for d in report]


@pytest.mark.parametrize(
    ("written", "value"),
    [("'0.5'", 0.5), ("5e-1", 0.5), ("+.5", 0.5), ("deg(30)", math.pi / 6), ("0x1", 1.0)],
)
def test_numbers_have_the_forms_of_ros(tmp_path: Path, written: str, value: float) -> None:
    drives = "\n".join(
        f"  d{i}: {{node: {i + 1}, x: {x}, y: {y}}}"
        for i, (x, y) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1)))
    )
    text = f"motor_drives:\n{drives}\nlidar: {{x: {written}, y: 0, z: 1}}\n"
    result, report = convert_text(tmp_path, text)
    robot = compiled(tmp_path, result.text)
    assert poses(robot)[robot.sensors[0].link].xyz[0] == pytest.approx(value)
    assert not report.errors


def test_duplicate_key_is_reported_and_the_last_counts(tmp_path: Path) -> None:
    result, report = convert_text(
        tmp_path, f"motor_drives:\n  {DRIVE[:-1]}, x: 0.6}}\n  e: {{node: 2, x: -1, y: 0}}\n"
    )
    find(report, "import-duplicate-key", "`x`")
    assert result.text is not None
    assert "[0.6, 0.5, 0]" in result.text


def test_battery_with_contradicting_keys(tmp_path: Path) -> None:
    text = f"motor_drives:\n  {DRIVE}\nbatteries:\n  b: {{node: -1, type: 1}}\n"
    _, report = convert_text(tmp_path, text)
    assert find(report, "import-assumed", "`type`").span is not None


def test_missing_file_and_folder(tmp_path: Path) -> None:
    result = import_original(tmp_path / "none.yaml")
    text, report = result.text, result.report
    assert text is None
    find(report, "file-not-found")
    result = import_original(tmp_path)
    text, report = result.text, result.report
    assert text is None
    find(report, "file-is-a-directory")


def test_after_errors_assumptions_are_not_reported(tmp_path: Path) -> None:
    """There is no robot.yaml to which they apply; an invalid id does not mean "no battery"."""
    file = tmp_path / "original.yaml"
    file.write_text(
        "motor_drives:\n"
        "  d0: {node: 1, x: 0.5, y: 0.4, leg_mesh: 1}\n"
        "batteries:\n"
        "  b0: {node: 500, type: 1}\n"
        "  b1: {id: one, type: 1}\n"
        "pipes:\n"
        "  p: {x1: 0, y1: 0, x2: 0, y2: 0}\n"
        "cameras:\n"
    )
    result = import_original(file)
    text, report = result.text, result.report
    assert text is None
    diagnostics = [(d.span.line, d.code.name) for d in report.sorted() if d.span is not None]
    assert diagnostics == [(4, "import-value"), (5, "import-value"), (7, "import-value")]
