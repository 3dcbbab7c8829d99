"""Reads SDF and URDF files with libsdformat, many in one process.

The program ``ign sdf`` calls the same functions of the library, once for each start of Ruby.
Input: a JSON list of pairs of ``check`` or ``print`` and a path. Output: a JSON list of texts.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
import tempfile


def main() -> None:
    library = ctypes.CDLL("libsdformat12.so.12")
    texts = []
    for command, path in json.load(sys.stdin):
        call = {"check": library.cmdCheck, "print": library.cmdPrint}[command]
        with tempfile.TemporaryFile() as file:
            sys.stdout.flush()
            saved = os.dup(1)
            os.dup2(file.fileno(), 1)  # the library writes by itself
            try:
                call(path.encode())
                ctypes.CDLL(None).fflush(None)
            finally:
                os.dup2(saved, 1)
                os.close(saved)
            file.seek(0)
            texts.append(file.read().decode())
    json.dump(texts, sys.stdout)


if __name__ == "__main__":
    main()
