"""The protocol of the language server: requests and notifications of the editor."""

from __future__ import annotations

import asyncio
import logging
import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from lsprotocol import types
from pygls.exceptions import FeatureRequestError, JsonRpcInvalidParams
from pygls.lsp.server import LanguageServer

from thorvaldc import __version__
from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.tools.language_server.diagnostic_publisher import DiagnosticPublisher
from thorvaldc.tools.language_server.features import Features, RenameError, Session
from thorvaldc.tools.language_server.open_document import (
    OpenDocument,
    open_document,
    path_of,
    texts_of,
)


class ThorvaldcServer(LanguageServer):
    """A language server for the documents of thorvaldc.

    The editor sends the whole text of a document after each change: an editor and a server that
    disagree about the line breaks of a text would otherwise have different texts.

    Attributes
    ----------
    documents : the open documents by URI.
    publisher : analyses the documents and publishes their diagnostics.
    """

    def __init__(self) -> None:
        super().__init__(
            "thorvaldc", __version__, text_document_sync_kind=types.TextDocumentSyncKind.Full
        )
        self.documents: dict[str, OpenDocument] = {}
        self.publisher = DiagnosticPublisher(
            self.documents, self.text_document_publish_diagnostics, self.log_error
        )
        self._executor = ThreadPoolExecutor(1, "thorvaldc-requests")
        self._register_notifications()
        self._register_requests()

    def _register_notifications(self) -> None:
        self._notification(types.TEXT_DOCUMENT_DID_OPEN, self._did_open)
        self._notification(types.TEXT_DOCUMENT_DID_CHANGE, self._did_change)
        self._notification(types.TEXT_DOCUMENT_DID_SAVE, self._files_changed)
        self._notification(types.WORKSPACE_DID_CHANGE_WATCHED_FILES, self._files_changed)
        self._notification(types.TEXT_DOCUMENT_DID_CLOSE, self._did_close)
        self._notification(types.SHUTDOWN, self._shutdown)

    def _register_requests(self) -> None:
        features = Features()
        self._request(types.TEXT_DOCUMENT_HOVER, features.hover)
        self._request(
            types.TEXT_DOCUMENT_COMPLETION,
            features.completion,
            types.CompletionOptions(trigger_characters=list(".: {[\"'/")),
        )
        self._request(types.TEXT_DOCUMENT_DEFINITION, features.definition)
        self._request(types.TEXT_DOCUMENT_DOCUMENT_SYMBOL, features.symbols)
        self._request(types.TEXT_DOCUMENT_FORMATTING, features.formatting)
        self._request(types.TEXT_DOCUMENT_REFERENCES, features.references)
        self._request(types.TEXT_DOCUMENT_PREPARE_RENAME, features.prepare_rename)
        self._request(
            types.TEXT_DOCUMENT_RENAME, features.rename, types.RenameOptions(prepare_provider=True)
        )
        self._request(
            types.TEXT_DOCUMENT_CODE_ACTION,
            lambda document, params, session: self.publisher.code_actions(document, params.range),
            types.CodeActionOptions([types.CodeActionKind.QuickFix]),
        )

    def _notification(self, method: str, handle: Callable[[Any], None]) -> None:
        # pygls sets attributes on the function of a feature, which a bound method does not have.
        @self.feature(method)
        def call(params: Any) -> None:
            handle(params)

    def _request(
        self,
        method: str,
        answer: Callable[[OpenDocument, Any, Session], Any],
        options: object = None,
    ) -> None:
        """Registers a request that is answered in the thread of the requests.

        The answer is dropped if the document has changed in the meantime.
        """

        def answer_with_texts(document: OpenDocument, params: Any, session: Session) -> Any:
            with unsaved_texts(session.texts):
                return answer(document, params, session)

        @self.feature(method, options)
        async def call(params: Any) -> Any:
            document = self.documents.get(params.text_document.uri)
            if document is None:
                return None
            loop, session = asyncio.get_running_loop(), self._session()
            try:
                value = await loop.run_in_executor(
                    self._executor, answer_with_texts, document, params, session
                )
            except RenameError as error:
                raise JsonRpcInvalidParams(str(error)) from None
            except Exception as error:
                self.log_error(f"{method}, {document.path}: {type(error).__name__}: {error}")
                return None
            return value if self.documents.get(document.uri) is document else None

    def _session(self) -> Session:
        completion = getattr(self.client_capabilities.text_document, "completion", None)
        item = getattr(completion, "completion_item", None)
        folders = [path_of(uri) for uri in self.workspace.folders] or [self.folder]
        return Session(
            texts_of(self.documents),
            {document.real_path: document.uri for document in self.documents.values()},
            self.publisher.models,
            self.publisher.library_folders,
            tuple(folder for folder in folders if folder is not None),
            bool(getattr(item, "snippet_support", False)),
        )

    @property
    def folder(self) -> Path:
        """The first folder of the workspace, or the current folder."""
        uri = self.workspace.root_uri
        path = path_of(uri) if uri else None
        return path or Path.cwd()

    def log_error(self, message: str) -> None:
        """Writes an error message to the log of the editor."""
        self.window_log_message(types.LogMessageParams(types.MessageType.Error, message))

    def report_server_error(self, error: Exception, source: Any) -> None:
        """Writes an unexpected error to the log, in place of the pop-up window of pygls.

        The editor gets the errors of requests as their answers.
        """
        if source is FeatureRequestError:
            return
        self.log_error(f"{type(error).__name__}: {error}")

    # -- documents --------------------------------------------------------------------

    def _did_open(self, params: types.DidOpenTextDocumentParams) -> None:
        item = params.text_document
        self._keep(item.uri, item.version, item.text)
        self.publisher.files_changed()

    def _did_change(self, params: types.DidChangeTextDocumentParams) -> None:
        uri = params.text_document.uri
        text = self.workspace.get_text_document(uri).source
        self.publisher.document_changed(self._keep(uri, params.text_document.version, text))

    def _did_close(self, params: types.DidCloseTextDocumentParams) -> None:
        self.documents.pop(params.text_document.uri, None)
        self.publisher.document_closed(params.text_document.uri)

    def _files_changed(self, params: object) -> None:
        self.publisher.files_changed()

    def _keep(self, uri: str, version: int | None, text: str) -> OpenDocument:
        document = open_document(uri, version, text, self.folder)
        self.documents[uri] = document
        return document

    def _shutdown(self, params: None) -> None:
        self.publisher.close()
        self._executor.shutdown(wait=False, cancel_futures=True)


def serve() -> None:
    """Serves the editor on standard input and output until the editor ends the connection.

    What other code prints goes to standard error, because standard output belongs to the protocol.
    """
    logging.getLogger("pygls").setLevel(logging.CRITICAL)  # errors are in the log of the editor
    with os.fdopen(os.dup(1), "wb") as output:
        os.dup2(2, 1)
        sys.stdout = sys.stderr
        ThorvaldcServer().start_io(sys.stdin.buffer, output)
