"""A simulated SDO server (CiA 301) with expedited and segmented transfers."""

from __future__ import annotations

import struct
from collections.abc import Callable

from thorvaldc.can import sdo
from thorvaldc.can.sdo import EXPEDITED, SIZE_INDICATED, AbortCode, ClientCommand
from thorvaldc.simulation.bus.object_dictionary import DelayedWrite, ObjectDictionary, SdoAbort
from thorvaldc.simulation.bus.sdo_block_transfer import (
    BLOCK_DOWNLOAD,
    BLOCK_UPLOAD,
    BlockTransfer,
)


class SdoServer:
    """Answers the SDO requests of a client, one transfer at a time.

    The function ``respond`` sends a response to the SDO client.  Unless ``blocks`` is true, the
    server aborts a block transfer with the abort code "command unknown".  An SDO client then uses a
    segmented transfer instead of a block transfer.  A new SDO request ends an unfinished SDO
    transfer.  If ``segmented`` is true, the server transfers short values in segments too, and
    refuses expedited downloads.
    """

    def __init__(
        self,
        objects: ObjectDictionary,
        respond: Callable[[bytes], None],
        *,
        segmented: bool = False,
        blocks: bool = False,
    ) -> None:
        self._segmented = segmented
        self._blocks = BlockTransfer(objects, respond) if blocks else None
        self._objects = objects
        self._respond = respond
        self._object = (0, 0)
        """Index and subindex of the current transfer."""
        self._upload: bytes | None = None
        """Bytes that the server has not yet sent in segments."""
        self._download: bytearray | None = None
        self._size: int | None = None
        self._toggle = 0

    def request(self, data: bytes) -> None:
        """Handles an SDO request of 8 bytes.

        The SDO server does not answer a message with another length.
        """
        if len(data) != 8:
            return
        command, blocks = data[0] >> 5, self._blocks
        if blocks is not None and data[0] == sdo.abort_message(0, 0, 0)[0]:
            blocks.end()
        if blocks is not None and blocks.download_pending:
            blocks.segment(data)
            return
        if blocks is not None and command in (BLOCK_DOWNLOAD, BLOCK_UPLOAD):
            self._block_request(blocks, data)
            return
        try:
            if command == ClientCommand.INITIATE_DOWNLOAD:
                self._initiate_download(data)
            elif command == ClientCommand.DOWNLOAD_SEGMENT:
                self._download_segment(data)
            elif command == ClientCommand.INITIATE_UPLOAD:
                self._initiate_upload(data)
            elif command == ClientCommand.UPLOAD_SEGMENT:
                self._upload_segment(data)
            elif command == ClientCommand.ABORT:
                self._upload = self._download = None
            else:
                self._object = struct.unpack_from("<HB", data, 1)
                raise SdoAbort(AbortCode.COMMAND_UNKNOWN)
        except SdoAbort as abort:
            self._upload = self._download = None
            self._respond(sdo.abort_message(*self._object, abort.code))

    def _block_request(self, blocks: BlockTransfer, data: bytes) -> None:
        self._upload = self._download = None
        is_end = data[0] & 3 == 1 and data[0] >> 5 == BLOCK_DOWNLOAD
        try:
            delayed = blocks.request(data)
        except SdoAbort as abort:
            self._respond(blocks.abort(abort.code))
            return
        if is_end:
            self._respond_after(delayed, blocks.finished())

    def _initiate_download(self, data: bytes) -> None:
        self._upload = self._download = None
        index, subindex = self._object = struct.unpack_from("<HB", data, 1)
        if data[0] & EXPEDITED:
            if self._segmented:
                raise SdoAbort(AbortCode.COMMAND_UNKNOWN)
            value = sdo.expedited_data(data)
            if not data[0] & SIZE_INDICATED and self._object in self._objects:
                value = value[: self._objects[self._object].size or 4]
            delayed = self._objects.download(index, subindex, value)
        else:
            entry = self._objects[self._object]
            size_indicated = data[0] & SIZE_INDICATED
            self._size = struct.unpack_from("<I", data, 4)[0] if size_indicated else None
            if self._size is not None:
                self._objects.check_length(entry, self._size)
            self._download, self._toggle = bytearray(), 0
            delayed = None
        self._respond_after(delayed, sdo.download_response(*self._object))

    def _download_segment(self, data: bytes) -> None:
        if self._download is None:
            raise SdoAbort(AbortCode.COMMAND_UNKNOWN)
        self._check_toggle(data)
        self._download += sdo.segment_data(data)
        delayed = None
        if sdo.is_last_segment(data):
            value, self._download = bytes(self._download), None
            if self._size is not None and self._size != len(value):
                raise SdoAbort(AbortCode.LENGTH_WRONG)
            delayed = self._objects.download(*self._object, value)
        self._respond_after(delayed, sdo.download_segment_response(self._toggle))
        self._toggle ^= 1

    def _respond_after(self, delayed: DelayedWrite | None, response: bytes) -> None:
        if delayed is None:
            self._respond(response)
        else:
            delayed(lambda: self._respond(response))

    def _initiate_upload(self, data: bytes) -> None:
        self._upload = self._download = None
        index, subindex = self._object = struct.unpack_from("<HB", data, 1)
        value = self._objects.upload(index, subindex)
        if self._segmented or not 1 <= len(value) <= 4:
            self._upload, self._toggle = value, 0
        self._respond(sdo.upload_response(index, subindex, value, self._segmented))

    def _upload_segment(self, data: bytes) -> None:
        if self._upload is None:
            raise SdoAbort(AbortCode.COMMAND_UNKNOWN)
        self._check_toggle(data)
        segment = self._upload[: sdo.SEGMENT_LENGTH]
        rest = self._upload[sdo.SEGMENT_LENGTH :]
        self._upload = rest or None
        self._respond(sdo.upload_segment_response(self._toggle, segment, last=not rest))
        self._toggle ^= 1

    def _check_toggle(self, data: bytes) -> None:
        if sdo.segment_toggle(data) != self._toggle:
            raise SdoAbort(AbortCode.TOGGLE_NOT_ALTERNATED)
