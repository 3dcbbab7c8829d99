"""The slave's side of the layer setting services (CiA 305): addresses and bitrates by identity."""

from __future__ import annotations

import struct
from collections.abc import Callable

from thorvaldc.can.lss import BITRATES, UNCONFIGURED, Identity

_SELECT = (0x40, 0x41, 0x42, 0x43)
_IDENTIFY = (0x46, 0x47, 0x48, 0x49, 0x4A, 0x4B)
_INQUIRE = (0x5A, 0x5B, 0x5C, 0x5D)


class LssSlave:
    """The services of one device.  What it decides is carried out by its device:

    - ``set_id(id)``: the pending node id, 1..127 or 255;
    - ``set_bitrate(bit/s)``: the pending bitrate; ``False`` where it cannot do it;
    - ``activate(delay)``: change to the pending bitrate after ``delay`` s;
    - ``store(done)``: keep the pending values, then call ``done(code)`` (0: nonvolatile);
    - ``left()``: the configuration state was left, a first id may take effect.
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
        self._selected = 0
        self._identified = 0
        self._scanned = 0

    def request(self, data: bytes) -> None:
        if len(data) != 8:
            return
        command = data[0]
        number: int = struct.unpack_from("<I", data, 1)[0]
        if command == 0x04:
            self._switch(data[1] == 1)
        elif command in _SELECT:
            self._select(_SELECT.index(command), number)
        elif command in _IDENTIFY:
            self._identify(_IDENTIFY.index(command), number)
        elif command == 0x4C:
            if self._node_id() == UNCONFIGURED:
                self._answer(0x50)
        elif command == 0x51:
            self._fastscan(number, data[5], data[6], data[7])
        elif self.configuring:
            self._configure(command, data)

    def _switch(self, configure: bool) -> None:
        was, self.configuring = self.configuring, configure
        self._selected = 0
        if was and not configure:
            self._left()

    def _select(self, part: int, number: int) -> None:
        """Four requests in a row, one for each part of the identity."""
        if part == 0:
            self._selected = 0
        if part != self._selected or number != self.identity[part]:
            self._selected = 0
            return
        self._selected += 1
        if self._selected == 4:
            self._selected = 0
            self.configuring = True
            self._answer(0x44)

    def _identify(self, part: int, number: int) -> None:
        """Vendor, product, lowest and highest revision, lowest and highest serial number."""
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
            self._answer(0x4F)

    def _fastscan(self, number: int, bit: int, part: int, following: int) -> None:
        """Unconfigured slaves in the waiting state answer where their bits so far agree."""
        if self._node_id() != UNCONFIGURED or self.configuring:
            return
        if bit == 0x80:
            self._scanned = 0
            self._answer(0x4F)
            return
        if bit > 31 or part > 3 or part != self._scanned:
            return
        if number >> bit != self.identity[part] >> bit:
            return
        self._answer(0x4F)
        if bit == 0:
            if following < part:  # the last part agrees as well: this slave is found
                self.configuring = True
            self._scanned = following & 3

    def _configure(self, command: int, data: bytes) -> None:
        if command == 0x11:
            valid = 1 <= data[1] <= 127 or data[1] == UNCONFIGURED
            if valid:
                self._set_id(data[1])
            self._answer(0x11, 0 if valid else 1)
        elif command == 0x13:
            rate = BITRATES.get(data[2]) if data[1] == 0 else None
            taken = rate is not None and self._set_bitrate(rate)
            self._answer(0x13, 0 if taken else 1)
        elif command == 0x15:
            self._activate(struct.unpack_from("<H", data, 1)[0] / 1000.0)
        elif command == 0x17:
            self._store(lambda code: self._answer(0x17, code))
        elif command in _INQUIRE:
            found = self.identity[_INQUIRE.index(command)]
            self._respond(struct.pack("<BI3x", command, found))
        elif command == 0x5E:
            self._answer(0x5E, self._node_id())

    def _answer(self, command: int, value: int = 0) -> None:
        self._respond(bytes([command, value, 0, 0, 0, 0, 0, 0]))
