"""An LSS master (layer setting services, CiA 305) that counts the responses.

Set the id of a device whose identity is known (all requests 0x7E5, all responses 0x7E4):

    master                                     slave
    04 00  switch all to WAITING      ----->   (no response)
    40 vendor, 41 product, 42 revision, 43 serial
                                      ----->   44 only the slave with this identity
    11 id  configure node id          ----->   11 00
    17     store                      ----->   17 00    after the write to its memory
    04 00  switch all to WAITING      ----->   a first id takes effect now

Fastscan finds the identity of a device without an id.  Every slave whose bits match so far
answers, so a missing answer means that the bit is 1 for all that are left.  For each of the four
parts, from bit 31 to bit 0:

    51 number, bit, part, part        ----->   4F  some identity has 0 at this bit: keep it
                                      ----->   --  no identity has 0: set this bit in ``number``
    51 number, 0, part, next part     ----->   4F  confirms the part; the slaves go to ``next part``

After the confirmation of the last part (its ``next part`` is 0), exactly one slave is left, in the
CONFIGURATION state: identities are unique.  132 requests: 4 x (32 + 1); one more starts the scan.
"""

from __future__ import annotations

import struct

from thorvaldc.can import lss
from thorvaldc.can.frame import CanFrame
from thorvaldc.can.lss import Identity
from thorvaldc.commissioning.bus_master import BusMaster


class LssError(Exception):
    """A slave did not answer, several answered, or one refused; the message states which."""


class LssMaster:
    """At most one slave is in the configuration state; ``switch_to_waiting`` ends it for all."""

    def __init__(self, master: BusMaster) -> None:
        self.master = master

    def switch_to_waiting(self) -> None:
        """Switches all slaves to the waiting state; there is no response."""
        self._send(bytes([lss.SWITCH_STATE_GLOBAL, lss.WAITING]))

    def select(self, identity: Identity) -> int:
        """Returns how many slaves with this identity enter the configuration state."""
        for command, number in zip(lss.SWITCH_STATE_SELECTIVE, identity, strict=True):
            request = struct.pack("<BI", command, number)
            if command == lss.SWITCH_STATE_SELECTIVE[-1]:
                return len(self._request(request, lss.SELECTED, self.master.timing.settle))
            self._send(request)
        return 0

    def node_id(self) -> int:
        """Reads the active id of the selected slave; 255: none.  Raises ``LssError``."""
        return self._single_response(bytes([lss.INQUIRE_NODE_ID]))[1]

    def configure_id(self, node_id: int) -> None:
        """Sets the pending id.  Raises ``LssError``."""
        response = self._single_response(bytes([lss.CONFIGURE_NODE_ID, node_id]))
        if response[1]:
            raise LssError(f"it refuses the id {node_id} (code {response[1]})")

    def store(self) -> None:
        """Stores the pending id.  Raises ``LssError``."""
        response = self._single_response(bytes([lss.STORE_CONFIGURATION]), self.master.timing.store)
        if response[1] == 1:
            raise LssError("it cannot store its id")
        if response[1]:
            raise LssError(f"storing its id failed (code {response[1]})")

    def has_unconfigured_slave(self) -> bool:
        """Whether a slave without an id is in the waiting state; also starts a fastscan."""
        return self._fastscan_request(0, lss.FASTSCAN_START, 0, 0)

    def fastscan(self) -> Identity | None:
        """Finds a slave without an id, and leaves it in the configuration state.

        ``None``: there is none.  Raises ``LssError`` if the responses contradict each other.
        Each request waits its full time-out: a late response would count for the next one.
        """
        if not self.has_unconfigured_slave():
            return None
        numbers = []
        for part in range(4):
            number = 0
            for bit in range(31, -1, -1):
                if not self._fastscan_request(number, bit, part, part):
                    number |= 1 << bit
            if not self._fastscan_request(number, 0, part, (part + 1) % 4):
                raise LssError("a device without id does not confirm its identity")
            numbers.append(number)
        return Identity(*numbers)

    # -- inside -----------------------------------------------------------------------------

    def _fastscan_request(self, number: int, bit: int, part: int, next_part: int) -> bool:
        request = struct.pack("<BIBBB", lss.FASTSCAN, number, bit, part, next_part)
        timeout = self.master.timing.fastscan
        return bool(self._request(request, lss.SLAVE_IDENTIFIED, None, timeout))

    def _single_response(self, request: bytes, timeout: float | None = None) -> bytes:
        frames = self._request(request, request[0], self.master.timing.settle, timeout)
        if not frames:
            raise LssError("it does not answer")
        if len(frames) > 1:
            raise LssError(f"{len(frames)} devices answer")
        return frames[0].data

    def _request(
        self, request: bytes, response: int, settle: float | None, timeout: float | None = None
    ) -> list[CanFrame]:
        """Returns all responses; ``response`` is their command specifier."""

        def fits(frame: CanFrame) -> bool:
            return frame.id == lss.RESPONSE and len(frame.data) == 8 and frame.data[0] == response

        limit = timeout or self.master.timing.lss
        return self.master.request(lss.REQUEST, request.ljust(8, b"\0"), fits, limit, settle)

    def _send(self, request: bytes) -> None:
        self.master.send(lss.REQUEST, request.ljust(8, b"\0"))
