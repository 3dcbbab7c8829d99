"""Diagnostics as one types, from the unsaved texts of the open documents."""

from __future__ import annotations

import pytest
from lsprotocol import types

from tests.example_packages import PACKAGES
from tests.tools.language_server.conftest import ROOT, Editor
from tests.tools.language_server.texts import POST, ROBOT, WITH_POST
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.tools.language_server.open_document import uri_of

pytestmark = pytest.mark.asyncio(loop_scope="package")

TWICE = ROBOT.replace("can: 2", "can: 3")
FLEET = "thorvaldc: 1\nname: two\nrobots:\n  a: {robot: robot.yaml, xyz: [0, 0, 0]}\n"
EXAMPLES = [
    ROOT / "examples/fleet_of_four/fleet.yaml",
    *(ROOT / "examples" / name / "robot.yaml" for name in PACKAGES),
    *sorted(ROOT.glob("examples/scenarios/*.yaml")),
    *sorted(ROOT.glob("examples/studies/*/*.yaml")),
    *sorted(ROOT.glob("examples/bus_faults/*.yaml")),
    *sorted(ROOT.glob("examples/calibration/*.yaml")),
    *sorted(ROOT.glob("examples/*/modules/*/*/module.yaml")),
    *sorted(ROOT.glob("modules/[ad]*/*/module.yaml")),
]


def text_at(text: str, place: types.Range) -> str:
    """Returns the text in a range, whose columns are UTF-16 code units."""
    line = text.splitlines()[place.start.line].encode("utf-16-le")
    assert place.start.line == place.end.line
    return line[2 * place.start.character : 2 * place.end.character].decode("utf-16-le")


async def test_diagnostics_follow_the_unsaved_text(editor: Editor) -> None:
    uri = editor.open("robot.yaml", TWICE)
    (diagnostic,) = await editor.diagnostics_of(uri)
    assert (diagnostic.code, diagnostic.source) == ("TV501", "thorvaldc")
    assert diagnostic.severity == types.DiagnosticSeverity.Error
    assert "hint: " in diagnostic.message
    assert (diagnostic.range.start.line, text_at(TWICE, diagnostic.range)) == (10, "3")
    (related,) = diagnostic.related_information or ()
    assert (related.location.uri, related.location.range.start.line) == (uri, 9)
    editor.change(uri, ROBOT)
    assert await editor.codes_of(uri) == []


async def test_columns_are_utf_16_code_units(editor: Editor) -> None:
    text = ROBOT.replace(
        "{type: assembly/steered_drive, mount: frame.front_left, can: 3}",
        '{"type": "assembly/steered_drive", mount: frame.front_left, "🚜é": 3}',
    )
    for line_break in ("\n", "\r\n"):
        uri = editor.open("robot.yaml", text.replace("\n", line_break))
        found = {d.code: text_at(text, d.range) for d in await editor.diagnostics_of(uri)}
        assert found["TV201"] == '"🚜é"'
        editor.close(uri)


async def test_a_module_that_is_edited_changes_the_open_robot(editor: Editor) -> None:
    module = editor.write("my modules/my/post/module.yaml", POST)
    robot = editor.open("robot.yaml", WITH_POST)
    assert await editor.codes_of(robot) == []
    module_uri = editor.open(module)
    assert await editor.codes_of(module_uri) == []
    changes = len(editor.diagnostics[robot])
    editor.change(module_uri, POST.replace("quantity: length", "quantity: mass"))
    assert set(await editor.codes_of(module_uri)) == {"TV211"}
    await editor.until(lambda: len(editor.diagnostics[robot]) > changes)
    editor.change(robot, WITH_POST.replace("}\n", "}\n", 1) + "# changed\n")
    await editor.diagnostics_of(robot)
    related = [d.related_information for d in editor.diagnostics[module_uri][-1].diagnostics]
    assert any("`post` uses it" in item.message for items in related for item in items or ())


async def test_diagnostics_in_files_that_are_not_open(editor: Editor) -> None:
    module = editor.write("my modules/my/post/module.yaml", POST.replace("10 cm", "0.1 kg"))
    robot = editor.open("robot.yaml", WITH_POST)
    await editor.diagnostics_of(robot)
    (published,) = editor.diagnostics[uri_of(module)]
    assert {d.code for d in published.diagnostics} == {"TV211"}
    editor.close(robot)
    await editor.until(lambda: not editor.diagnostics[uri_of(module)][-1].diagnostics)


async def test_fleets_read_the_unsaved_robot(editor: Editor) -> None:
    editor.write("robot.yaml", ROBOT)
    fleet = editor.open("fleet.yaml", FLEET)
    assert await editor.codes_of(fleet) == []
    robot = editor.open("robot.yaml")
    editor.change(robot, TWICE)
    assert await editor.codes_of(robot) == ["TV501"]
    editor.close(robot)
    await editor.until(lambda: not editor.diagnostics[robot][-1].diagnostics)


async def test_unusual_uris(editor: Editor) -> None:
    """An editor may escape more or fewer characters than this server would."""
    for name in ("a b/50%/robot.yaml", "ü#?/robot.yaml", "c:d/robot.yaml"):
        editor.write(name, ROBOT)
        uri = editor.uri(name).replace("a", "%61")
        editor.open(name, TWICE, uri=uri)
        assert await editor.codes_of(uri) == ["TV501"]
    uri = editor.open("", TWICE, uri="untitled:Untitled-1")
    assert await editor.codes_of(uri) == ["TV501"]


async def test_foreign_documents_have_no_diagnostics(editor: Editor) -> None:
    for name, text in (("compose.yaml", "services: {a: {image: b}}\n"), ("x.yaml", "a: [\n")):
        uri = editor.open(name, text)
        assert await editor.codes_of(uri) == []


@pytest.mark.slow
async def test_examples_of_all_kinds_have_the_diagnostics_of_check(editor: Editor) -> None:
    uris = {path: editor.open(path, uri=uri_of(path)) for path in EXAMPLES}
    for path, uri in uris.items():
        expected = []
        if path.name in ("robot.yaml", "fleet.yaml") or "scenarios" in path.parts:
            expected = [d.code.number for d in compile_file(path).report]
        assert await editor.codes_of(uri) == expected, path
