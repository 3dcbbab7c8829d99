"""The documents in the folders of the workspace that may name a robot."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from thorvaldc.compiler.source.input_file import read_bytes, unsaved_texts
from thorvaldc.diagnostics import Report
from thorvaldc.tools.language_server.open_document import OpenDocument, open_document, uri_of

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
