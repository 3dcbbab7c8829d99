"""SDO client (CiA 301) that detects two nodes with the same node id.

The SDO client counts the responses to each request.  The module ``thorvaldc.can.sdo`` describes the
SDO messages.
"""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.can import sdo
from thorvaldc.can.canopen import SDO_REQUEST, SDO_RESPONSE
from thorvaldc.can.frame import CanFrame
from thorvaldc.commissioning.bus_master import BusMaster

LONGEST_TEXT = 256
"""Length (bytes) after which the client stops reading a text."""


class SdoAborted(Exception):
    """Error: the node has aborted the SDO transfer."""

    def __init__(self, code: int) -> None:
        super().__init__(sdo.abort_text(code))
        self.code = code


class SdoTimeout(Exception):
    """Error: the node has not responded to an SDO request within the time-out."""

    def __init__(self) -> None:
        super().__init__("it does not answer")


class SdoMultipleResponses(Exception):
    """Error: more than one node has responded to an SDO request."""

    def __init__(self, count: int) -> None:
        super().__init__(f"{count} answers to one request")


@dataclass(frozen=True, slots=True)
class UploadResponse:
    """Response of a node to an SDO upload request.

    - ``data``: data bytes of the object;
    - ``abort``: abort code, or ``None`` if the node has returned data.
    """

    data: bytes = b""
    abort: int | None = None


class SdoClient:
    """Reads and writes the objects of nodes over SDO."""

    def __init__(self, master: BusMaster) -> None:
        self.master = master

    def upload_all(
        self, node: int, index: int, subindex: int, *, timeout: float
    ) -> list[UploadResponse]:
        """Sends an SDO request to read an object, and returns all responses.

        The data of an SDO response is the value of the object if the value has up to 4 bytes.  The
        data of an SDO response is the length of the object if the value is longer, such as a text.
        """
        request = sdo.upload_request(index, subindex)
        frames = self._request(node, request, timeout, self.master.timing.settle)
        return [_upload_response(frame.data) for frame in frames]

    def read_number(self, node: int, index: int, subindex: int, type_name: str) -> int:
        """Reads an object that is a number from a node.

        Raises ``SdoAborted`` if the node refuses the SDO request.  Raises ``SdoTimeout`` if no node
        responds, or ``SdoMultipleResponses`` if more than one node responds.
        """
        response = _upload_response(
            self._single_response(node, sdo.upload_request(index, subindex))
        )
        if response.abort is not None:
            raise SdoAborted(response.abort)
        return sdo.decode_number(type_name, response.data)

    def read_text(self, node: int, index: int) -> str:
        """Reads an object that is a text from a node.

        A text of more than 4 bytes is read in segments.

        Raises the same exceptions as the method ``read_number``.
        """
        response = self._single_response(node, sdo.upload_request(index, 0))
        _raise_abort(response)
        if sdo.is_expedited(response):
            return _text(sdo.expedited_data(response))
        data, toggle = b"", 0
        while len(data) < LONGEST_TEXT:
            request = sdo.upload_segment_request(toggle)
            response = self._single_response(node, request, segment=True)
            _raise_abort(response)
            data += sdo.segment_data(response)
            if sdo.is_last_segment(response):
                break
            toggle ^= 1
        return _text(data)

    def write_number(
        self,
        node: int,
        index: int,
        subindex: int,
        type_name: str,
        value: int,
        timeout: float | None = None,
    ) -> None:
        """Writes an object that is a number to a node, by an expedited SDO download.

        Raises the same exceptions as the method ``read_number``.
        """
        data = sdo.encode_number(type_name, value)
        request = sdo.download_request(index, subindex, data)
        _raise_abort(self._single_response(node, request, timeout))

    # -- inside -----------------------------------------------------------------------------

    def _single_response(
        self, node: int, request: bytes, timeout: float | None = None, segment: bool = False
    ) -> bytes:
        """Sends an SDO request and returns the response of the node.

        The SDO client does not wait for a second response to an SDO request.  A late second SDO
        response has no effect, because the response matches no later request.
        """
        frames = self._request(node, request, timeout or self.master.timing.sdo, 0.0, segment)
        if not frames:
            raise SdoTimeout
        if len(frames) > 1:
            raise SdoMultipleResponses(len(frames))
        return frames[0].data

    def _request(
        self,
        node: int,
        request: bytes,
        timeout: float,
        settle: float,
        segment: bool = False,
    ) -> list[CanFrame]:
        response_id, multiplexer = SDO_RESPONSE + node, request[1:4]

        def fits(frame: CanFrame) -> bool:
            if frame.id != response_id or len(frame.data) != 8:
                return False
            return segment or frame.data[1:4] == multiplexer

        return self.master.request(SDO_REQUEST + node, request, fits, timeout, settle)


def _upload_response(data: bytes) -> UploadResponse:
    abort = sdo.abort_code(data)
    if abort is not None:
        return UploadResponse(abort=abort)
    return UploadResponse(sdo.expedited_data(data) if sdo.is_expedited(data) else data[4:8])


def _raise_abort(response: bytes) -> None:
    abort = sdo.abort_code(response)
    if abort is not None:
        raise SdoAborted(abort)


def _text(data: bytes) -> str:
    return data.decode("latin-1").rstrip("\0")
