"""The servers of a simulated CANopen device: SDO (CiA 301), also in blocks, and LSS (CiA 305)."""

from __future__ import annotations

import binascii
import struct
from collections.abc import Callable

from thorvaldc.can import lss, sdo
from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.can.sdo import SEGMENT_LENGTH, AbortCode, ClientCommand
from thorvaldc.simulation.bus.object_dictionary import DelayedWrite, ObjectDictionary, SdoAbort

# -- block transfers -------------------------------------------------------------------------------

# A block transfer moves up to 127 segments of 7 bytes without a response to each of them:
#
#     upload    client   A4 index sub blksize pst          server   C6 index sub size (u32)
#               client   A3                                server   01 .. 02 .. 83 ..     segments
#               client   A2 ackseq blksize                 server   C1 | n << 2, crc (u16)
#               client   A1
#     download  client   C6 index sub size (u32)           server   A4 index sub blksize
#               client   01 .. 02 .. 83 ..     segments    server   A2 ackseq blksize
#               client   C1 | n << 2, crc (u16)            server   A1
#
# Bit 7 of the first byte of a segment marks the last segment, the other bits are its number from 1.
# ``n`` is the number of unused bytes in the last segment.  The CRC is that of CCITT with the start
# value 0.

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
        self._respond(
            sdo.HEADER.pack(command, *self._object) + struct.pack("<I", len(self._upload))
        )

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
        self._respond(sdo.HEADER.pack(command, *self._object) + bytes([BLOCK_SIZE, 0, 0, 0]))

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
        if data[0] & sdo.EXPEDITED:
            if self._segmented:
                raise SdoAbort(AbortCode.COMMAND_UNKNOWN)
            value = sdo.expedited_data(data)
            if not data[0] & sdo.SIZE_INDICATED and self._object in self._objects:
                value = value[: self._objects[self._object].size or 4]
            delayed = self._objects.download(index, subindex, value)
        else:
            entry = self._objects[self._object]
            size_indicated = data[0] & sdo.SIZE_INDICATED
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
        segment = self._upload[:SEGMENT_LENGTH]
        rest = self._upload[SEGMENT_LENGTH:]
        self._upload = rest or None
        self._respond(sdo.upload_segment_response(self._toggle, segment, last=not rest))
        self._toggle ^= 1

    def _check_toggle(self, data: bytes) -> None:
        if sdo.segment_toggle(data) != self._toggle:
            raise SdoAbort(AbortCode.TOGGLE_NOT_ALTERNATED)


# -- LSS slave -------------------------------------------------------------------------------------

# An LSS master finds a device by its identity and sets the node id and the bitrate of the device.
#
#     WAITING  --(switch state selective: all four parts of the identity match)-->  CONFIGURATION
#     WAITING  --(fastscan: the last bit of the last part matches)---------------->  CONFIGURATION
#     any      --(switch state global)--------------------------------->  WAITING or CONFIGURATION
#
# An LSS slave accepts configuration services (node id, bit timing, store, inquire) only in the
# state CONFIGURATION.  A node id that the LSS master sets is pending at first.  A device without a
# node id applies the pending node id when it leaves the state CONFIGURATION.  A device with a node
# id applies the pending node id after a reset of the communication.
#
# The service fastscan finds an LSS slave with an unknown identity, bit by bit.  The module
# ``lss_master`` describes the requests of the service fastscan.

_SELECTING = {lss.SWITCH_STATE_SELECTIVE[-1]: lss.SELECTED, lss.FASTSCAN: lss.SLAVE_IDENTIFIED}
"""Requests that select a slave in the state WAITING, with their responses."""


class LssSlave:
    """The LSS services of one simulated device.

    Functions of the device that the LSS slave calls:

    - ``set_id(id)`` sets the pending node id, 1..127 or 255.
    - ``set_bitrate(bit/s)`` sets the pending bitrate, and returns ``False`` for an unsupported
      bitrate.
    - ``activate(delay)`` changes to the pending bitrate after ``delay`` s.
    - ``store(done)`` stores the pending values and then calls ``done(code)``, with the code 0 for
      success.
    - ``left()`` handles the end of the state CONFIGURATION.

    If ``responds_when_selected`` is true, the slave responds in the state CONFIGURATION to every
    fastscan request and to the last request of every selective switch, as CANopenNode does.
    """

    def __init__(
        self,
        identity: Identity,
        respond: Callable[[bytes], None],
        node_id: Callable[[], int],
        *,
        set_id: Callable[[int], None],
        set_bitrate: Callable[[int], bool],
        activate: Callable[[float], None],
        store: Callable[[Callable[[int], None]], None],
        left: Callable[[], None],
        responds_when_selected: bool = False,
    ) -> None:
        self.identity = identity
        self.configuring = False
        self._respond = respond
        self._node_id = node_id
        self._set_id = set_id
        self._set_bitrate = set_bitrate
        self._activate = activate
        self._store = store
        self._left = left
        self._responds_when_selected = responds_when_selected
        # Each LSS service counts the parts of the device identity that have matched.
        self._selected = 0
        self._identified = 0
        self._scanned = 0

    def request(self, data: bytes) -> None:
        """Handles a received LSS request of 8 bytes.

        The LSS slave does not answer a message with another length.
        """
        if len(data) != 8:
            return
        command = data[0]
        number: int = struct.unpack_from("<I", data, 1)[0]
        if command == lss.SWITCH_STATE_GLOBAL:
            self._switch(data[1] == lss.CONFIGURATION)
        elif self.configuring and self._responds_when_selected and command in _SELECTING:
            self._answer(_SELECTING[command])
        elif command in lss.SWITCH_STATE_SELECTIVE:
            self._select(lss.SWITCH_STATE_SELECTIVE.index(command), number)
        elif command in lss.IDENTIFY_REMOTE_SLAVE:
            self._identify(lss.IDENTIFY_REMOTE_SLAVE.index(command), number)
        elif command == lss.IDENTIFY_NON_CONFIGURED:
            if self._node_id() == UNCONFIGURED:
                self._answer(lss.NON_CONFIGURED_IDENTIFIED)
        elif command == lss.FASTSCAN:
            self._fastscan(number, data[5], data[6], data[7])
        elif self.configuring:
            self._configure(command, data)

    def _switch(self, configure: bool) -> None:
        was_configuring, self.configuring = self.configuring, configure
        self._selected = 0
        if was_configuring and not configure:
            self._left()

    def _select(self, part: int, number: int) -> None:
        """Handles one of the four requests of the service "switch state selective".

        Each of the four requests contains one part of the device identity.
        """
        if part == 0:
            self._selected = 0
        if part != self._selected or number != self.identity[part]:
            self._selected = 0
            return
        self._selected += 1
        if self._selected == 4:
            self._selected = 0
            self.configuring = True
            self._answer(lss.SELECTED)

    def _identify(self, part: int, number: int) -> None:
        """Handles one of the six requests of the service "identify remote slave".

        The six requests contain the vendor id, the product code, the lowest and the highest
        revision number, and the lowest and the highest serial number.
        """
        if part == 0:
            self._identified = 0
        vendor, product, revision, serial = self.identity
        fits = (
            number == vendor,
            number == product,
            number <= revision,
            number >= revision,
            number <= serial,
            number >= serial,
        )[part]
        if part != self._identified or not fits:
            self._identified = 0
            return
        self._identified += 1
        if self._identified == 6:
            self._identified = 0
            self._answer(lss.SLAVE_IDENTIFIED)

    def _fastscan(self, number: int, bit: int, part: int, following: int) -> None:
        """Handles a request of the service fastscan.

        The LSS slave answers if bits 31 to ``bit`` of one part of the device identity are equal to
        the same bits of ``number``.  ``part`` is the index of the part of the device identity.
        Only an LSS slave without a node id in the state WAITING answers.  ``following`` is the
        index of the part of the device identity that the LSS master scans next.  The scan of the
        device identity is complete if ``following`` is lower than ``part``.
        """
        if self._node_id() != UNCONFIGURED or self.configuring:
            return
        if bit == lss.FASTSCAN_START:
            self._scanned = 0
            self._answer(lss.SLAVE_IDENTIFIED)
            return
        if bit > 31 or part > 3 or part != self._scanned:
            return
        if number >> bit != self.identity[part] >> bit:
            return
        self._answer(lss.SLAVE_IDENTIFIED)
        if bit == 0:
            if following < part:  # the last part matches too: the scan has found this slave
                self.configuring = True
            self._scanned = following & 3

    def _configure(self, command: int, data: bytes) -> None:
        if command == lss.CONFIGURE_NODE_ID:
            valid = 1 <= data[1] <= 127 or data[1] == UNCONFIGURED
            if valid:
                self._set_id(data[1])
            self._answer(command, 0 if valid else 1)
        elif command == lss.CONFIGURE_BIT_TIMING:
            rate = lss.BITRATES.get(data[2]) if data[1] == 0 else None
            supported = rate is not None and self._set_bitrate(rate)
            self._answer(command, 0 if supported else 1)
        elif command == lss.ACTIVATE_BIT_TIMING:
            self._activate(struct.unpack_from("<H", data, 1)[0] / 1000.0)
        elif command == lss.STORE_CONFIGURATION:
            self._store(lambda code: self._answer(command, code))
        elif command in lss.INQUIRE_IDENTITY:
            number = self.identity[lss.INQUIRE_IDENTITY.index(command)]
            self._respond(struct.pack("<BI3x", command, number))
        elif command == lss.INQUIRE_NODE_ID:
            self._answer(command, self._node_id())

    def _answer(self, command: int, value: int = 0) -> None:
        self._respond(bytes([command, value, 0, 0, 0, 0, 0, 0]))
