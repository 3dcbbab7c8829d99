"""The server's side of SDO transfers (CiA 301): expedited and segmented, both ways."""

from __future__ import annotations

import struct
from collections.abc import Callable

from thorvaldc.simulation.bus.object_dictionary import (
    COMMAND_UNKNOWN,
    LENGTH_WRONG,
    TOGGLE_NOT_ALTERNATED,
    Later,
    ObjectDictionary,
    SdoAbort,
)

_SEGMENT = 7
_DOWNLOAD_SEGMENT, _DOWNLOAD, _UPLOAD, _UPLOAD_SEGMENT, _ABORT = range(5)


class SdoServer:
    """Answers requests with ``respond``; one transfer at a time.

    Block transfer is refused with the abort code that says so, on which clients fall
    back to segments.  A new request ends a transfer that was not finished.
    """

    def __init__(self, objects: ObjectDictionary, respond: Callable[[bytes], None]) -> None:
        self._objects = objects
        self._respond = respond
        self._place = (0, 0)
        self._upload: bytes | None = None
        self._download: bytearray | None = None
        self._size: int | None = None
        self._toggle = 0

    def request(self, data: bytes) -> None:
        """A frame of 8 bytes from a client; shorter ones are not answered."""
        if len(data) != 8:
            return
        command = data[0] >> 5
        try:
            if command == _DOWNLOAD:
                self._begin_download(data)
            elif command == _DOWNLOAD_SEGMENT:
                self._download_segment(data)
            elif command == _UPLOAD:
                self._begin_upload(data)
            elif command == _UPLOAD_SEGMENT:
                self._upload_segment(data)
            elif command == _ABORT:
                self._upload = self._download = None
            else:
                self._place = struct.unpack_from("<HB", data, 1)
                raise SdoAbort(COMMAND_UNKNOWN)
        except SdoAbort as abort:
            self._upload = self._download = None
            self._respond(struct.pack("<BHBI", 0x80, *self._place, abort.code))

    def _begin_download(self, data: bytes) -> None:
        self._upload = self._download = None
        index, subindex = self._place = struct.unpack_from("<HB", data, 1)
        expedited, sized = data[0] & 2, data[0] & 1
        if expedited:
            length = 4 - (data[0] >> 2 & 3) if sized else 4
            if not sized and self._place in self._objects:
                length = self._objects[self._place].size or 4
            later = self._objects.download(index, subindex, data[4 : 4 + length])
        else:
            entry = self._objects[self._place]
            self._size = struct.unpack_from("<I", data, 4)[0] if sized else None
            if self._size is not None and entry.size and self._size != entry.size:
                raise SdoAbort(LENGTH_WRONG)
            self._download, self._toggle = bytearray(), 0
            later = None
        self._respond_when(later, struct.pack("<BHB4x", 0x60, *self._place))

    def _download_segment(self, data: bytes) -> None:
        if self._download is None:
            raise SdoAbort(COMMAND_UNKNOWN)
        self._check_toggle(data[0] >> 4 & 1)
        self._download += data[1 : 8 - (data[0] >> 1 & 7)]
        later = None
        if data[0] & 1:
            found, self._download = bytes(self._download), None
            if self._size is not None and self._size != len(found):
                raise SdoAbort(LENGTH_WRONG)
            later = self._objects.download(*self._place, found)
        self._respond_when(later, bytes([0x20 | self._toggle << 4]) + bytes(7))
        self._toggle ^= 1

    def _respond_when(self, later: Later | None, data: bytes) -> None:
        if later is None:
            self._respond(data)
        else:
            later(lambda: self._respond(data))

    def _begin_upload(self, data: bytes) -> None:
        self._upload = self._download = None
        index, subindex = self._place = struct.unpack_from("<HB", data, 1)
        value = self._objects.upload(index, subindex)
        if 1 <= len(value) <= 4:
            head = 0x43 | (4 - len(value)) << 2
            self._respond(struct.pack("<BHB", head, *self._place) + value.ljust(4, b"\0"))
            return
        self._upload, self._toggle = value, 0
        self._respond(struct.pack("<BHBI", 0x41, *self._place, len(value)))

    def _upload_segment(self, data: bytes) -> None:
        if self._upload is None:
            raise SdoAbort(COMMAND_UNKNOWN)
        self._check_toggle(data[0] >> 4 & 1)
        part, rest = self._upload[:_SEGMENT], self._upload[_SEGMENT:]
        last = not rest
        head = self._toggle << 4 | (_SEGMENT - len(part)) << 1 | int(last)
        self._upload = None if last else rest
        self._respond(bytes([head]) + part.ljust(_SEGMENT, b"\0"))
        self._toggle ^= 1

    def _check_toggle(self, toggle: int) -> None:
        if toggle != self._toggle:
            raise SdoAbort(TOGGLE_NOT_ALTERNATED)
