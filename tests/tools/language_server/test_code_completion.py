"""The proposals at the cursor."""

from __future__ import annotations

import re

import pytest
from lsprotocol import types

from tests.tools.language_server.conftest import Editor
from tests.tools.language_server.texts import POST, ROBOT, WITH_POST, edited

pytestmark = pytest.mark.asyncio(loop_scope="package")

LINE = "  new: {type: assembly/steered_drive, mount: frame.rear_center, can: 7}\n"
UNSET = re.sub("driver:.*\n", "", ROBOT)
"""The robot without its section `driver`."""
UNFINISHED = "thorvaldc: 1\nmodules:\n  new: {type: assembly/steered_drive, mount: |\n"
FRAME = "{type: frame/tube_rectangular, params: {length: 1 m, width: 0.8 m}}"
CASES = [  # file, text, proposals at the start, words that are not proposed
    ("robot.yaml", ROBOT + "|", ["defaults", "design", "extras"], ["modules", "name"]),
    ("robot.yaml", ROBOT + "ext|", ["extras"], ["modules"]),
    ("robot.yaml", UNSET + "driver:\n  ra|", ["rate"], ["modules"]),
    ("robot.yaml", UNSET + "driver: {arming: |", ["required", "automatic"], []),
    ("robot.yaml", ROBOT + "ros:\n  distro: |\n", ["jazzy", "kilted"], ["name"]),
    ("robot.yaml", ROBOT + "  new: {type: |", ["assembly/steered_drive", "wheel/agri_200"], []),
    ("robot.yaml", ROBOT + "  new:\n    type: cas|\n", ["caster/fixed", "caster/swivel"], []),
    (
        "robot.yaml",
        ROBOT + LINE.replace("frame.rear_center", "|"),
        ["frame.rear_center"],
        ["fl.flange"],
    ),
    ("robot.yaml", f"{UNFINISHED}  frame: {FRAME}\n", ["frame.rear_left"], []),
    ("robot.yaml", ROBOT + LINE.replace("7", "|"), ["5", "6", "auto"], ["1", "2", "3", "4"]),
    ("robot.yaml", ROBOT + LINE.replace("can: 7", "params: {|}"), ["gear_ratio"], ["mount"]),
    ("robot.yaml", ROBOT + LINE.replace("can: 7", "params: {leg_side: |}"), ["left", "right"], []),
    (
        "robot.yaml",
        ROBOT + LINE.replace("can: 7", "params: {wheel: |}"),
        ["wheel/agri_200", "none"],
        ["drive/standard"],
    ),
    (
        "robot.yaml",
        ROBOT + LINE.replace("can: 7", "params: {height: 700 |}"),
        ["m", "mm", "cm"],
        ["kg", "s"],
    ),
    ("robot.yaml", UNSET + "driver: {rate: 50|", ["Hz"], ["m"]),
    ("robot.yaml", ROBOT + "defaults:\n  |", ["drive", "battery", "frame"], ["rate"]),
    ("robot.yaml", ROBOT + "defaults: {drive: {|", ["gear_ratio"], ["rate"]),
    ("robot.yaml", "thorvaldc: 1\nbase_calculator: |\n", ["general", "differential"], []),
    ("robot.yaml", "|", ["robot 4wd4ws", "thorvaldc", "modules"], []),
    ("module.yaml", POST.replace("${half}", "${|}"), ["size", "half"], ["m"]),
    ("module.yaml", POST + "|", ["wheel", "sensor"], ["links"]),
    ("fleet.yaml", "thorvaldc: 1\nrobots: {a: {|", ["robot", "xyz", "grid"], []),
    ("scenario.yaml", "thorvaldc: 1\nscenario: s\nworld: {ground: {type: |", ["slope"], []),
    ("faults.yaml", "thorvaldc: 1\nfaults:\n  - {fault: |", ["power_cut", "noise"], []),
    ("faults.yaml", "thorvaldc: 1\nfaults:\n  - fault: noise\n    |", ["at", "node"], ["fault"]),
    ("calibration.yaml", "thorvaldc: 1\nrobot: a\nwheels:\n  fl_wheel: {|", ["radius"], []),
]


@pytest.mark.parametrize(("name", "text", "expected", "absent"), CASES)
async def test_completion(
    editor: Editor, name: str, text: str, expected: list[str], absent: list[str]
) -> None:
    items = await editor.complete(name, text)
    assert set(expected) <= set(items), (expected, list(items))
    assert not set(absent) & set(items), list(items)


async def test_a_proposal_replaces_the_word_at_the_cursor(editor: Editor) -> None:
    for before, label, after in (
        (
            "  new: {type: assembly/steered_drive, mount: fra|}\n",
            "frame.rear_center",
            "  new: {type: assembly/steered_drive, mount: frame.rear_center}\n",
        ),
        ("driver: {rate: 50|}\n", "Hz", "driver: {rate: 50 Hz}\n"),
        ("driver: {rate: 50 |}\n", "Hz", "driver: {rate: 50 Hz}\n"),
        ("driver: {rate: 50 H|}\n", "Hz", "driver: {rate: 50 Hz}\n"),
        ("  é🚜: {ty|}\n", "type", "  é🚜: {type: }\n"),
        ("driver:\n  tw|\n", "twist_sources", "driver:\n  twist_sources:\n"),
    ):
        items = await editor.complete("robot.yaml", UNSET + before)
        edit = items[label].text_edit
        assert isinstance(edit, types.TextEdit)
        assert edited(UNSET + before.replace("|", ""), [edit]) == UNSET + after


async def test_free_ports_that_fit_come_first(editor: Editor) -> None:
    items = await editor.complete("robot.yaml", ROBOT + LINE.replace("frame.rear_center", "|"))
    references = sorted(items, key=lambda label: items[label].sort_text or "")
    taken = [("taken by" in (items[label].detail or "")) for label in references]
    assert taken == sorted(taken)
    assert {"frame.rear_center", "frame.center"} <= set(references)
    assert "fl.drive" not in items


async def test_names_of_open_robots_in_other_documents(editor: Editor) -> None:
    robot = editor.open("robot.yaml", ROBOT)
    await editor.diagnostics_of(robot)
    items = await editor.complete("faults.yaml", "thorvaldc: 1\nfaults: [{fault: mute, node: |")
    assert {"fl_controller", "battery"} <= set(items)
    text = "thorvaldc: 1\nscenario: s\nrobots: {a: {robot: robot.yaml}}\nfaults: [{wheel: |"
    assert "fl_wheel" in await editor.complete("scenario.yaml", text)


async def test_types_of_own_library_folders(editor: Editor) -> None:
    editor.write("my modules/my/post/module.yaml", POST)
    items = await editor.complete("robot.yaml", WITH_POST + "  b: {type: |")
    assert items["my/post"].detail == "A post."


async def test_required_keys_come_first(editor: Editor) -> None:
    items = await editor.complete("robot.yaml", "thorvaldc: 1\nbase_calculator: general\n|")
    keys = sorted(items, key=lambda label: items[label].sort_text or "")
    required = [key for key in keys if items[key].detail == "required"]
    assert required == ["name", "modules"]
    assert keys[:2] == required
