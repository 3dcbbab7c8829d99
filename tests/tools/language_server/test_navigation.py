"""Definitions, references, renaming and the outline."""

from __future__ import annotations

from pathlib import Path

import pytest
from lsprotocol import types
from pygls.exceptions import JsonRpcException

from tests.tools.language_server.conftest import ROOT, Editor
from tests.tools.language_server.texts import POST, ROBOT, WITH_POST, edited
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.tools.language_server.open_document import uri_of

pytestmark = pytest.mark.asyncio(loop_scope="package")

STEERED_DRIVE = "modules/assembly/steered_drive/module.yaml"
ASSEMBLY = """\
thorvaldc: 1
description: A drive that steers.
category: drive
modules:
  steering: {type: steering/standard}
  drive: {type: drive/standard, mount: steering.flange}
motors: {turning: steering.steering}
ports: {below: steering.flange}
"""
DEFINITIONS = [  # name, text, place, file, text that starts at the definition
    ("robot.yaml", ROBOT, "mount: fr|ame.front_left", "", "frame:\n"),
    (
        "robot.yaml",
        ROBOT,
        "frame.front_l|eft",
        "modules/frame/tube_rectangular/module.yaml",
        "front_left:",
    ),
    ("robot.yaml", ROBOT, "type: assem|bly/steered_drive", STEERED_DRIVE, "thorvaldc: 1"),
    ("robot.yaml", ROBOT, "  f|l: {", STEERED_DRIVE, "thorvaldc: 1"),
    ("robot.yaml", ROBOT, "le|ngth: 1.10", "modules/frame/tube_rectangular/module.yaml", "length:"),
    (
        "module.yaml",
        ASSEMBLY,
        "turning: steering.stee|ring",
        "modules/steering/standard/module.yaml",
        "steering:",
    ),
    (
        "module.yaml",
        ASSEMBLY,
        "below: steering.fla|nge",
        "modules/steering/standard/module.yaml",
        "flange: {kind",
    ),
    ("module.yaml", POST, "${si|ze / 2}", "", "size: {quantity"),
    ("module.yaml", POST, "${ha|lf}", "", 'half: "'),
    (
        "module.yaml",
        POST,
        "default: whe|el/agri_200",
        "modules/wheel/agri_200/module.yaml",
        "thorvaldc: 1",
    ),
]


@pytest.mark.parametrize(("name", "text", "place", "file", "start"), DEFINITIONS)
async def test_definition(
    editor: Editor, name: str, text: str, place: str, file: str, start: str
) -> None:
    marked = editor.mark(name, text.replace(place.replace("|", ""), place, 1))
    answer = await editor.client.text_document_definition_async(
        editor.at(types.DefinitionParams, marked)
    )
    assert isinstance(answer, types.Location)
    assert answer.uri == (uri_of(ROOT / file) if file else marked[0])
    shown = (ROOT / file).read_text(encoding="utf-8") if file else text
    line = answer.range.start.line
    rest = "\n".join(shown.splitlines()[line:])[answer.range.start.character :]
    assert rest.startswith(start)


async def test_definition_of_files(editor: Editor) -> None:
    editor.write("a b/robot.yaml", ROBOT)
    text = "thorvaldc: 1\nname: f\nrobots: {a: {robot: a b/ro|bot.yaml}}\n"
    answer = await editor.client.text_document_definition_async(
        editor.at(types.DefinitionParams, editor.mark("fleet.yaml", text))
    )
    assert isinstance(answer, types.Location)
    assert answer.uri == editor.uri("a b/robot.yaml")


SCENARIO = """\
thorvaldc: 1
scenario: s
robots: {a: {robot: robot.yaml}}
duration: 1 s
faults:
  - {type: radius_error, wheel: fl_wheel, error: 0.1}
  - {type: radius_error, wheel: "fr_wheel", error: 0.1}
"""
CALIBRATION = """\
thorvaldc: 1
robot: cart
wheels: {fl_wheel: {radius: 201 mm}, fl_2_wheel: {radius: 201 mm}}
"""


async def test_rename_changes_all_references(editor: Editor) -> None:
    text = ROBOT.replace(
        "  battery:", "  fl_2: {type: caster/fixed, mount: frame.rear_center}\n  battery:"
    )
    scenario = editor.write("scenario.yaml", SCENARIO)
    calibration = editor.open("calibration.yaml", CALIBRATION)
    place = editor.mark("robot.yaml", text.replace("  fl:", "  f|l:"))
    uris = [place[0], uri_of(scenario), calibration]
    for uri in uris[1:2]:
        editor.open("scenario.yaml", uri=uri)
    prepared = await editor.client.text_document_prepare_rename_async(
        editor.at(types.PrepareRenameParams, place)
    )
    assert isinstance(prepared, types.PrepareRenamePlaceholder)
    assert prepared.placeholder == "fl"
    answer = await editor.client.text_document_rename_async(
        editor.at(types.RenameParams, place, new_name="left")
    )
    assert answer is not None
    changes = dict(answer.changes or {})
    assert set(changes) == set(uris)
    renamed = edited(text, list(changes[place[0]]))
    assert renamed == text.replace("  fl:", "  left:")
    assert edited(SCENARIO, list(changes[uris[1]])) == SCENARIO.replace("fl_wheel", "left_wheel")
    assert edited(CALIBRATION, list(changes[calibration])) == CALIBRATION.replace(
        "{fl_wheel", "{left_wheel"
    )
    for bad_name in ("fr", "Left", "a b", ""):
        with pytest.raises(JsonRpcException, match=r"fr|name"):
            await editor.client.text_document_rename_async(
                editor.at(types.RenameParams, place, new_name=bad_name)
            )


async def test_rename_changes_couplings(editor: Editor) -> None:
    text = (ROOT / "examples/rocker_bogie/robot.yaml").read_text(encoding="utf-8")
    place = editor.mark("robot.yaml", text.replace("  rocker_left:", "  rocker_l|eft:"))
    answer = await editor.client.text_document_rename_async(
        editor.at(types.RenameParams, place, new_name="port")
    )
    assert answer is not None
    renamed = edited(text, list((answer.changes or {})[place[0]]))
    assert renamed == text.replace("rocker_left", "port")
    assert "follows: port.pivot" in renamed


async def test_rename_of_a_carrying_module_changes_the_mounts(editor: Editor) -> None:
    editor.write("my modules/my/post/module.yaml", POST)
    editor.write("robot.lock.yaml", "thorvaldc_lock: 1\naddresses: {}\n")
    place = editor.mark("robot.yaml", WITH_POST.replace("frame.rear_l", "fra|me.rear_l"))
    answer = await editor.client.text_document_rename_async(
        editor.at(types.RenameParams, place, new_name="chassis")
    )
    assert answer is not None
    renamed = edited(WITH_POST, list((answer.changes or {})[place[0]]))
    assert renamed.count("chassis") == 7
    assert "frame." not in renamed
    assert compile_file(editor.write("new.yaml", renamed)).report.errors == []
    references = await editor.client.text_document_references_async(
        types.ReferenceParams(
            types.ReferenceContext(False), types.TextDocumentIdentifier(place[0]), place[1]
        )
    )
    assert len(references or []) == 6


async def test_the_outline_is_the_tree_of_modules(editor: Editor) -> None:
    uri = editor.open("robot.yaml", ROBOT)
    answer = await editor.client.text_document_document_symbol_async(
        types.DocumentSymbolParams(types.TextDocumentIdentifier(uri))
    )
    symbols = {symbol.name: symbol for symbol in answer or ()}
    assert list(symbols) == [
        "thorvaldc",
        "name",
        "description",
        "base_calculator",
        "driver",
        "modules",
    ]
    modules = symbols["modules"]
    assert isinstance(modules, types.DocumentSymbol)
    assert [child.name for child in modules.children or ()] == [
        "frame",
        "fl",
        "fr",
        "rl",
        "rr",
        "battery",
    ]
    details = [child.detail for child in modules.children or ()]
    assert details[1] == "assembly/steered_drive on frame.front_left"


async def test_names_of_a_unit_lead_to_its_design(editor: Editor) -> None:
    design = editor.write("design.yaml", ROBOT)
    head = "thorvaldc: 1\nextends: design.yaml\nname: second\n"
    text = head + "modules:\n  box: {type: sensor/imu, mount: frame.front_center}\n"
    for place, line in (
        ("extends: des|ign.yaml", 0),
        ("mount: fra|me.front", ROBOT[: ROBOT.index("  frame:")].count("\n")),
    ):
        marked = editor.mark("unit.yaml", text.replace(place.replace("|", ""), place, 1))
        answer = await editor.client.text_document_definition_async(
            editor.at(types.DefinitionParams, marked)
        )
        assert isinstance(answer, types.Location)
        assert answer.uri == uri_of(design)
        assert answer.range.start.line == line
    for text in (
        "modules: {frame: {params: {len|gth: 1 m}}}\n",
        "modules.frame.params.len|gth: 1 m\n",
    ):
        shown = await editor.hover("unit.yaml", head + text)
        assert "**length** of `frame/tube_rectangular`" in shown


UNIT = """\
thorvaldc: 1
extends: design.yaml
name: second
modules.fl.params.gear_ratio: 43:1
modules:
  fl: {can: 9}
  box: {type: sensor/imu, mount: {parent: fl, xyz: [0, 0, 0.1]}}
"""
REMOVER = "thorvaldc: 1\nextends: unit.yaml\nname: third\n'modules.fl': null\n"


async def renamed(editor: Editor, place: tuple[str, types.Position], name: str) -> dict[str, str]:
    """The texts after renaming, by the names of the files."""
    answer = await editor.client.text_document_rename_async(
        editor.at(types.RenameParams, place, new_name=name)
    )
    changes = (answer.changes if answer is not None else None) or {}
    return {
        str(path.relative_to(editor.folder)): edited(path.read_text(encoding="utf-8"), list(edits))
        for path, edits in ((Path(uri.removeprefix("file://")), e) for uri, e in changes.items())
    }


async def test_rename_of_a_module_of_a_design_and_its_units(editor: Editor) -> None:
    """From any of the files; a unit of another design keeps its names."""
    of_unit = CALIBRATION.replace("robot: cart", "robot: second")
    others = UNIT.replace("design", "other")
    both = SCENARIO.replace("robot.yaml}", "design.yaml}, b: {robot: unit.yaml}")
    files = {
        "design.yaml": ROBOT,
        "unit.yaml": UNIT,
        "third.yaml": REMOVER,
        "of_unit.yaml": of_unit,
    }
    files |= {"both.yaml": both, "other.yaml": ROBOT, "of_other.yaml": others}
    for name, text in files.items():
        editor.write(name, text)
        editor.open(name)
    expected = {
        "design.yaml": ROBOT.replace("  fl:", "  left:"),
        "unit.yaml": UNIT.replace("fl", "left"),
        "third.yaml": REMOVER.replace("fl", "left"),
        "of_unit.yaml": of_unit.replace("{fl_", "{left_").replace("fl_2", "left_2"),
        "both.yaml": both.replace("fl_", "left_"),
    }
    for name, place in (
        ("design.yaml", "\n  f|l:"),
        ("unit.yaml", "\n  f|l:"),
        ("unit.yaml", "parent: f|l"),
        ("unit.yaml", "modules.f|l.params"),
        ("third.yaml", "modules.f|l"),
    ):
        marked = files[name].replace(place.replace("|", ""), place, 1)
        position = editor.mark(name, marked)
        assert await renamed(editor, position, "left") == expected, place
        for taken in ("fr", "box"):
            with pytest.raises(JsonRpcException, match=rf"already a module `{taken}`"):
                await renamed(editor, position, taken)


async def test_rename_of_a_module_that_a_unit_adds(editor: Editor) -> None:
    editor.write("design.yaml", ROBOT)
    editor.write("unit.yaml", UNIT)
    place = editor.mark("unit.yaml", UNIT.replace("  box", "  bo|x"))
    with pytest.raises(JsonRpcException, match=r"design\.yaml is in no folder of the workspace"):
        await renamed(editor, place, "imu")
    editor.open("design.yaml")
    assert await renamed(editor, place, "imu") == {"unit.yaml": UNIT.replace("box", "imu")}
    parameter = editor.mark("unit.yaml", UNIT.replace("gear_ratio", "gear|_ratio"))
    with pytest.raises(JsonRpcException, match="only modules of a robot or assembly"):
        await renamed(editor, parameter, "ratio")
