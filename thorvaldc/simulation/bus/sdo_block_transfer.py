"""Block transfers of a simulated SDO server (CiA 301).

A block transfer moves up to 127 segments of 7 bytes without a response to each of them:

    upload    client   A4 index sub blksize pst          server   C6 index sub size (u32)
              client   A3                                server   01 .. 02 .. 83 ..     segments
              client   A2 ackseq blksize                 server   C1 | n << 2, crc (u16)
              client   A1
    download  client   C6 index sub size (u32)           server   A4 index sub blksize
              client   01 .. 02 .. 83 ..     segments    server   A2 ackseq blksize
              client   C1 | n << 2, crc (u16)            server   A1

Bit 7 of the first byte of a segment marks the last segment, the other bits are its number from 1.
``n`` is the number of unused bytes in the last segment.  The CRC is that of CCITT with the start
value 0.
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Callable

from thorvaldc.can import sdo
from thorvaldc.can.sdo import HEADER, SEGMENT_LENGTH, AbortCode
from thorvaldc.simulation.bus.object_dictionary import DelayedWrite, ObjectDictionary, SdoAbort

BLOCK_DOWNLOAD, BLOCK_UPLOAD = 6, 5
"""Command specifiers of the client."""
BLOCK_SIZE = 16
"""Number of segments of a block that the server accepts, fewer than its send queue holds."""
_CRC, _SIZE = 0x04, 0x02
_LAST = 0x80


class BlockTransfer:
    """One block transfer of a client at a time.

    - ``respond``: function that sends a response to the client.
    - ``download_pending``: ``True`` while the next message of the client is a segment.
    """

    def __init__(self, objects: ObjectDictionary, respond: Callable[[bytes], None]) -> None:
        self._objects = objects
        self._respond = respond
        self._object = (0, 0)
        self._upload = b""
        self._sent = 0
        """Number of bytes that the client has acknowledged."""
        self._block_size = BLOCK_SIZE
        self._download = bytearray()
        self._next_segment = 1
        self.download_pending = False

    def end(self) -> None:
        """Ends an unfinished transfer."""
        self.download_pending = False
        self._upload, self._download = b"", bytearray()

    def request(self, data: bytes) -> DelayedWrite | None:
        """Handles a message of the client that is not a segment.

        Returns the function that writes the value of a finished download, if the write takes time.
        Raises ``SdoAbort``.
        """
        command, subcommand = data[0] >> 5, data[0] & 3
        if command == BLOCK_DOWNLOAD and subcommand == 1:
            return self._end_download(data)
        if command == BLOCK_DOWNLOAD:
            self._start_download(data)
        elif subcommand == 0:
            self._start_upload(data)
        elif subcommand == 3:
            self._send_block()
        elif subcommand == 2:
            self._acknowledged(data)
        else:
            self.end()
        return None

    # -- upload --------------------------------------------------------------------------------

    def _start_upload(self, data: bytes) -> None:
        self.end()
        self._object = struct.unpack_from("<HB", data, 1)
        self._set_block_size(data[4])
        self._upload, self._sent = self._objects.upload(*self._object), 0
        command = BLOCK_DOWNLOAD << 5 | _CRC | _SIZE
        self._respond(HEADER.pack(command, *self._object) + struct.pack("<I", len(self._upload)))

    def _set_block_size(self, size: int) -> None:
        if not 1 <= size <= 127:
            raise SdoAbort(AbortCode.COMMAND_UNKNOWN)
        self._block_size = size

    def _send_block(self) -> None:
        rest = self._upload[self._sent :]
        count = max(-(-len(rest) // SEGMENT_LENGTH), 1)
        for number in range(1, min(count, self._block_size) + 1):
            part = rest[SEGMENT_LENGTH * (number - 1) : SEGMENT_LENGTH * number]
            last = _LAST if number == count else 0
            self._respond(bytes([last | number]) + part.ljust(SEGMENT_LENGTH, b"\0"))

    def _acknowledged(self, data: bytes) -> None:
        self._sent += SEGMENT_LENGTH * data[1]
        self._set_block_size(data[2])
        if self._sent < len(self._upload):
            self._send_block()
            return
        unused = -len(self._upload) % SEGMENT_LENGTH
        crc = binascii.crc_hqx(self._upload, 0)
        command = BLOCK_DOWNLOAD << 5 | unused << 2 | 1
        self._respond(struct.pack("<BH", command, crc) + bytes(5))

    # -- download ------------------------------------------------------------------------------

    def _start_download(self, data: bytes) -> None:
        self.end()
        self._object = struct.unpack_from("<HB", data, 1)
        entry = self._objects[self._object]
        if data[0] & _SIZE:
            self._objects.check_length(entry, struct.unpack_from("<I", data, 4)[0])
        self._next_segment, self.download_pending = 1, True
        command = BLOCK_UPLOAD << 5 | _CRC
        self._respond(HEADER.pack(command, *self._object) + bytes([BLOCK_SIZE, 0, 0, 0]))

    def segment(self, data: bytes) -> None:
        """Handles a segment of a download.

        A segment whose number is not the next one is lost, and the client sends it again.
        """
        number = data[0] & 0x7F
        in_order = number == self._next_segment
        if in_order:
            self._download += data[1:]
            self._next_segment += 1
        is_last = bool(data[0] & _LAST)
        if is_last or number >= BLOCK_SIZE:
            self.download_pending = not (is_last and in_order)
            acknowledged, self._next_segment = self._next_segment - 1, 1
            self._respond(bytes([BLOCK_UPLOAD << 5 | 2, acknowledged, BLOCK_SIZE]) + bytes(5))

    def _end_download(self, data: bytes) -> DelayedWrite | None:
        unused, crc = data[0] >> 2 & 7, struct.unpack_from("<H", data, 1)[0]
        value = bytes(self._download[: len(self._download) - unused])
        self.end()
        if binascii.crc_hqx(value, 0) != crc:
            raise SdoAbort(AbortCode.CRC_WRONG)
        return self._objects.download(*self._object, value)

    def finished(self) -> bytes:
        """Returns the response to the end of a download."""
        return bytes([BLOCK_UPLOAD << 5 | 1]) + bytes(7)

    def abort(self, code: int) -> bytes:
        """Ends the transfer and returns the abort message."""
        self.end()
        return sdo.abort_message(*self._object, code)
