"""Quick fixes: the changes that the server proposes."""

from __future__ import annotations

import pytest
from lsprotocol import types

from tests.tools.language_server.conftest import Editor
from tests.tools.language_server.texts import ROBOT, edited

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
