"""CAN master of the commissioning, and its SDO client.

The master sends requests, collects responses and evaluates all frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from thorvaldc.can import canopen, sdo
from thorvaldc.can.frame import NANOSECONDS, CanFrame, CanInterface, ErrorState
from thorvaldc.commissioning.bus_configuration import ParameterValue
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Bus
from thorvaldc.model.bus import MASTER
from thorvaldc.model.bus_timing import worst_case_bits

SEND_TIMEOUT = 0.1
"""Longest time (s) to wait for room in the send queue."""
LONGEST_DELAY = 2.0
"""Longest time (s) to wait for the frames of a simulated bus whose process runs late."""
LATE_STEP = 0.002
_OWN_FRAME = CanFrame(0x7FF)
"""Placeholder for a frame that this program has sent itself; no node uses the identifier 0x7FF."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Time-outs and waiting times (s) of the commissioning.

    - ``sdo``: time-out of an SDO response;
    - ``lss``: time-out of an LSS response;
    - ``fastscan``: time-out of a response in an LSS fastscan;
    - ``store``: time-out of a write to non-volatile memory;
    - ``boot``: time-out of the boot-up message after a reset;
    - ``settle``: waiting time for further responses after the first response;
    - ``absent``: waiting time to confirm that no node responds;
    - ``probe_gap``: time between two requests during the search for nodes;
    - ``probe_tail``: waiting time for late responses after the last request of the search.
    """

    sdo: float = 0.5
    lss: float = 0.1
    fastscan: float = 0.02
    store: float = 5.0
    boot: float = 5.0
    settle: float = 0.005
    absent: float = 0.1
    probe_gap: float = 0.004
    probe_tail: float = 0.25


class BusMaster:
    """CAN master that sends requests and evaluates all received CAN frames.

    All methods that wait for frames raise ``DiagnosticError`` (``bus-error``) if the CAN controller
    is not error-active or if the CAN interface is lost.  If ``exclusive`` is ``True``, a frame
    of another master also raises ``DiagnosticError`` (``bus-other-master``).
    """

    def __init__(self, interface: CanInterface, bus: Bus, timing: Timing | None = None) -> None:
        self.interface = interface
        self.bus = bus
        self.timing = timing or Timing()
        self.exclusive = False
        self.masters: dict[str, int] = {}
        """Number of frames from another master, by description of the frame."""
        self.received: dict[int, list[float]] = {}
        """Times of reception (s) of all frames, by key (``CanFrame.key``)."""
        self.states: dict[int, int] = {}
        """NMT state in the newest heartbeat, by node id."""
        self.boots: list[int] = []
        """Node ids of the received boot-up messages."""
        self.frames = 0
        self.bits = 0
        self.surplus: dict[int, int] = {}
        """Number of SDO responses without a request, by node id."""
        self._open_requests: set[int] = set()
        self._from_master: dict[int, str] = {}
        self._from_nodes: dict[int, str] = {}
        for frame in bus.frames:
            names = self._from_master if frame.producer == MASTER else self._from_nodes
            names[frame.key] = frame.name
        self._other_frames = {frame.key for frame in bus.frames if frame.kind != "sdo"}

    @property
    def now(self) -> float:
        """Current time (s) on the clock of the CAN interface."""
        return self.interface.now

    # -- sending ----------------------------------------------------------------------------

    def send(self, identifier: int, data: bytes) -> None:
        """Sends a CAN frame once, without repetition after an error.

        Raises ``DiagnosticError`` (``bus-error``) if the CAN frame cannot be sent.
        """
        self._check_state()
        try:
            sent = self.interface.send(CanFrame(identifier, data), timeout=SEND_TIMEOUT)
        except ConnectionError as error:
            raise bus_lost_error(error) from None
        self._check_state()
        if not sent:
            raise DiagnosticError(
                "bus-error",
                f"the frame {identifier:#05x} could not be sent: the queue stays full",
                hint="do the devices have power, and do they use this bitrate?",
            )

        if canopen.SDO_REQUEST < identifier <= canopen.SDO_REQUEST + canopen.HIGHEST_NODE_ID:
            self._open_requests.add(identifier - canopen.SDO_REQUEST)

    def nmt(self, command: canopen.NmtCommand, node: int) -> None:
        self.send(canopen.NMT, canopen.nmt_message(command, node))

    # -- waiting ----------------------------------------------------------------------------

    def collect(
        self, fits: Callable[[CanFrame], bool], timeout: float, settle: float | None = None
    ) -> list[CanFrame]:
        """Receives CAN frames, and returns all CAN frames for which the function ``fits`` returns
        ``True``.

        ``collect`` waits at most ``timeout`` seconds, and at most ``settle`` seconds after the
        first CAN frame for which ``fits`` returns ``True``.  If ``settle`` is ``None``, ``collect``
        always waits ``timeout`` seconds to receive late responses.

        ``timeout`` counts on the clock of the bus.  On a busy computer the process of a simulated
        bus can run late; only when it has told all frames of that time, there is no response.
        """
        frames: list[CanFrame] = []
        limit = self.now + timeout
        while True:
            frame = self._next(limit - self.now)
            if frame is None and not frames and self._is_late(limit):
                frame = self._next(LATE_STEP)
                if frame is None:
                    continue
            if frame is None:
                return frames
            if fits(frame):
                if not frames and settle is not None:
                    limit = min(limit, self.now + settle)
                frames.append(frame)

    def request(
        self,
        identifier: int,
        data: bytes,
        fits: Callable[[CanFrame], bool],
        timeout: float,
        settle: float | None,
    ) -> list[CanFrame]:
        """Sends a CAN frame with a request and returns all response frames.

        The method ``collect`` describes the parameters.
        """
        self._drain()
        self.send(identifier, data)
        return self.collect(fits, timeout, settle)

    def listen(self, seconds: float) -> None:
        """Receives CAN frames for ``seconds`` without sending."""
        limit = self.now + seconds
        while self._next(limit - self.now) is not None:
            pass

    def wait_for_boots(self, ids: list[int], timeout: float) -> list[int]:
        """Waits for the boot-up messages of the node ids in ``ids``.

        Returns the node ids whose boot-up messages did not arrive within ``timeout`` seconds.
        """
        missing = list(ids)
        limit = self.now + timeout
        while missing:
            for node in self.boots:
                if node in missing:
                    missing.remove(node)
            self.boots.clear()
            if not missing or self._next(limit - self.now) is None:
                break
        return missing

    def wait_for_count(self, count: int, timeout: float) -> None:
        """Waits until ``count`` boot-up messages of any nodes were received, but at most
        ``timeout`` seconds."""
        limit = self.now + timeout
        while len(self.boots) < count and self._next(limit - self.now) is not None:
            pass

    def forget(self) -> None:
        """Deletes all stored information about received CAN frames, and clears the receive
        queue."""
        self._drain()
        self.received.clear()
        self.states.clear()
        self.boots.clear()
        self.masters.clear()
        self.surplus.clear()

    # -- inside -----------------------------------------------------------------------------

    def _next(self, timeout: float) -> CanFrame | None:
        try:
            received = self.interface.receive(max(timeout, 0.0))
        except ConnectionError as error:
            raise bus_lost_error(error) from None
        self._check_state()
        if received is None:
            return None
        if received.own:
            return _OWN_FRAME
        self._evaluate(received.frame, received.time / NANOSECONDS)
        return received.frame

    def _is_late(self, time: float) -> bool:
        """Returns whether frames on the bus until ``time`` (s) may not have arrived yet."""
        is_known = self.interface.received_until > time - 1e-6
        return not is_known and self.now < time + LONGEST_DELAY

    def _drain(self) -> None:
        while self._next(0.0) is not None:
            pass

    def _evaluate(self, frame: CanFrame, time: float) -> None:
        self.frames += 1
        self.bits += worst_case_bits(frame.length, frame.extended)
        key = frame.key
        self.received.setdefault(key, []).append(time)
        if (
            canopen.HEARTBEAT < key <= canopen.HEARTBEAT + canopen.HIGHEST_NODE_ID
            and len(frame.data) == 1
        ):
            node = key - canopen.HEARTBEAT
            self.states[node] = canopen.heartbeat_state(frame.data)
            if frame.data[0] == canopen.NmtState.INITIALISING:
                self.boots.append(node)
        elif canopen.SDO_RESPONSE < key <= canopen.SDO_RESPONSE + canopen.HIGHEST_NODE_ID:
            node = key - canopen.SDO_RESPONSE
            if node not in self._open_requests and key not in self._other_frames:
                self.surplus[node] = self.surplus.get(node, 0) + 1
            self._open_requests.discard(node)
        sign = self._sign_of_master(frame)
        if sign:
            self.masters[sign] = self.masters.get(sign, 0) + 1
            if self.exclusive:
                raise other_master_error([sign])

    def _sign_of_master(self, frame: CanFrame) -> str:
        """Returns a description if the CAN frame can only come from a CANopen master, else an empty
        text."""
        identifier = frame.key
        if identifier in self._from_nodes:
            return ""
        if identifier in self._from_master:
            return self._from_master[identifier]
        if identifier in (canopen.NMT, canopen.SYNC, canopen.TIME_STAMP, canopen.LSS_REQUEST):
            return f"{identifier:#05x}"
        if canopen.SDO_REQUEST < identifier <= canopen.SDO_REQUEST + canopen.HIGHEST_NODE_ID:
            return f"an SDO request to node {identifier - canopen.SDO_REQUEST}"
        if identifier == canopen.HEARTBEAT + self.bus.master_id:
            return "a master's heartbeat"
        return ""

    def _check_state(self) -> None:
        state = self.interface.state
        if state is not ErrorState.ACTIVE:
            raise DiagnosticError(
                "bus-error",
                f"the interface is {state.value}: frames do not reach the devices",
                hint="do the devices have power, is the bus terminated, and do all devices use "
                f"{self.bus.bitrate // 1000} kbit/s? Nothing was sent again",
            )


def bus_lost_error(error: ConnectionError) -> DiagnosticError:
    return DiagnosticError(
        "bus-error",
        f"the interface is lost: {error}",
        hint="nothing more was sent; check the bus and the adapter",
    )


def other_master_error(signs: list[str]) -> DiagnosticError:
    return DiagnosticError(
        "bus-other-master",
        f"another master is on the bus: it sent {', '.join(signs)}",
        hint="stop the driver, or any other program that uses the bus, and start again",
    )


# -- SDO client ------------------------------------------------------------------------------------

# The SDO client counts the responses to each request.  The module ``thorvaldc.can.sdo`` describes
# the SDO messages.

LONGEST_VALUE = 256
"""Length (bytes) after which the client stops reading a value."""


class SdoError(Exception):
    """Error of an SDO transfer, which one of the derived classes names."""


class SdoAborted(SdoError):
    """Error: the node has aborted the SDO transfer."""

    def __init__(self, code: int) -> None:
        super().__init__(sdo.abort_text(code))
        self.code = code


class SdoTimeout(SdoError):
    """Error: the node has not responded to an SDO request within the time-out."""

    def __init__(self) -> None:
        super().__init__("it does not answer")


class SdoMultipleResponses(SdoError):
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

    def read_values(
        self, node: int, values: Sequence[ParameterValue], ignored: type[SdoError] = SdoAborted
    ) -> dict[tuple[int, int], int | None]:
        """Reads the present values of the objects in ``values`` from a node.

        The value is ``None`` after an error of the type ``ignored``, by default if the node refuses
        to read the object.  Raises other errors as the method ``read_number``.
        """
        present: dict[tuple[int, int], int | None] = {}
        for value in values:
            try:
                present[value.key] = self.read_number(node, *value.key, value.type)
            except ignored:
                present[value.key] = None
        return present

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
        response_id, multiplexer = canopen.SDO_RESPONSE + node, request[1:4]

        def fits(frame: CanFrame) -> bool:
            if frame.key != response_id or len(frame.data) != 8:
                return False
            return segment or frame.data[1:4] == multiplexer

        return self.master.request(canopen.SDO_REQUEST + node, request, fits, timeout, settle)


def _upload_response(data: bytes) -> UploadResponse:
    abort = sdo.abort_code(data)
    if abort is not None:
        return UploadResponse(abort=abort)
    return UploadResponse(sdo.expedited_data(data) if sdo.is_expedited(data) else data[4:8])


def _raise_abort(response: bytes) -> None:
    abort = sdo.abort_code(response)
    if abort is not None:
        raise SdoAborted(abort)
