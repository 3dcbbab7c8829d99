"""``thorvaldc diff``, as its users call it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD, Command
from tests.outside_tools import require
from tests.repository import commit_all
from thorvaldc.comparison.robot_comparison import compare_robots
from thorvaldc.compiler.pipeline import load

MODULE = """\
thorvaldc: 1
description: A mast of a given height.
params:
  height: {quantity: length, default: 1 m, description: Height, source: "chosen: a test"}
mount: {kinds: [frame_clamp, sensor_mount], link: body}
links:
  body:
    parts:
      - shape: {box: [50 mm, 50 mm, "${height}"]}
        mass: 2 kg
        source: "chosen: a test"
"""


def written(name: str, *replacements: tuple[str, str]) -> str:
    text = GOOD
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    Path(name).write_text(text, encoding="utf-8")
    return name


def test_equal_robots(thorvaldc: Command) -> None:
    result = thorvaldc("diff", "good.yaml", "good.yaml", "--exit-code")
    assert result == (0, "good: no differences\n", "")


def test_a_parameter_and_its_consequences(thorvaldc: Command) -> None:
    other = written("other.yaml", ("width: 0.9 m", "width: 1 m"))
    result = thorvaldc("diff", "good.yaml", other)
    assert result.status == 0
    lines = [line.split() for line in result.out.splitlines()]
    assert ["~", "frame", "width", "0.9", "m", "->", "1", "m", "(+11", "%)"] in lines
    assert ["~", "fl_wheel,", "rl_wheel", "y", "position", "0.45", "m", "->", "0.5", "m"] in lines
    assert any(line[:2] == ["~", "mass"] for line in lines)
    assert any(line[:3] == ["~", "turning", "limit"] for line in lines)
    assert ["~", "track", "0.9", "m", "->", "1", "m", "(+11", "%)"] in lines
    assert any(line[:3] == ["~", "tip-over", "left"] for line in lines)
    assert "derived values" in result.out
    assert max(map(len, result.out.splitlines())) <= 80
    assert thorvaldc("diff", "good.yaml", other, "--exit-code").status == 1


def test_a_changed_mass_changes_the_rolling_resistance_and_no_range(thorvaldc: Command) -> None:
    """Energy over rolling resistance would be hundreds of km: what no robot drives is no fact."""
    other = written("other.yaml", ("width: 0.9 m", "width: 1 m"))
    out = thorvaldc("diff", "good.yaml", other).out
    assert any(line.split()[:3] == ["~", "rolling", "resistance"] for line in out.splitlines())
    assert "range" not in out
    assert "km" not in out


def test_added_removed_renamed_moved_and_exchanged_modules(thorvaldc: Command) -> None:
    other = written(
        "other.yaml",
        ("  fl:", "  front_left:"),
        ("rr: {type: assembly/steered_drive", "rr: {type: assembly/fixed_drive"),
        (
            ", can: 4}\n",
            "}\n  imu: {type: sensor/imu, mount: {parent: frame, xyz: [0, 0, 0]}}\n",
        ),
    )
    third = written(
        "third.yaml",
        (
            "can: 4}\n",
            "can: 4}\n  imu: {type: sensor/imu, mount: {parent: frame, xyz: [0.1, 0, 0]}}\n",
        ),
    )
    out = thorvaldc("diff", "good.yaml", other).out
    assert "renamed from fl" in out
    assert "assembly/steered_drive -> assembly/fixed_drive" in out
    assert "+ imu" in out
    assert "front_left_wheel" not in out.partition("modules")[0]
    back = thorvaldc("diff", other, third).out
    assert "moved from frame to frame at (0.1, 0, 0) m" in back
    removed = thorvaldc("diff", third, "good.yaml").out
    assert "- imu" in removed
    assert "sensor/imu, on frame at (0.1, 0, 0) m" in removed


def test_a_renamed_module_alone_changes_nothing_else(thorvaldc: Command) -> None:
    other = written("other.yaml", ("  fl:", "  front_left:"))
    out = thorvaldc("diff", "good.yaml", other).out
    assert "renamed from fl" in out
    assert "wheels" not in out
    assert "bus" not in out


def test_node_ids(thorvaldc: Command) -> None:
    other = written("other.yaml", ("front_left, can: 1", "front_left, can: 9"))
    out = thorvaldc("diff", "good.yaml", other).out
    assert "fl_controller id" in out
    assert "1 -> 9" in out


def test_json_contains_every_value(thorvaldc: Command) -> None:
    other = written("other.yaml", ("width: 0.9 m", "width: 1 m"))
    document = json.loads(thorvaldc("diff", "good.yaml", other, "--json").out)
    assert not document["equal"]
    paths = {value["path"] for value in document["values_of_model"]}
    assert "wheels.fl_wheel.y" in paths
    assert document["modules"][0]["parameters"][0]["label"] == "width"


def test_markdown_is_a_table_without_stray_marks(thorvaldc: Command) -> None:
    other = written("other.yaml", ("width: 0.9 m", "width: 1 m"), ("name: good", "name: a_b"))
    out = thorvaldc("diff", "good.yaml", other, "--format", "markdown").out
    assert out.startswith("### good → a\\_b\n")
    rows = [line for line in out.splitlines() if line.startswith("|")]
    assert all(line.count("|") - line.count("\\|") == 4 for line in rows)


def test_a_build_has_no_module_types_but_all_values(thorvaldc: Command) -> None:
    thorvaldc("build", "good.yaml", "-o", "out", "--target", "urdf")
    other = written("other.yaml", ("width: 0.9 m", "width: 1 m"))
    assert "no differences" in thorvaldc("diff", "out", "good.yaml").out
    assert "no differences" in thorvaldc("diff", "out/model.json", "out").out
    assert "y position" in thorvaldc("diff", "out", other).out


@pytest.mark.slow
def test_a_revision_is_read_with_its_own_modules(
    thorvaldc: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A module of the repository has changed and the robot file has not."""
    folder = tmp_path / "parts" / "sensor" / "mast"
    folder.mkdir(parents=True)
    (folder / "module.yaml").write_text(MODULE, encoding="utf-8")
    text = GOOD.replace("name: good", "name: good\nlibrary: [../parts]") + (
        "  mast: {type: sensor/mast, mount: {parent: frame, xyz: [0, 0, 0.1]}}\n"
    )
    robots = tmp_path / "robots"
    robots.mkdir()
    (robots / "robot.yaml").write_text(text, encoding="utf-8")
    commit_all(tmp_path)
    heavier = MODULE.replace("mass: 2 kg", "mass: 5 kg")
    (folder / "module.yaml").write_text(heavier, encoding="utf-8")
    result = thorvaldc("diff", "HEAD:robots/robot.yaml", "robots/robot.yaml")
    assert "mast_body mass" in result.out, result
    assert "2 kg -> 5 kg" in result.out, result
    assert "sensor/mast links.body.parts.0.mass" in result.out
    monkeypatch.chdir(robots)
    assert thorvaldc("diff", "HEAD:robot.yaml", "robot.yaml").out == result.out
    assert thorvaldc("diff", "HEAD:./robot.yaml", "robot.yaml").out == result.out
    monkeypatch.chdir(tmp_path)
    commit_all(tmp_path)
    assert thorvaldc("diff", "main~1:robots/robot.yaml", "HEAD:robots/robot.yaml").out == result.out
    assert (folder / "module.yaml").read_text(encoding="utf-8") == heavier


def test_an_error_in_a_revision_shows_the_line_and_the_name_of_the_revision(
    thorvaldc: Command, tmp_path: Path
) -> None:
    commit_all(tmp_path)
    result = thorvaldc("diff", "HEAD:bad.yaml", "good.yaml")
    assert result.status == 1
    assert result.out == ""
    assert "HEAD:bad.yaml:2:7: error" in result.err
    assert "name: Bad" in result.err
    assert "thorvaldc-revision" not in result.err


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("none.yaml", "good.yaml"), 1, "none.yaml"),
        (("good.yaml", "HEAD:good.yaml"), 1, "git repository"),
        (("good.yaml", "."), 1, "model.json"),
        (("good.yaml", "bad.yaml"), 1, "bad.yaml"),
        (("good.yaml", "fleet.yaml"), 2, "fleet.yaml is a fleet"),
        (("good.yaml",), 2, "B"),
        (("good.yaml", "good.yaml", "--format", "xml"), 2, "xml"),
    ],
)
def test_wrong_inputs(
    thorvaldc: Command, arguments: tuple[str, ...], status: int, message: str
) -> None:
    if "git" in message:
        require("git")
    fleet = "thorvaldc: 1\nname: two\nrobots:\n  a: {robot: good.yaml}\n"
    Path("fleet.yaml").write_text(fleet, encoding="utf-8")
    result = thorvaldc("diff", *arguments)
    assert result.status == status, result
    assert message in result.err
    assert "Traceback" not in result.err


def test_a_revision_without_a_file_hints_at_the_file_in_the_revision(thorvaldc: Command) -> None:
    commit_all(Path())
    for arguments in (("HEAD", "good.yaml"), ("good.yaml", "HEAD")):
        result = thorvaldc("diff", *arguments)
        assert result.status != 0
        assert "hint: write `HEAD:good.yaml` for the file in the revision `HEAD`" in result.err
    assert thorvaldc("diff", "HEAD:good.yaml", "good.yaml").status == 0
    assert "hint: write `" not in thorvaldc("diff", "HAED", "good.yaml").err


def test_a_page_shows_both_robots_and_the_differences(thorvaldc: Command) -> None:
    other = written(
        "other.yaml",
        ("width: 0.9 m", "width: 1 m"),
        ("name: good", 'name: good\ndescription: "<script>alert(1)</script>"'),
    )
    thorvaldc("build", "good.yaml", "-o", "out", "--target", "urdf")
    result = thorvaldc("diff", "out", other, "--html", "both.html")
    assert (result.status, result.err) == (0, "both.html\n")
    page = Path("both.html").read_text(encoding="utf-8")
    assert '"ghost":' in page
    assert '<th scope="row">~ track</th><td>0.9 m -&gt; 1 m (+11 %)</td>' in page
    assert "<script>alert" not in page
    assert thorvaldc("diff", "out", other, "--html", "both.pdf").status == 2


def test_fleets_by_robot(thorvaldc: Command) -> None:
    """A robot of a fleet has other parameters, and another stands somewhere else."""
    written("wide.yaml", ("width: 0.9 m", "width: 1.2 m"))
    fleet = (
        "thorvaldc: 1\nname: two\nrobots:\n"
        "  a: {robot: good.yaml}\n  b: {robot: good.yaml, xyz: [0, 3 m, 0]}\n"
    )
    Path("before.yaml").write_text(fleet, encoding="utf-8")
    changed = fleet.replace("a: {robot: good", "a: {robot: wide").replace("3 m", "4 m")
    Path("after.yaml").write_text(changed + "  c: {robot: good.yaml, xyz: [0, 9, 0]}\n", "utf-8")
    out = thorvaldc("diff", "before.yaml", "after.yaml").out
    assert "c" in [line.split()[1] for line in out.splitlines() if line.startswith("  + ")]
    assert "a: modules" in out
    assert "width 0.9 m -> 1.2 m" in out
    assert "b: " not in out
    assert "(0, 3, 0) m -> (0, 4, 0) m" in out


COPY = (
    ("name: good", "name: second\nnamespace: second\ndriver: {rate: 25 Hz}"),
    ("width: 0.9 m", "width: 1 m, cross_members: [-0.2, 20 cm]"),
    ("length: 1.1 m", "length: 1.1"),
    (", can: 1}\n  fr", ", can: {id: 9}}\n  fr"),
    ("steered_drive, mount: frame.rear_left, can: 3", "fixed_drive, mount: frame.rear_left"),
    (
        "battery: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0.397, 0.07]}, can: 1}",
        "imu: {type: sensor/imu, mount: {parent: frame, xyz: [0, 0, 0.1]}}",
    ),
)
PATHS = """name namespace driver modules.frame.params.width modules.frame.params.cross_members
modules.fl.can.id modules.rl.type modules.rl.can modules.battery modules.imu"""


@pytest.mark.parametrize("is_back", [False, True])
def test_the_paths_of_a_copy_are_those_of_a_unit_and_of_set(
    thorvaldc: Command, is_back: bool
) -> None:
    """A copy of a design becomes a unit: what differs is pasted as it is printed."""
    design, copy = "good.yaml", written("copy.yaml", *COPY)
    if is_back:
        design, copy = copy, design
    document = json.loads(thorvaldc("diff", design, copy, "--json").out)
    values = {change["path"]: change.get("after") for change in document["robot_file"]}
    assert set(values) == set(PATHS.split())
    unit = f"thorvaldc: 1\nextends: {design}\n"
    rows = thorvaldc("diff", design, copy).out.partition("robot file\n")[2].partition("\n\n")[0]
    for row in rows.splitlines():
        mark, path, value = row.split(maxsplit=2)
        unit += f"{path} {'null' if mark == '-' else value.rpartition('-> ')[2]}\n"
    Path("unit.yaml").write_text(unit, encoding="utf-8")
    result = thorvaldc("diff", "unit.yaml", copy)
    assert result[:2] == (0, f"{document['after']}: no differences\n"), result
    changed = load(design, set=values)
    assert not compare_robots(changed, load(copy)).leaves


def test_entries_of_robot_files_in_a_fleet_and_none_of_a_build(thorvaldc: Command) -> None:
    thorvaldc("build", "good.yaml", "-o", "out", "--target", "urdf")
    other = written("other.yaml", ("width: 0.9 m", "width: 1 m"))
    assert "robot file" not in thorvaldc("diff", "out", other).out
    fleet = "thorvaldc: 1\nname: one\nrobots: {a: {robot: good.yaml}}\n"
    for name, text in (("b.yaml", fleet), ("c.yaml", fleet.replace("good.", "other."))):
        Path(name).write_text(text, encoding="utf-8")
    out = thorvaldc("diff", "b.yaml", "c.yaml").out
    assert "a: robot file\n  ~ modules.frame.params.width: 0.9 m -> 1 m\n" in out


@pytest.mark.parametrize(
    ("first", "second", "printed"),
    [
        (
            'computer: {can: {main: {serial: "00E1"}}}',
            'computer: {can: {main: {serial: "0E1"}}}',
            'computer.can.main.serial: "00E1" -> "0E1"',
        ),
        (
            "purchase: {fl.controller: {price: 100 EUR}}",
            "purchase: {fl.controller: {price: 200 EUR}}",
            "purchase: {fl.controller: {price: 100 EUR}} -> {fl.controller: {price: 200 EUR}}",
        ),
    ],
)
def test_an_entry_can_be_pasted(thorvaldc: Command, first: str, second: str, printed: str) -> None:
    """Two serial numbers may be one number; a dot in a key is no part of a path."""
    Path("one.yaml").write_text(f"{GOOD}{first}\n")
    Path("two.yaml").write_text(f"{GOOD}{second}\n".replace("name: good", "name: two"))
    out = thorvaldc("diff", "one.yaml", "two.yaml").out
    assert f"  ~ {printed}\n" in out
    key, _, value = printed.partition(": ")
    unit = f"thorvaldc: 1\nextends: one.yaml\nname: two\n{key}: {value.partition(' -> ')[2]}\n"
    Path("unit.yaml").write_text(unit)
    assert thorvaldc("diff", "unit.yaml", "two.yaml", "--exit-code").status == 0
