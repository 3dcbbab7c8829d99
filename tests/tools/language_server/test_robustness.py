"""Broken, half-typed, huge and hostile documents: the server stays alive and answers."""

from __future__ import annotations

import asyncio
import random
import threading
import time
from pathlib import Path

import pytest
from lsprotocol import types

from tests.tools.language_server.conftest import Editor
from tests.tools.language_server.texts import POST, ROBOT
from thorvaldc.compiler.scaffolding import robot_text
from thorvaldc.tools.language_server.open_document import OpenDocument, uri_of
from thorvaldc.tools.language_server.server import DiagnosticPublisher

pytestmark = pytest.mark.asyncio(loop_scope="package")

SMALL = robot_text("cart", "1wd1ws")
HOSTILE = {
    "nul": "thorvaldc: 1\0\nname: a\n",
    "half a pair": "thorvaldc: 1\nname: \ud800\n",
    "separators": "thorvaldc: 1\nname: a\u2028b\x85c\x0cd\nmodules: {a: 1}\n",
    "deep": "thorvaldc: 1\nmodules: " + "[" * 20_000,
    "billion laughs": "thorvaldc: 1\na: &a [1,1,1,1,1,1,1,1,1]\n"
    + "".join(
        f"{b}: &{b} [{','.join(['*' + a] * 9)}]\n" for a, b in zip("abcdef", "bcdefg", strict=True)
    ),
    "huge": "thorvaldc: 1\nname: a\nmodules:\n"
    + "".join(f"  m{i}: {{type: drive/standard, mount: m{i - 1}.hub}}\n" for i in range(300)),
    "larger than the limit": "thorvaldc: 1\n# " + "x" * 1_200_000,
    "one long line": "thorvaldc: 1\nmodules: {" + "a: {type: b}, " * 2_000,
    "recursive": "thorvaldc: 1\nmodules: &m {a: *m}\n",
    "list": "- thorvaldc: 1\n- a\n",
    "keys": "thorvaldc: 1\n? [a, b]\n: c\n1: 2\nnull: 3\n",
    "paths": "thorvaldc: 1\nname: a\nlibrary: [/dev, ../../.., '', ~, 'a\\0b']\n"
    "calibration: /dev/zero\nextras: [{xacro: /proc/self/mem}]\n"
    "modules: {a: {type: ../../x}, b: {type: /etc/passwd, mount: a.b.c.d}}\n",
    "expressions": POST.replace("${size / 2}", "${" + "(" * 5000),
    "self": POST.replace("wheel/agri_200", "my/post"),
}


async def answers(editor: Editor, uri: str, position: types.Position) -> None:
    """Asks for everything at a position; no answer may be an error."""
    document = types.TextDocumentIdentifier(uri)
    client = editor.client
    await client.text_document_hover_async(types.HoverParams(document, position))
    await client.text_document_completion_async(types.CompletionParams(document, position))
    await client.text_document_definition_async(types.DefinitionParams(document, position))
    await client.text_document_document_symbol_async(types.DocumentSymbolParams(document))
    await client.text_document_references_async(
        types.ReferenceParams(types.ReferenceContext(True), document, position)
    )
    await client.text_document_code_action_async(
        types.CodeActionParams(
            document, types.Range(position, position), types.CodeActionContext([])
        )
    )


@pytest.mark.parametrize("name", HOSTILE)
async def test_hostile_documents(editor: Editor, name: str) -> None:
    file = "module.yaml" if name in ("expressions", "self") else "robot.yaml"
    uri = editor.open(file, HOSTILE[name])
    await answers(editor, uri, types.Position(2, 5))
    await editor.diagnostics_of(uri)
    await answers(editor, uri, types.Position(10**6, 10**6))
    editor.change(uri, ROBOT if file == "robot.yaml" else POST)
    assert await editor.codes_of(uri) == []


@pytest.mark.slow
async def test_every_prefix_of_a_robot(editor: Editor) -> None:
    """As typed, character by character: each prefix gets answers, and the last one diagnostics."""
    uri = editor.open("robot.yaml", "")
    for end in range(len(SMALL) + 1):
        text = SMALL[:end]
        editor.change(uri, text)
        lines = text.split("\n")
        position = types.Position(len(lines) - 1, len(lines[-1]))
        document = types.TextDocumentIdentifier(uri)
        await editor.client.text_document_completion_async(
            types.CompletionParams(document, position)
        )
        if end % 16 == 0:
            await answers(editor, uri, position)
    assert await editor.codes_of(uri) == []


async def test_random_mistakes(editor: Editor) -> None:
    chance = random.Random(3)
    uri = editor.open("robot.yaml", ROBOT)
    for _ in range(20):
        start = chance.randrange(len(ROBOT))
        end = min(len(ROBOT), start + chance.randrange(12))
        piece = chance.choice(
            ["", "{", "}", ":", "\n", "  - ", '"', "&a ", "*a", "${", "é🚜", "\t"]
        )
        text = ROBOT[:start] + piece + ROBOT[end:]
        editor.change(uri, text)
        line = text[:start].count("\n")
        await answers(editor, uri, types.Position(line, chance.randrange(60)))
    editor.change(uri, ROBOT)
    assert await editor.codes_of(uri) == []


async def test_requests_for_unknown_documents(editor: Editor) -> None:
    await answers(editor, editor.uri("nothing.yaml"), types.Position(0, 0))
    await answers(editor, "nonsense", types.Position(0, 0))
    await answers(editor, "file://[", types.Position(0, 0))


async def test_only_the_last_of_many_changes_is_published(editor: Editor) -> None:
    uri = editor.open("robot.yaml", ROBOT)
    assert await editor.codes_of(uri) == []
    before = len(editor.diagnostics[uri])
    for number in range(50):
        editor.change(uri, ROBOT.replace("can: 3", "can: 2" if number % 2 else "can: 1"))
    assert await editor.codes_of(uri) == ["TV501"]
    assert len(editor.diagnostics[uri]) - before < 10


async def test_a_closed_publisher_leaves_no_thread(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    document = OpenDocument(uri_of(path), path, str(path), 1, SMALL)
    published: list[types.PublishDiagnosticsParams] = []
    before = set(threading.enumerate())
    publisher = DiagnosticPublisher({document.uri: document}, published.append, pytest.fail)
    publisher.document_changed(document)
    end = time.monotonic() + 300.0
    while not published and time.monotonic() < end:
        await asyncio.sleep(0.01)
    assert published
    threads = set(threading.enumerate()) - before
    assert threads
    publisher.close()
    while any(thread.is_alive() for thread in threads) and time.monotonic() < end:
        await asyncio.sleep(0.01)
    assert not [thread for thread in threads if thread.is_alive()]
