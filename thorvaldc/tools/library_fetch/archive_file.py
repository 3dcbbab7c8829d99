"""Reads the files of a library from a .tar.gz or .zip file, at a path or an address."""

from __future__ import annotations

import gzip
import http.client
import io
import stat
import tarfile
import time
import urllib.error
import urllib.parse
import urllib.request
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from thorvaldc.compiler.modules.fetched_library import MAX_BYTES
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.diagnostics.files import read_bounded
from thorvaldc.tools.library_fetch.library_stage import LibraryStage, refused

TIMEOUT = 300.0  # s, of a download
_SILENCE = 30.0  # s, without a byte
_PART = 1 << 20
_BROKEN = (
    *(tarfile.TarError, zipfile.BadZipFile, zlib.error, EOFError, gzip.BadGzipFile),
    *(ValueError, NotImplementedError, RuntimeError, RecursionError, UnicodeError),
)


def unpack(archive: str, folder: Path, stage: LibraryStage) -> None:
    """Writes the files of an archive into the stage.

    - ``archive``: URL of the archive, or its path relative to ``folder``.

    Raises ``DiagnosticError`` if it cannot be read, is damaged, or has something else than files
    and folders.
    """
    data = _content(archive, folder)
    try:
        if data.startswith(b"PK"):
            _unzip(data, stage)
        elif data.startswith(b"\x1f\x8b"):
            _untar(data, stage)
        else:
            raise refused("it is no archive", "expected a .tar.gz or .zip file")
    except _BROKEN as error:
        raise refused(f"it is damaged: {error or type(error).__name__}") from None


def _content(archive: str, folder: Path) -> bytes:
    try:
        if archive.startswith("https:"):
            return _download(archive)
        if archive.startswith("file:"):
            archive = urllib.request.url2pathname(urllib.parse.urlsplit(archive).path)
        return read_bounded(folder / archive, MAX_BYTES)
    except DiagnosticError:
        raise
    except (OSError, ValueError, http.client.HTTPException) as error:
        error = reason if isinstance(reason := getattr(error, "reason", None), OSError) else error
        raise refused(f"it cannot be read: {getattr(error, 'strerror', None) or error}") from None


def _download(url: str) -> bytes:
    """Returns the content at an address.  A redirection may lead to another https address only."""
    opener = urllib.request.OpenerDirector()
    for handler in (
        *(urllib.request.ProxyHandler, urllib.request.HTTPSHandler),
        *(urllib.request.HTTPRedirectHandler, urllib.request.HTTPErrorProcessor),
        *(urllib.request.HTTPDefaultErrorHandler, urllib.request.UnknownHandler),
    ):
        opener.add_handler(handler())
    end, parts, size = time.monotonic() + TIMEOUT, list[bytes](), 0
    with opener.open(url, timeout=_SILENCE) as answer:
        while part := answer.read1(_PART):
            parts.append(part)
            size += len(part)
            if size > MAX_BYTES:
                raise ValueError(f"it has more than {MAX_BYTES / 1e6:.0f} MB")
            if time.monotonic() > end:
                raise ValueError(f"the download takes more than {TIMEOUT:.0f} s")
    return b"".join(parts)


def _unzip(data: bytes, stage: LibraryStage) -> None:
    # The list of the files of an archive of this size could fill the memory.
    stage.check_size(data.count(b"PK\x01\x02") // 2, 0)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for info in archive.infolist():
            if info.is_dir():
                continue
            path = stage.path_of(info.filename)
            if path is None:
                continue
            kind = stat.S_IFMT(info.external_attr >> 16)
            if kind not in (0, stat.S_IFREG):
                raise refused(f"{info.filename!r} is a link or a device, which is not allowed")
            if info.flag_bits & 1:
                raise refused(f"{info.filename!r} is encrypted")
            with archive.open(info) as file:
                stage.add(path, _parts(file))


def _untar(data: bytes, stage: LibraryStage) -> None:
    # The limit also holds for headers and for files outside of the folder of the library.
    stream = _Bounded(gzip.GzipFile(fileobj=io.BytesIO(data)), 2 * MAX_BYTES)
    with tarfile.open(fileobj=stream, mode="r|") as archive:  # type: ignore[call-overload]
        for number, member in enumerate(archive):
            stage.check_size(number // 4, 0)
            archive.members.clear()  # they would fill the memory
            path = member.name.removeprefix("./")
            if member.isdir():
                continue
            relative = stage.path_of(path)
            if relative is None:
                continue
            if member.type not in (tarfile.REGTYPE, tarfile.AREGTYPE) or member.issparse():
                raise refused(f"{path!r} is a link or a device, which is not allowed")
            file = archive.extractfile(member)
            assert file is not None
            stage.add(relative, _parts(file))


class _Bounded:
    """A stream that raises ``ValueError`` after a number of bytes."""

    def __init__(self, file: gzip.GzipFile, limit: int) -> None:
        self._file = file
        self._rest = limit

    def read(self, size: int) -> bytes:
        data = self._file.read(size)
        self._rest -= len(data)
        if self._rest < 0:
            raise ValueError("it has too many bytes")
        return data


def _parts(file: IO[bytes] | Any) -> Iterator[bytes]:
    while part := file.read(_PART):
        yield part
