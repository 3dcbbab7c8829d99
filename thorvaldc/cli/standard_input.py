"""Documents from the standard input, which commands name ``-``."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.compiler.source.reader import MAX_BYTES


@contextmanager
def standard_input(name: str) -> Iterator[Path]:
    """Makes the standard input the content of a file of the working folder, which need not exist.

    Paths in the document start there.  Returns a file with the same text, for excerpts.
    """
    data = sys.stdin.buffer.read(MAX_BYTES + 1)  # a longer document is an error
    with tempfile.NamedTemporaryFile(prefix="thorvaldc-") as copy:
        copy.write(data)
        copy.flush()
        with unsaved_texts({os.path.realpath(name): data}):
            yield Path(copy.name)
