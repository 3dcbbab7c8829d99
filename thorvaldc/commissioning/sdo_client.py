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

LONGEST_VALUE = 256
"""Length (bytes) after which the client stops reading a value."""


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
        self.count = count


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

        The data of an SDO response is the value of the object if the node sends the value in the
        response, or if only one node responds.  Several nodes cannot send their values in segments,
        so the data is then the length of the object.
        """
        request = sdo.upload_request(index, subindex)
        frames = self._request(node, request, timeout, self.master.timing.settle)
        responses = [_upload_response(frame.data) for frame in frames]
        if len(responses) != 1 or responses[0].abort is not None:
            return responses
        try:
            return [UploadResponse(self._value(node, frames[0].data))]
        except SdoAborted as error:
            return [UploadResponse(abort=error.code)]
        except SdoTimeout:
            return [UploadResponse(abort=sdo.AbortCode.TIMED_OUT)]
        except SdoMultipleResponses as error:
            return responses * error.count

    def read_number(self, node: int, index: int, subindex: int, type_name: str) -> int:
        """Reads an object that is a number from a node.

        Raises ``SdoAborted`` if the node refuses the SDO request.  Raises ``SdoTimeout`` if no node
        responds, or ``SdoMultipleResponses`` if more than one node responds.
        """
        response = self._single_response(node, sdo.upload_request(index, subindex))
        _raise_abort(response)
        return sdo.decode_number(type_name, self._value(node, response))

    def read_text(self, node: int, index: int) -> str:
        """Reads an object that is a text from a node.

        Raises the same exceptions as the method ``read_number``.
        """
        response = self._single_response(node, sdo.upload_request(index, 0))
        _raise_abort(response)
        return self._value(node, response).decode("latin-1").rstrip("\0")

    def write_number(
        self,
        node: int,
        index: int,
        subindex: int,
        type_name: str,
        value: int,
        timeout: float | None = None,
    ) -> None:
        """Writes an object that is a number to a node.

        The number is written by an expedited SDO download.  If the node does not know this
        download, the number is written in one segment.  Raises the same exceptions as the method
        ``read_number``.
        """
        data = sdo.encode_number(type_name, value)
        request = sdo.download_request(index, subindex, data)
        response = self._single_response(node, request, timeout)
        if sdo.abort_code(response) == sdo.AbortCode.COMMAND_UNKNOWN:
            request = sdo.segmented_download_request(index, subindex, len(data))
            _raise_abort(self._single_response(node, request))
            request = sdo.last_download_segment_request(0, data)
            response = self._single_response(node, request, timeout, segment=True)
        _raise_abort(response)

    # -- inside -----------------------------------------------------------------------------

    def _value(self, node: int, response: bytes) -> bytes:
        """Returns the value of an object from the first response to an upload request.

        A node sends values of more than 4 bytes, and some nodes send all values, in segments.
        """
        if sdo.is_expedited(response):
            return sdo.expedited_data(response)
        data, toggle = b"", 0
        while len(data) < LONGEST_VALUE:
            request = sdo.upload_segment_request(toggle)
            segment = self._single_response(node, request, segment=True)
            _raise_abort(segment)
            data += sdo.segment_data(segment)
            if sdo.is_last_segment(segment):
                break
            toggle ^= 1
        return data

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
