"""LSS master (layer setting services, CiA 305), which sets the node ids of devices.

The COB-ID of all LSS requests is 0x7E5, and the COB-ID of all LSS responses is 0x7E4.  The LSS
master counts the responses to detect two devices with the same identity.  LSS messages that set the
node id of a device with a known identity:

    master                                     slave
    04 00  switch all to WAITING      ----->   (no response)
    40 vendor, 41 product, 42 revision, 43 serial
                                      ----->   44 only the slave with this identity
    11 id  configure node id          ----->   11 00
    17     store                      ----->   17 00    after the write to its memory
    04 00  switch all to WAITING      ----->   a first id takes effect now

An LSS fastscan finds the identity of a device without node id.  A fastscan request contains the
known bits of the identity and the position of the bit to check.  In the fastscan request the bit to
check is 0.  All LSS slaves whose identities match the bits of a fastscan request respond.  If no
LSS slave responds to a fastscan request, the checked bit of the identity is 1.  Fastscan messages
for each of the four numbers of the identity, from bit 31 to bit 0:

    51 number, bit, part, part        ----->   4F  some identity has 0 at this bit: keep it
                                      ----->   --  no identity has 0: set this bit in ``number``
    51 number, 0, part, next part     ----->   4F  confirms the part; the slaves go to ``next part``

Exactly one LSS slave is in the CONFIGURATION state after the fastscan, because identities are
unique.  In the last confirmation request of a fastscan the field ``next part`` is 0.  An LSS
fastscan needs one request to start and 4 x (32 + 1) = 132 further requests.
"""

from __future__ import annotations

import struct

from thorvaldc.can import lss
from thorvaldc.can.frame import CanFrame
from thorvaldc.can.lss import Identity
from thorvaldc.commissioning.bus_master import BusMaster


class LssError(Exception):
    """Error: an LSS request has no response, more than one response, or was refused."""


class LssMaster:
    """LSS master that sets and reads node ids with the layer setting services (LSS).

    At most one LSS slave may be in the configuration state at a time.  ``switch_to_waiting`` ends
    the configuration state of all slaves.
    """

    def __init__(self, master: BusMaster) -> None:
        self.master = master

    def switch_to_waiting(self) -> None:
        """Switches all LSS slaves to the waiting state.

        LSS slaves do not respond to this request.
        """
        self._send(bytes([lss.SWITCH_STATE_GLOBAL, lss.WAITING]))

    def select(self, identity: Identity) -> int:
        """Switches the LSS slaves with the given identity to the configuration state.

        Returns the number of LSS slaves that respond.
        """
        for command, number in zip(lss.SWITCH_STATE_SELECTIVE, identity, strict=True):
            request = struct.pack("<BI", command, number)
            if command == lss.SWITCH_STATE_SELECTIVE[-1]:
                return len(self._request(request, lss.SELECTED, self.master.timing.settle))
            self._send(request)
        return 0

    def node_id(self) -> int:
        """Returns the active node id of the selected LSS slave.

        The node id 255 means that the slave has no node id.

        Raises ``LssError`` if no LSS slave or more than one LSS slave responds.
        """
        return self._single_response(bytes([lss.INQUIRE_NODE_ID]))[1]

    def configure_id(self, node_id: int) -> None:
        """Sets the pending node id of the selected LSS slave.

        Raises ``LssError`` if the LSS slave refuses the node id, or if no slave or more than one
        slave responds.
        """
        response = self._single_response(bytes([lss.CONFIGURE_NODE_ID, node_id]))
        if response[1]:
            raise LssError(f"it refuses the id {node_id} (code {response[1]})")

    def store(self) -> None:
        """Stores the pending node id of the selected LSS slave in non-volatile memory.

        Raises ``LssError`` if the LSS slave cannot store the node id, or if no slave or more than
        one slave responds.
        """
        response = self._single_response(bytes([lss.STORE_CONFIGURATION]), self.master.timing.store)
        if response[1] == 1:
            raise LssError("it cannot store its id")
        if response[1]:
            raise LssError(f"storing its id failed (code {response[1]})")

    def has_unconfigured_slave(self) -> bool:
        """Starts an LSS fastscan.  Returns ``True`` if an LSS slave without node id responds."""
        return self._fastscan_request(0, lss.FASTSCAN_START, 0, 0)

    def fastscan(self) -> Identity | None:
        """Returns the identity of an LSS slave without node id, or ``None`` if all slaves have a
        node id.

        The LSS slave found by the fastscan stays in the configuration state.  Raises ``LssError``
        if the responses of the LSS slaves contradict each other.  Each LSS request waits for the
        full time-out, because a late response would be counted as a response to the next request.
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
        """Sends an LSS request and returns all responses.

        ``response``: command specifier of the expected LSS responses.
        """

        def fits(frame: CanFrame) -> bool:
            return frame.id == lss.RESPONSE and len(frame.data) == 8 and frame.data[0] == response

        limit = timeout or self.master.timing.lss
        return self.master.request(lss.REQUEST, request.ljust(8, b"\0"), fits, limit, settle)

    def _send(self, request: bytes) -> None:
        self.master.send(lss.REQUEST, request.ljust(8, b"\0"))
