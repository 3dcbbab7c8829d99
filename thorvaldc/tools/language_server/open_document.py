"""The documents that are open in the editor or in its workspace, and their kinds."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

from thorvaldc.compiler.modules.library import FILE as MODULE_FILE
from thorvaldc.compiler.source.input_file import read_bytes, unsaved_texts
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.schema.documents import Kind
from thorvaldc.tools.language_server.document_tree import tree_of
from thorvaldc.tools.language_server.source_text import SourceText

_TOP_LEVEL_KEY = re.compile(r"^(?:\{\s*)?[\"']?([A-Za-z_]\w*)[\"']?[ \t]*:(?=\s|$)", re.MULTILINE)
_NO_KIND = frozenset(["thorvaldc_lock", "motor_drives"])
_KEYS_OF_KINDS: tuple[tuple[Kind, frozenset[str]], ...] = (
    ("study", frozenset(["study", "objectives", "samples"])),
    ("scenario", frozenset(["scenario", "script", "expect", "duration", "world"])),
    ("robot", frozenset(["base_calculator", "extras", "buses", "design", "defaults"])),
    ("fleet", frozenset(["robots"])),
    ("bus_faults", frozenset(["faults", "quirks"])),
    ("module", frozenset(["params", "links", "joints", "ports", "let", "category", "mount"])),
    ("robot", frozenset(["modules", "driver"])),
    ("calibration", frozenset(["wheels"])),
)
_FILE_NAMES: dict[str, Kind] = {
    "robot.yaml": "robot",
    "fleet.yaml": "fleet",
    "scenario.yaml": "scenario",
    "calibration.yaml": "calibration",
    MODULE_FILE: "module",
}


def kind_of(text: str, file_name: str) -> Kind | None:
    """Returns the kind of a document, also if it is half typed.

    Returns ``None`` if the document is not one of thorvaldc: a document has the key ``thorvaldc``
    or a file name of the language, such as ``robot.yaml``.
    """
    keys = set(_TOP_LEVEL_KEY.findall(text[:1_000_000]))
    by_name = _FILE_NAMES.get(file_name)
    if keys & _NO_KIND or ("thorvaldc" not in keys and by_name is None):
        return None
    if by_name is not None:
        return by_name
    for kind, kind_keys in _KEYS_OF_KINDS:
        if keys & kind_keys:
            return kind
    return "robot"


@dataclass(frozen=True, eq=False)
class OpenDocument:
    """A document that is open in the editor.

    Attributes
    ----------
    uri : URI of the document, as the editor wrote it.
    path : path of the document, as the editor wrote it.  A document that was never saved has a
        path in the folder of the workspace.
    real_path : path without symbolic links, which names the document in ``unsaved_texts``.
    version : number of the change, from the editor.
    text : text of the document.
    """

    uri: str
    path: Path
    real_path: str
    version: int | None
    text: str

    @cached_property
    def source(self) -> SourceText:
        """The text with conversions of positions."""
        return SourceText(self.text)

    @cached_property
    def encoded(self) -> bytes:
        """The text as UTF-8; half of a pair of UTF-16 code units becomes invalid UTF-8."""
        return self.text.encode("utf-8", "surrogatepass")

    @cached_property
    def tree(self) -> Node | None:
        """The YAML tree without the lines that have YAML errors, or ``None``."""
        return tree_of(self.source, str(self.path))

    @cached_property
    def kind(self) -> Kind | None:
        """Kind of the document, or ``None`` if the document is not one of thorvaldc."""
        return kind_of(self.text, self.path.name)


def open_document(uri: str, version: int | None, text: str, folder: Path) -> OpenDocument:
    """Returns an open document.

    - ``folder``: folder of a document that was never saved.
    """
    path = path_of(uri) or folder / (unquote(uri).rpartition("/")[2].rpartition(":")[2] or "new")
    return OpenDocument(uri, path, os.path.realpath(path), version, text)


def texts_of(documents: Mapping[str, OpenDocument]) -> dict[str, bytes]:
    """Returns the texts of the open documents by their real paths, for ``unsaved_texts``."""
    return {document.real_path: document.encoded for document in documents.values()}


def path_of(uri: str) -> Path | None:
    """Returns the path of a URI of the scheme ``file``, or ``None``."""
    try:
        parts = urlsplit(uri)
    except ValueError:
        return None
    if parts.scheme != "file":
        return None
    path = unquote(parts.path)
    if re.match(r"/[A-Za-z]:", path):  # a drive of Windows
        path = path[1:]
    return Path(path) if path and "\0" not in path else None


def uri_of(path: Path | str) -> str:
    """Returns the URI of an absolute path."""
    text = os.fspath(path).replace("\\", "/")
    return "file://" + quote(text if text.startswith("/") else f"/{text}", errors="surrogateescape")


# -- documents in the folders of the workspace ---------------------------------------------

MAX_ENTRIES = 20_000
"""Greatest number of files and folders that are searched."""
MAX_BYTES = 1_000_000

_SKIPPED = frozenset(["node_modules", "build", "install", "log", "__pycache__"])


def workspace_documents(
    folders: Iterable[Path], texts: Mapping[str, bytes], uris: Mapping[str, str]
) -> Iterator[OpenDocument]:
    """Yields the documents of thorvaldc in the folders of the workspace, and the open ones.

    - ``texts``: unsaved texts by real path.
    - ``uris``: URIs of the open documents by real path, as the editor wrote them.
    """
    paths = dict.fromkeys([*texts, *_yaml_files(folders)])
    with unsaved_texts(texts):
        for path in paths:
            data = read_bytes(Path(path), path, Report(), limit=MAX_BYTES)
            if data is None or b"thorvaldc" not in data:
                continue
            text = data.decode("utf-8", "replace")
            yield open_document(uris.get(path, uri_of(path)), None, text, Path())


def _yaml_files(folders: Iterable[Path]) -> Iterator[str]:
    count = 0
    for folder in folders:
        for root, names, files in os.walk(folder):
            names[:] = sorted(n for n in names if n not in _SKIPPED and not n.startswith("."))
            count += len(names) + len(files)
            if count > MAX_ENTRIES:
                return
            for file in sorted(files):
                if file.endswith((".yaml", ".yml")):
                    yield os.path.realpath(os.path.join(root, file))
