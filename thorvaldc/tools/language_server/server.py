"""The protocol of the language server: requests and notifications of the editor, diagnostics."""

from __future__ import annotations

import asyncio
import logging
import os
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lsprotocol import types
from pygls.exceptions import FeatureRequestError, JsonRpcInvalidParams
from pygls.lsp.server import LanguageServer

from thorvaldc import __version__
from thorvaldc.compiler.catalogue import check_module
from thorvaldc.compiler.modules.library import BUILTIN_LIBRARY, module_library
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.validation.document_check import check
from thorvaldc.diagnostics import Diagnostic, Fix, Report, Severity, Span
from thorvaldc.model import Fleet, Robot
from thorvaldc.schema import Kind
from thorvaldc.tools.language_server import features
from thorvaldc.tools.language_server.features import RenameError, Session
from thorvaldc.tools.language_server.module_view import ModuleView
from thorvaldc.tools.language_server.open_document import (
    OpenDocument,
    open_document,
    path_of,
    texts_of,
    uri_of,
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
        self._request(types.TEXT_DOCUMENT_HOVER, features.hover)
        self._request(
            types.TEXT_DOCUMENT_COMPLETION,
            features.completion,
            types.CompletionOptions(trigger_characters=list(".: {[\"'/")),
        )
        self._request(types.TEXT_DOCUMENT_DEFINITION, features.definition)
        self._request(types.TEXT_DOCUMENT_DOCUMENT_SYMBOL, features.symbols)
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


# -- diagnostics ------------------------------------------------------------------------
#
# An analysis starts ``DELAY`` seconds after a change, and a new change makes its result stale: the
# result is dropped, because the next analysis is already planned.  The thread of the analyses also
# isolates the editor from documents that take long.

DELAY = 0.02
"""Time (s) between a change and the start of the analysis."""

_SEVERITIES = {
    Severity.ERROR: types.DiagnosticSeverity.Error,
    Severity.WARNING: types.DiagnosticSeverity.Warning,
    Severity.NOTE: types.DiagnosticSeverity.Information,
}


@dataclass
class DiagnosticPublisher:
    """Analyses documents after each change and publishes the diagnostics by file.

    Attributes
    ----------
    documents : the open documents by URI.
    publish : sends the diagnostics of one file to the editor.
    log : sends an error message to the log of the editor.
    analyses : the last analysis of each open document, by URI.
    """

    documents: dict[str, OpenDocument]
    publish: Callable[[types.PublishDiagnosticsParams], Any]
    log: Callable[[str], Any]
    analyses: dict[str, Analysis] = field(default_factory=dict)
    _models: dict[str, Robot | Fleet] = field(default_factory=dict)
    _pending: dict[str, None] = field(default_factory=dict)  # URIs, the last change first
    _published: dict[str, set[str]] = field(default_factory=dict)  # URIs of files, by document
    _changed_at: float = 0.0
    _task: asyncio.Task[None] | None = None
    _executor: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(1, "thorvaldc-analysis")
    )

    def document_changed(self, document: OpenDocument) -> None:
        """Plans the analysis of a changed document and of the documents that read it."""
        users = [
            uri
            for uri, analysis in self.analyses.items()
            if document.real_path in analysis.files and uri != document.uri
        ]
        self._plan([document.uri, *users])

    def files_changed(self) -> None:
        """Plans the analysis of all open documents, after a change of files on the disk."""
        self._plan(list(self.documents))

    def document_closed(self, uri: str) -> None:
        """Removes the diagnostics of a closed document."""
        for kept in (self.analyses, self._models, self._pending):
            kept.pop(uri, None)
        for file in self._published.pop(uri, set()):
            self._publish_file(file)
        self.files_changed()

    def close(self) -> None:
        """Ends the thread; an analysis that is running is not waited for."""
        if self._task is not None:
            self._task.cancel()
        self._executor.shutdown(wait=False, cancel_futures=True)

    # -- analyses ---------------------------------------------------------------------

    def _plan(self, uris: list[str]) -> None:
        known = [uri for uri in uris if uri in self.documents]
        self._pending = {**dict.fromkeys(known), **self._pending}
        loop = asyncio.get_running_loop()
        self._changed_at = loop.time()
        if self._task is None or self._task.done():
            self._task = loop.create_task(self._work())

    async def _work(self) -> None:
        loop = asyncio.get_running_loop()
        while self._pending:
            delay = self._changed_at + DELAY - loop.time()
            if delay > 0:
                await asyncio.sleep(delay)
                continue
            uri = next(iter(self._pending))
            del self._pending[uri]
            document = self.documents.get(uri)
            if document is None:
                continue
            documents, folders = dict(self.documents), self.library_folders
            try:
                analysis = await loop.run_in_executor(
                    self._executor, analyse, document, documents, folders
                )
            except Exception as error:
                self.log(f"{document.path}: {type(error).__name__}: {error}")
                continue
            is_stale = uri in self._pending or self.documents.get(uri) is not document
            if not is_stale:
                self.analyses[uri] = analysis
                if analysis.model is not None:
                    self._models[uri] = analysis.model
                self._publish(uri, analysis)

    @property
    def models(self) -> dict[str, Robot | Fleet]:
        """Models of the last analyses without errors, by the URI of the document."""
        return dict(self._models)

    @property
    def library_folders(self) -> tuple[Path, ...]:
        """Returns the library folders that the open robots name."""
        folders = (folder for analysis in self.analyses.values() for folder in analysis.library)
        return tuple(dict.fromkeys(folders))

    # -- publication ------------------------------------------------------------------

    def _publish(self, uri: str, analysis: Analysis) -> None:
        files = {uri} | {
            self._uri(diagnostic.span, analysis.sources)
            for diagnostic in analysis.diagnostics
            if diagnostic.span is not None
        }
        earlier = self._published.get(uri, set())
        self._published[uri] = files
        for file in sorted(files | earlier):
            self._publish_file(file)

    def _publish_file(self, file: str) -> None:
        """Publishes the diagnostics that all open documents have in one file."""
        converted: dict[Diagnostic, types.Diagnostic] = {}
        for uri, analysis in self.analyses.items():
            for diagnostic in analysis.diagnostics:
                place = self._uri(diagnostic.span, analysis.sources) if diagnostic.span else uri
                if place == file and diagnostic not in converted:
                    converted[diagnostic] = self._converted(diagnostic, analysis.sources)
        document = self.documents.get(file)
        version = document.version if document is not None else None
        self.publish(types.PublishDiagnosticsParams(file, list(converted.values()), version))

    def _uri(self, span: Span, sources: Mapping[str, Path]) -> str:
        """Returns the URI of the file of a span, as the editor writes it for open documents."""
        path = os.path.realpath(sources.get(span.file, span.file))
        for document in self.documents.values():
            if document.real_path == path:
                return document.uri
        return uri_of(path)

    def _location(self, span: Span, sources: Mapping[str, Path]) -> types.Location:
        uri = self._uri(span, sources)
        document = self.documents.get(uri)
        if document is not None:
            return types.Location(uri, document.source.range(span))
        start = types.Position(span.line - 1, span.column - 1)
        end = types.Position(span.end_line - 1, span.end_column - 1)
        return types.Location(uri, types.Range(start, end))

    def _converted(self, diagnostic: Diagnostic, sources: Mapping[str, Path]) -> types.Diagnostic:
        message = diagnostic.message
        if diagnostic.hint:
            message += f"\nhint: {diagnostic.hint}"
        place = types.Range(types.Position(0, 0), types.Position(0, 0))
        if diagnostic.span is not None:
            place = self._location(diagnostic.span, sources).range
        return types.Diagnostic(
            place,
            message,
            severity=_SEVERITIES[diagnostic.severity],
            code=diagnostic.code.number,
            source="thorvaldc",
            related_information=[
                types.DiagnosticRelatedInformation(self._location(label.span, sources), label.text)
                for label in diagnostic.labels
            ],
        )

    # -- quick fixes ------------------------------------------------------------------

    def code_actions(self, document: OpenDocument, place: types.Range) -> list[types.CodeAction]:
        """Returns the changes that the hints of the diagnostics in a range propose.

        The changes of a diagnostic are left out if a text has changed since its analysis.
        """
        actions: list[types.CodeAction] = []
        for analysis in list(self.analyses.values()):
            for diagnostic in analysis.diagnostics:
                if not diagnostic.fixes or diagnostic.span is None:
                    continue
                if self._uri(diagnostic.span, analysis.sources) != document.uri:
                    continue
                span_range = document.source.range(diagnostic.span)
                if span_range.end < place.start or place.end < span_range.start:
                    continue
                for fix in diagnostic.fixes:
                    action = self._code_action(diagnostic, fix, analysis)
                    if action is not None:
                        actions.append(action)
        return actions

    def _code_action(
        self, diagnostic: Diagnostic, fix: Fix, analysis: Analysis
    ) -> types.CodeAction | None:
        target = self._location(fix.span, analysis.sources)
        document = self.documents.get(target.uri)
        if document is not analysis.documents.get(target.uri):
            return None
        old = document.source.span_text(fix.span) if document is not None else ""
        edit = types.TextEdit(target.range, fix.text)
        return types.CodeAction(
            _title(diagnostic, fix, old),
            kind=types.CodeActionKind.QuickFix,
            diagnostics=[self._converted(diagnostic, analysis.sources)],
            is_preferred=len(diagnostic.fixes) == 1 and not fix.is_example,
            edit=types.WorkspaceEdit({target.uri: [edit]}),
        )


def _title(diagnostic: Diagnostic, fix: Fix, old: str) -> str:
    """Returns the title of a quick fix: the hint, or the new text if there are alternatives."""
    if len(diagnostic.fixes) == 1 and diagnostic.hint:
        return diagnostic.hint[:1].upper() + diagnostic.hint[1:120]
    new = " ".join(fix.text.split()) or "nothing"
    action = f"Replace `{old}` by `{new}`" if old else f"Insert `{new}`"
    return action[:120]


# -- the analysis of one document -------------------------------------------------------


@dataclass(frozen=True)
class Analysis:
    """Result of the analysis of one document.

    Attributes
    ----------
    documents : the open documents at the time of the analysis, by URI.
    diagnostics : diagnostics with absolute paths, in the order of file and line.
    sources : path of each file name in the spans of the diagnostics, and of each file that the
        analysis has read.
    files : real paths of the files that the analysis has read.
    model : the robot or fleet, or ``None`` if the document has errors or another kind.
    library : library folders that a robot document names.
    """

    documents: Mapping[str, OpenDocument] = field(default_factory=dict)
    diagnostics: tuple[Diagnostic, ...] = ()
    sources: Mapping[str, Path] = field(default_factory=dict)
    files: frozenset[str] = frozenset()
    model: Robot | Fleet | None = None
    library: tuple[Path, ...] = ()


def analyse(
    document: OpenDocument, documents: Mapping[str, OpenDocument], folders: tuple[Path, ...] = ()
) -> Analysis:
    """Returns the diagnostics of a document, and of the files that it names.

    - ``documents``: all open documents, whose unsaved texts count.
    - ``folders``: further library folders, for the modules that a module document names.
    """
    kind = document.kind
    if kind is None:
        return Analysis(documents)
    model = None
    with unsaved_texts(texts_of(documents)):
        if kind in ("robot", "fleet", "scenario", "study"):
            compilation = compile_file(document.path)
            report, sources = compilation.report, compilation.sources
            model = compilation.model
        else:
            report, sources = _checked_alone(document, kind, folders)
    files = frozenset(os.path.realpath(path) for path in sources.values())
    diagnostics = tuple(report.sorted())
    library = library_of(document) if kind == "robot" else ()
    return Analysis(documents, diagnostics, sources, files | {document.real_path}, model, library)


def library_of(document: OpenDocument) -> tuple[Path, ...]:
    """Returns the library folders that a robot document, or its design, names."""
    if "library" not in document.text and "extends" not in document.text:
        return ()
    return ModuleView("robot", document.path, document.tree, ()).named_folders


def _checked_alone(
    document: OpenDocument, kind: Kind, folders: tuple[Path, ...]
) -> tuple[Report, dict[str, Path]]:
    """Checks a document that no robot needs to name."""
    report, name = Report(), str(document.path)
    if kind == "module":
        module, library = module_library(document.path, folders)
        if library.exists(module):
            check_module(module, library, report)
            builtin = BUILTIN_LIBRARY + "/"
            sources = {n: path for n, path in library.files.items() if n.startswith(builtin)}
            return report, sources | {str(p): p for p in library.files.values()}
    node = read_text(document.encoded, name, report)
    if node is not None:
        check(node, kind, report)
    return report, {name: document.path}
