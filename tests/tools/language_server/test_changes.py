"""Quick fixes and formatting: the changes that the server proposes."""

from __future__ import annotations

import pytest
from lsprotocol import types

from tests.tools.language_server.conftest import ROOT, Editor
from tests.tools.language_server.texts import ROBOT, edited
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model.model_json import to_json
from thorvaldc.tools.language_server.features import formatted

pytestmark = pytest.mark.asyncio(loop_scope="package")


async def actions(editor: Editor, uri: str, place: types.Range) -> list[types.CodeAction]:
    answer = await editor.client.text_document_code_action_async(
        types.CodeActionParams(
            types.TextDocumentIdentifier(uri), place, types.CodeActionContext([])
        )
    )
    return [action for action in answer or () if isinstance(action, types.CodeAction)]


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("base_calculator:", "base_calculatr:"),
        ("mount: frame.front_left", "mount: frame.front_lefft"),
        (
            "{type: assembly/steered_drive, mount: frame.rear_right, can: 1}",
            "{type:assembly/steered_drive, mount: frame.rear_right, can: 1}",
        ),
        ("frame/tube_rectangular", "frame/tube_rectangle"),
    ],
)
async def test_a_quick_fix_repairs_the_document(editor: Editor, right: str, wrong: str) -> None:
    for line_break in ("\n", "\r\n"):
        text = ROBOT.replace("description: F", "description: 🚜 F").replace("\n", line_break)
        broken = text.replace(right, wrong)
        uri = editor.open("robot.yaml", broken)
        (diagnostic,) = await editor.diagnostics_of(uri)
        proposed = await actions(editor, uri, diagnostic.range)
        edits = [(action.edit.changes or {})[uri] for action in proposed if action.edit]
        assert text in [edited(broken, list(edit)) for edit in edits]
        assert all(action.title and action.diagnostics for action in proposed)
        assert (
            await actions(editor, uri, types.Range(types.Position(0, 0), types.Position(0, 1)))
            == []
        )
        editor.close(uri)


async def test_no_quick_fix_for_a_text_that_has_changed(editor: Editor) -> None:
    broken = ROBOT.replace("base_calculator:", "base_calculatr:")
    uri = editor.open("robot.yaml", broken)
    (diagnostic,) = await editor.diagnostics_of(uri)
    editor.change(uri, "\n" + broken)
    assert await actions(editor, uri, diagnostic.range) == []


UGLY = """\
# a comment   \n\n\n\n
thorvaldc: 1  \t
name: 'cart'     # the name,of it
modules:
  frame: {type: frame/tube_rectangular,params: {length: 1.10 m,width: 0.90 m}}  \n
"""
NEAT = """\
# a comment


thorvaldc: 1
name: 'cart'     # the name,of it
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.10 m, width: 0.90 m}}
"""


async def test_formatting(editor: Editor) -> None:
    for line_break in ("\n", "\r\n"):
        text = UGLY.replace("\n", line_break)
        uri = editor.open("robot.yaml", text)
        answer = await editor.client.text_document_formatting_async(
            types.DocumentFormattingParams(
                types.TextDocumentIdentifier(uri), types.FormattingOptions(2, True)
            )
        )
        assert edited(text, list(answer or ())) == NEAT.replace("\n", line_break)
        editor.close(uri)


@pytest.mark.parametrize(
    "text",
    [
        "a: [1,2\n",
        "a: |\n  text  \n\n\n\n  b,c\n",
        "a: x {b,c}\n",
        'a: "b,c"\n',
        "a: [ 'b,c',d]\n",
        "a: [1:2,3]\n",
        "",
        "\n",
        "a: b\n  c  \n\n\n\n  d\n",
    ],
)
async def test_formatting_leaves_values_as_they_are(text: str) -> None:
    from thorvaldc.tools.language_server.features import _values

    result = formatted(text)
    assert _values(result) == _values(text)
    assert formatted(result) == result


async def test_formatting_of_the_examples_is_idempotent_and_keeps_the_model() -> None:
    paths = [*sorted(ROOT.glob("examples/**/*.yaml")), *sorted(ROOT.glob("modules/*/*/*.yaml"))]
    for path in paths:
        text = path.read_text(encoding="utf-8")
        result = formatted(text)
        assert formatted(result) == result, path
        assert [line.rstrip() for line in result.splitlines()] == text.splitlines(), path
    for name in ("4wd4ws_wide", "car"):
        robot = ROOT / "examples" / name / "robot.yaml"
        assert formatted(robot.read_text(encoding="utf-8")) == robot.read_text(encoding="utf-8")


async def test_formatting_keeps_the_compiled_model(editor: Editor) -> None:
    ugly = ROBOT.replace(", mount", ",mount").replace("\n", "   \n")
    assert formatted(ugly) == ROBOT
    models = [compile_file(editor.write("robot.yaml", text)).model for text in (ROBOT, ugly)]
    assert models[0] is not None
    assert models[1] is not None
    first, second = (to_json(model) for model in models if model is not None)
    assert first.split('"span"')[0] == second.split('"span"')[0]
