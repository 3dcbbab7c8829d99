"""The master's side of the layer setting services (CiA 305), which counts every answer."""

from __future__ import annotations

import struct

from thorvaldc.can.frame import CanFrame
from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.commissioning.bus_master import LSS_REQUEST, LSS_RESPONSE, BusMaster

_SELECT = (0x40, 0x41, 0x42, 0x43)


class LssError(Exception):
    """A slave did not answer, answered twice, or refused; the message says which."""


class LssMaster:
    """One slave at a time is in the configuration state; ``waiting`` ends it for all."""

    def __init__(self, master: BusMaster) -> None:
        self.master = master

    def waiting(self) -> None:
        """All slaves back to the waiting state; nobody answers."""
        self._send(bytes([0x04, 0]))

    def select(self, identity: Identity) -> int:
        """How many slaves of that identity went to the configuration state; one is right."""
        for command, number in zip(_SELECT, identity, strict=True):
            last = command == _SELECT[-1]
            request = struct.pack("<BI", command, number)
            if last:
                return len(self._ask(request, 0x44, self.master.timing.settle))
            self._send(request)
        return 0

    def node_id(self) -> int:
        """The selected slave's active id; 255: it has none.  Raises ``LssError``."""
        return self._one(bytes([0x5E]), 0x5E)[1]

    def configure_id(self, node_id: int) -> None:
        """Set the pending id.  Raises ``LssError``."""
        reply = self._one(bytes([0x11, node_id]), 0x11)
        if reply[1]:
            raise LssError(f"it refuses the id {node_id} (code {reply[1]})")

    def store(self) -> None:
        """Keep the pending id.  Raises ``LssError``."""
        reply = self._one(bytes([0x17]), 0x17, self.master.timing.store)
        if reply[1] == 1:
            raise LssError("it cannot store its id")
        if reply[1]:
            raise LssError(f"storing its id failed (code {reply[1]})")

    def someone_unconfigured(self) -> bool:
        """Whether a slave that has no id is in the waiting state."""
        return bool(self._fastscan(0, 0x80, 0, 0))

    def fastscan(self) -> Identity | None:
        """The identity of a slave without id, which then is in the configuration state.

        ``None``: there is none.  Raises ``LssError`` where answers do not fit together.
        Takes 132 requests; each waits its time out, since a late answer would be taken for
        that to the next.
        """
        if not self.someone_unconfigured():
            return None
        found = []
        for part in range(4):
            number = 0
            for bit in range(31, -1, -1):
                if not self._fastscan(number, bit, part, part):
                    number |= 1 << bit
            if not self._fastscan(number, 0, part, (part + 1) % 4):
                raise LssError("a device without id does not confirm its identity")
            found.append(number)
        return Identity(*found)

    # -- inside -----------------------------------------------------------------------------

    def _fastscan(self, number: int, bit: int, part: int, following: int) -> bool:
        request = struct.pack("<BIBBB", 0x51, number, bit, part, following)
        frames = self._ask(request, 0x4F, None, self.master.timing.fastscan)
        return bool(frames)

    def _one(self, request: bytes, answer: int, timeout: float | None = None) -> bytes:
        frames = self._ask(request, answer, self.master.timing.settle, timeout)
        if not frames:
            raise LssError("it does not answer")
        if len(frames) > 1:
            raise LssError(f"{len(frames)} devices answer")
        return frames[0].data

    def _ask(
        self, request: bytes, answer: int, settle: float | None, timeout: float | None = None
    ) -> list[CanFrame]:
        def fits(frame: CanFrame) -> bool:
            return frame.id == LSS_RESPONSE and len(frame.data) == 8 and frame.data[0] == answer

        limit = timeout or self.master.timing.lss
        return self.master.ask(LSS_REQUEST, request.ljust(8, b"\0"), fits, limit, settle)

    def _send(self, request: bytes) -> None:
        self.master.send(LSS_REQUEST, request.ljust(8, b"\0"))


__all__ = ["UNCONFIGURED", "Identity", "LssError", "LssMaster"]
