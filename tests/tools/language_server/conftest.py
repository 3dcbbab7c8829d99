"""A language server that runs as the editor starts it, and a client of the package pytest-lsp."""

from __future__ import annotations

import asyncio
import itertools
import os
import sys
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest_asyncio
import pytest_lsp
from lsprotocol import types
from pytest_lsp import ClientServerConfig, LanguageClient, client_capabilities

from thorvaldc.tools.language_server.open_document import uri_of

ROOT = Path(__file__).parents[3]
ENVIRONMENT = {
    **{name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"},
    "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
}
CONFIG = ClientServerConfig(
    server_command=[sys.executable, "-m", "thorvaldc", "lsp", "--stdio"], server_env=ENVIRONMENT
)
TIME_LIMIT = 300.0


@pytest_lsp.fixture(config=CONFIG, scope="package")
async def language_client(language_client: LanguageClient) -> AsyncIterator[None]:
    folder = types.WorkspaceFolder(uri_of(ROOT / "examples"), "examples")
    await language_client.initialize_session(
        types.InitializeParams(
            capabilities=client_capabilities("visual_studio_code"),
            root_uri=folder.uri,
            workspace_folders=[folder],
        )
    )
    yield
    await language_client.shutdown_session()


@dataclass
class Editor:
    """The documents that a test has open.

    The mark ``|`` in a text is the position of the cursor; it is not a part of the document.
    """

    client: LanguageClient
    folder: Path
    versions: dict[str, int] = field(default_factory=dict)
    diagnostics: dict[str, list[types.PublishDiagnosticsParams]] = field(default_factory=dict)
    changed: asyncio.Event = field(default_factory=asyncio.Event)
    _numbers: Any = field(default_factory=lambda: itertools.count(1))

    def path(self, name: str | Path) -> Path:
        return self.folder / name

    def uri(self, name: str | Path) -> str:
        return uri_of(self.path(name))

    def write(self, name: str, text: str) -> Path:
        """Writes a file to the disk."""
        path = self.path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text.encode())
        return path

    def open(self, name: str | Path, text: str | None = None, *, uri: str = "") -> str:
        """Opens a document with an unsaved text, or with its text on the disk."""
        uri = uri or self.uri(name)
        if text is None:
            text = self.path(name).read_bytes().decode()
        self.versions[uri] = next(self._numbers)
        self.client.text_document_did_open(
            types.DidOpenTextDocumentParams(
                types.TextDocumentItem(uri, "yaml", self.versions[uri], text)
            )
        )
        return uri

    def change(self, uri: str, text: str) -> None:
        self.versions[uri] = next(self._numbers)
        self.client.text_document_did_change(
            types.DidChangeTextDocumentParams(
                types.VersionedTextDocumentIdentifier(self.versions[uri], uri),
                [types.TextDocumentContentChangeWholeDocument(text)],
            )
        )

    def close(self, uri: str) -> None:
        self.versions.pop(uri)
        self.client.text_document_did_close(
            types.DidCloseTextDocumentParams(types.TextDocumentIdentifier(uri))
        )

    def mark(self, name: str, text: str) -> tuple[str, types.Position]:
        """Opens a document with the cursor at the mark; returns its URI and the position."""
        before, _, after = text.partition("|")
        lines = before.replace("\r\n", "\n").split("\n")
        position = types.Position(len(lines) - 1, len(lines[-1].encode("utf-16-le")) // 2)
        return self.open(name, before + after), position

    def at(self, kind: type[Any], place: tuple[str, types.Position], **others: Any) -> Any:
        """Returns the parameters of a request at a position."""
        uri, position = place
        return kind(types.TextDocumentIdentifier(uri), position, **others)

    async def hover(self, name: str, text: str) -> str:
        place = self.mark(name, text)
        answer = await self.client.text_document_hover_async(self.at(types.HoverParams, place))
        if answer is None:
            return ""
        assert isinstance(answer.contents, types.MarkupContent)
        return answer.contents.value

    async def hover_at(self, uri: str, text: str) -> str:
        """Returns the hover at the mark in the text of a document that is open."""
        lines = text.partition("|")[0].split("\n")
        place = uri, types.Position(len(lines) - 1, len(lines[-1]))
        answer = await self.client.text_document_hover_async(self.at(types.HoverParams, place))
        assert answer is not None
        assert isinstance(answer.contents, types.MarkupContent)
        return answer.contents.value

    async def complete(self, name: str, text: str) -> dict[str, types.CompletionItem]:
        place = self.mark(name, text)
        answer = await self.client.text_document_completion_async(
            self.at(types.CompletionParams, place)
        )
        assert isinstance(answer, types.CompletionList)
        return {item.label: item for item in answer.items}

    async def until(self, condition: Callable[[], Any]) -> Any:
        """Waits until a condition holds after a publication, and returns its value."""

        async def wait() -> Any:
            while not (value := condition()):
                self.changed.clear()
                await self.changed.wait()
            return value

        return await asyncio.wait_for(wait(), TIME_LIMIT)

    async def diagnostics_of(self, uri: str) -> list[types.Diagnostic]:
        """Waits for the diagnostics of the present version of a document."""

        def present() -> list[types.PublishDiagnosticsParams]:
            published = self.diagnostics.get(uri, [])
            return [p for p in published if p.version == self.versions.get(uri)]

        return list((await self.until(present))[-1].diagnostics)

    async def codes_of(self, uri: str) -> list[object]:
        return [diagnostic.code for diagnostic in await self.diagnostics_of(uri)]


@pytest_asyncio.fixture(loop_scope="package")
async def editor(language_client: LanguageClient, tmp_path: Path) -> AsyncIterator[Editor]:
    editor = Editor(language_client, tmp_path)

    def published(params: types.PublishDiagnosticsParams) -> None:
        editor.diagnostics.setdefault(params.uri, []).append(params)
        editor.changed.set()

    language_client.protocol.fm.features[types.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS] = published
    language_client.log_messages.clear()
    yield editor
    for uri in list(editor.versions):
        editor.close(uri)
    errors = [m.message for m in language_client.log_messages]
    assert errors == []
