"""Reads object dictionary entries of a node by SDO and compares the values with the robot file."""

from __future__ import annotations

import struct
from collections.abc import Iterable

from thorvaldc.can import sdo
from thorvaldc.can.frame import CanFrame
from thorvaldc.model.bus import ObjectValue

ANSWER_TIME = 0.1
"""Time (s) after which a request without a response is repeated."""
TRIES = 3


class ObjectReadback:
    """Reads object dictionary entries of a node one after another, and compares the values with the
    robot file.

    All object dictionary entries are numbers of up to 4 bytes, so each entry is read with one
    expedited SDO transfer.  The comparison of the object dictionary ends at the first mismatch.
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

    @property
    def finished(self) -> bool:
        return not self._remaining or bool(self.problem)

    def next_request(self, now: float) -> CanFrame | None:
        """Returns the SDO request for the next object dictionary entry.

        Returns ``None`` while an SDO response is awaited, and after the comparison has finished.
        """
        waiting = self._requested_at is not None and now - self._requested_at < ANSWER_TIME
        if self.finished or waiting:
            return None
        expected = self._remaining[-1]
        if self._tries >= TRIES:
            self.problem = f"no response to the SDO upload of {_label(expected)}"
            return None
        self._tries += 1
        self._requested_at = now
        return CanFrame(self.request, sdo.upload_request(expected.index, expected.subindex))

    def take_response(self, data: bytes) -> None:
        """Compares the value in an SDO response with the expected value.

        An SDO response for an object that was not requested is ignored.
        """
        if self.finished or self._requested_at is None or len(data) < 8:
            return
        expected = self._remaining[-1]
        if struct.unpack_from("<HB", data, 1) != (expected.index, expected.subindex):
            return
        abort_code = sdo.abort_code(data)
        if abort_code is not None:
            self.problem = f"{_label(expected)} cannot be read: {sdo.abort_text(abort_code)}"
            return
        value = sdo.decode_number(expected.type, data[4:8])
        if value != expected.value:
            self.problem = f"{_label(expected)} is {value}, but the robot file has {expected.value}"
            return
        self._remaining.pop()
        self._requested_at, self._tries = None, 0


def _label(entry: ObjectValue) -> str:
    return f"{entry.name} ({entry.index:#06x}:{entry.subindex})"
