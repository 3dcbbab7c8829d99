"""Layer setting services (CiA 305): constants that the LSS master and the LSS slaves share.

LSS sets the node id and the bitrate of a device.  The master addresses a device by its identity,
and needs no node id for it.  Every message has 8 bytes: a command specifier and its parameters;
unused bytes are 0.
"""

from __future__ import annotations

from typing import NamedTuple

# COB-IDs: master -> slaves, slave -> master.
REQUEST, RESPONSE = 0x7E5, 0x7E4

# Command specifiers.  A configuration service is answered under its own specifier.
SWITCH_STATE_GLOBAL = 0x04
"""Byte 1: ``WAITING`` or ``CONFIGURATION``, for all slaves; not answered."""
WAITING, CONFIGURATION = 0, 1
SWITCH_STATE_SELECTIVE = (0x40, 0x41, 0x42, 0x43)
"""Vendor, product, revision, serial (u32 each): the slave that matches all four is selected."""
SELECTED = 0x44
"""Answer of the selected slave, which is now in the configuration state."""
IDENTIFY_REMOTE_SLAVE = (0x46, 0x47, 0x48, 0x49, 0x4A, 0x4B)
"""Vendor, product, lowest and highest revision, lowest and highest serial (u32 each)."""
IDENTIFY_NON_CONFIGURED = 0x4C
SLAVE_IDENTIFIED = 0x4F
"""Answer to an identify request and to a fastscan request."""
NON_CONFIGURED_IDENTIFIED = 0x50
FASTSCAN = 0x51
"""Number (u32), bit checked, part of the identity, next part (u8 each)."""
FASTSCAN_START = 0x80
"""Bit checked that starts a scan: every slave without a node id answers."""
CONFIGURE_NODE_ID = 0x11
CONFIGURE_BIT_TIMING = 0x13
ACTIVATE_BIT_TIMING = 0x15
STORE_CONFIGURATION = 0x17
INQUIRE_IDENTITY = (0x5A, 0x5B, 0x5C, 0x5D)
"""Vendor, product, revision, serial."""
INQUIRE_NODE_ID = 0x5E

UNCONFIGURED = 255
"""Node id of a slave that has none."""
BITRATES = {
    0: 1_000_000,
    1: 800_000,
    2: 500_000,
    3: 250_000,
    4: 125_000,
    6: 50_000,
    7: 20_000,
    8: 10_000,
}
"""Bitrates (bit/s) of the standard's table of bit timings; index 5 is reserved."""


class Identity(NamedTuple):
    """LSS address of a device, object 0x1018.  No two devices share all four numbers."""

    vendor: int
    product: int
    revision: int
    serial: int
