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

An LSS fastscan finds the identities of devices without node id.  A fastscan request contains the
index of a part of the identity (0 to 3), a number, and the position of its lowest valid bit.  All
LSS slaves respond whose part of the identity begins with the same bits as the number:

    51 0, 80h, 0, 0                   ----->   4F  some slave has no node id; all are at part 0
    51 number, bit, part, part        ----->   4F  some identity begins with these bits
                                      ----->   --  no identity begins with these bits
    51 number, 0, part, part + 1      ----->   4F  the slaves with this number go to the next part

The master searches the binary tree of the numbers of one part, and then the tree of the next part
for each number that it has found.  If no identity continues with the bit 0, an identity continues
with the bit 1.  The master does not ask for identities that it knows already.  Each unknown
identity needs 1 or 2 requests for each of its 128 bits.

The standard fastscan ends with a request that switches the slave that was found to the
CONFIGURATION state, in which it shall not respond to further fastscan requests.  The search does
not use this request, because a slave of CANopenNode in the CONFIGURATION state responds to every
fastscan request, whatever the number.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from itertools import islice

from thorvaldc.can import lss
from thorvaldc.can.canopen import LSS_REQUEST, LSS_RESPONSE
from thorvaldc.can.frame import CanFrame
from thorvaldc.can.lss import Identity
from thorvaldc.commissioning.bus_master import BusMaster

LAST_PART = 3
"""Index of the last part of the identity, the serial number."""
MAXIMUM_SLAVES = 126
"""Largest number of devices without node id for which the master searches."""
PATIENCE = (1.0, 3.0, 10.0)
"""Time-outs of the fastscan requests in each search, as multiples of ``Timing.fastscan``.  On a
busy computer a response can be later than the first time-out; the identities that a search finds
then contradict each other."""


class LssError(Exception):
    """Error: an LSS request has no response, more than one response, or was refused."""


class UnconfirmedIdentityError(LssError):
    """Error: the responses to the requests of an LSS fastscan contradict each other."""

    def __init__(self) -> None:
        super().__init__("a device without id does not confirm its identity")


class LssMaster:
    """LSS master that sets and reads node ids with the layer setting services (LSS).

    At most one LSS slave may be in the configuration state at a time.  ``switch_to_waiting`` ends
    the configuration state of all slaves.
    """

    def __init__(self, master: BusMaster) -> None:
        self.master = master
        self._patience = PATIENCE[0]

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

    def find_without_id(self, known: Collection[Identity]) -> list[Identity]:
        """Returns the identities of all LSS slaves without node id, except those in ``known``.

        All LSS slaves must be in the waiting state, and remain there.  Raises ``LssError`` if the
        responses of the LSS slaves contradict each other, also in searches with longer time-outs.
        Each LSS request waits for the full time-out, because a late response would be counted as a
        response to the next request.
        """
        self._patience = PATIENCE[0]
        if not self.has_unconfigured_slave():
            return []
        if self._fastscan_request(0, 0, LAST_PART, LAST_PART):
            raise LssError("a device without id responds to every fastscan request")
        for patience in PATIENCE:
            self._patience = patience
            try:
                identities = list(self._identities((), known))
            except UnconfirmedIdentityError:
                continue
            return [identity for identity in identities if identity not in known]
        raise UnconfirmedIdentityError()

    def _identities(
        self, first: tuple[int, ...], known: Collection[Identity]
    ) -> Iterator[Identity]:
        """Yields the identities of the LSS slaves without node id that begin with the numbers
        ``first``.

        The identities in ``known`` are among them.
        """
        part = len(first)
        self.has_unconfigured_slave()  # all slaves go back to part 0
        for position, number in enumerate(first):
            if not self._fastscan_request(number, 0, position, position + 1):
                raise UnconfirmedIdentityError()
        present = {identity[part] for identity in known if identity[:part] == first}
        numbers = list(islice(self._numbers(part, 0, 32, present), MAXIMUM_SLAVES + 1))
        if len(numbers) > MAXIMUM_SLAVES:
            raise LssError(f"more than {MAXIMUM_SLAVES} devices without id respond")
        for number in numbers:
            if part == LAST_PART:
                vendor, product, revision = first
                yield Identity(vendor, product, revision, number)
            else:
                yield from self._identities((*first, number), known)

    def _numbers(self, part: int, start: int, bit: int, known: Collection[int]) -> Iterator[int]:
        """Yields the numbers of one part of the identity that begin with the bits of ``start``.

        ``bit``: position of the lowest valid bit of ``start``.  ``known``: numbers that exist.
        """
        if bit == 0:
            if start not in known and not self._fastscan_request(start, 0, part, part):
                raise UnconfirmedIdentityError()
            yield start
            return
        bit -= 1
        low, high = start, start | 1 << bit
        low_exists = any(number >> bit == low >> bit for number in known)
        low_exists = low_exists or self._fastscan_request(low, bit, part, part)
        if low_exists:
            yield from self._numbers(part, low, bit, known)
        high_exists = any(number >> bit == high >> bit for number in known) or not low_exists
        if high_exists or self._fastscan_request(high, bit, part, part):
            yield from self._numbers(part, high, bit, known)

    # -- inside -----------------------------------------------------------------------------

    def _fastscan_request(self, number: int, bit: int, part: int, next_part: int) -> bool:
        request = struct.pack("<BIBBB", lss.FASTSCAN, number, bit, part, next_part)
        timeout = self._patience * self.master.timing.fastscan
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
            return frame.key == LSS_RESPONSE and len(frame.data) == 8 and frame.data[0] == response

        limit = timeout or self.master.timing.lss
        return self.master.request(LSS_REQUEST, request.ljust(8, b"\0"), fits, limit, settle)

    def _send(self, request: bytes) -> None:
        self.master.send(LSS_REQUEST, request.ljust(8, b"\0"))
