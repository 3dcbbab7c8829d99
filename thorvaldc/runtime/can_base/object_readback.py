"""Reads object dictionary entries of a node by SDO and compares the values with the robot file."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from thorvaldc.can import sdo
from thorvaldc.can.frame import CanFrame
from thorvaldc.model.bus import ObjectValue

ANSWER_TIME = 0.1
"""Time (s) after which a request without a response is repeated."""
TRIES = 3


class ObjectReadback:
    """Reads object dictionary entries of a node one after another, and compares the values with the
    robot file.

    All object dictionary entries are numbers of up to 4 bytes.  A node sends such a number in the
    response to the upload request, or in one segment afterwards.  The comparison of the object
    dictionary ends at the first mismatch.
    The values in the object dictionary are never changed.
    """

    def __init__(self, request: int, response: int, expected: Iterable[ObjectValue]) -> None:
        """Prepares the comparison of the object dictionary entries in ``expected``.

        ``request``: COB-ID of the SDO requests to the node.  ``response``: COB-ID of the SDO
        responses of the node.
        """
        self.request = request
        self.response = response
        self.problem = ""
        """First mismatch, or the reason why an object cannot be read, or an empty text."""
        self._remaining = list(expected)[::-1]
        self._requested_at: float | None = None
        self._tries = 0
        self._next_is_segment = False
        """The node has announced the value, and sends it in a segment at the next request."""

    @property
    def finished(self) -> bool:
        return not self._remaining or bool(self.problem)

    def next_request(self, now: float) -> CanFrame | None:
        """Returns the SDO request for the next object dictionary entry.

        Returns ``None`` while an SDO response is awaited, and after the comparison has finished.
        """
        if self._next_is_segment and self._requested_at is None:
            self._requested_at = now
            return CanFrame(self.request, sdo.upload_segment_request(0))
        waiting = self._requested_at is not None and now - self._requested_at < ANSWER_TIME
        if self.finished or waiting:
            return None
        expected = self._remaining[-1]
        if self._tries >= TRIES:
            self.problem = f"no response to the SDO upload of {_label(expected)}"
            return None
        self._tries += 1
        self._requested_at = now
        self._next_is_segment = False
        return CanFrame(self.request, sdo.upload_request(expected.index, expected.subindex))

    def take_response(self, data: bytes) -> None:
        """Compares the value in an SDO response with the expected value.

        An SDO response for an object that was not requested is ignored.
        """
        if self.finished or self._requested_at is None or len(data) < 8:
            return
        expected = self._remaining[-1]
        abort_code = sdo.abort_code(data)
        is_segment = self._next_is_segment and abort_code is None
        object_key = struct.unpack_from("<HB", data, 1)
        if not is_segment and object_key != (expected.index, expected.subindex):
            return
        if abort_code is not None:
            self.problem = f"{_label(expected)} cannot be read: {sdo.abort_text(abort_code)}"
            return
        if not is_segment and not sdo.is_expedited(data):
            self._next_is_segment, self._requested_at = True, None
            return
        content = sdo.segment_data(data) if is_segment else data[4:8]
        value = sdo.decode_number(expected.type, content)
        if value != expected.value:
            self.problem = f"{_label(expected)} is {value}, but the robot file has {expected.value}"
            return
        self._remaining.pop()
        self._requested_at, self._tries, self._next_is_segment = None, 0, False


class SupervisedNode(NamedTuple):
    """A node whose objects are read again and again.

    ``request`` and ``response``: COB-IDs of the SDO requests and SDO responses.
    """

    name: str
    request: int
    response: int
    objects: tuple[ObjectValue, ...]


class ObjectSupervision:
    """Reads the required objects of all nodes of a bus again and again, one in each control cycle.

    A drive whose watchdog was changed or switched off after the start-up would not stop if the base
    driver fails.  A node that restarted without a boot-up message, a tool at another interface of
    the node, or another program on the bus can cause such a change.  ``required_objects`` states
    the time in which all objects are read.  The bus load contains one SDO exchange for each control
    cycle.
    """

    def __init__(self, nodes: Sequence[SupervisedNode]) -> None:
        self.problem = ""
        """First mismatch with the name of the node, or an empty text."""
        self._nodes = [node for node in nodes if node.objects]
        self._index = -1
        self._readback: ObjectReadback | None = None

    def next_request(self, now: float) -> CanFrame | None:
        """Returns the SDO request of the control cycle at ``now`` (s), or ``None``."""
        if not self._nodes or self.problem:
            return None
        readback = self._readback
        if readback is None or readback.finished:
            self._index = (self._index + 1) % len(self._nodes)
            node = self._nodes[self._index]
            readback = ObjectReadback(node.request, node.response, node.objects)
            self._readback = readback
        request = readback.next_request(now)
        self._take_problem()
        return request

    def take_response(self, node: str, data: bytes) -> None:
        """Compares an SDO response of ``node``, if its response is awaited."""
        if self._readback is not None and self._nodes[self._index].name == node:
            self._readback.take_response(data)
            self._take_problem()

    def _take_problem(self) -> None:
        if self._readback is not None and self._readback.problem:
            self.problem = f"{self._nodes[self._index].name}: {self._readback.problem}"


def _label(entry: ObjectValue) -> str:
    return f"{entry.name} ({entry.index:#06x}:{entry.subindex})"
