"""Constants of the layer setting services (LSS, CiA 305).

LSS sets the node id and the bitrate of a device.  The LSS master addresses a device by the vendor,
product, revision and serial number, so the device needs no node id.  Every LSS message has 8 bytes:
a command specifier and its parameters.  Unused bytes of an LSS message are 0.
"""

from __future__ import annotations

from typing import NamedTuple

# LSS command specifiers.  The response of an LSS slave to a configuration request has the same
# command specifier as the request.
SWITCH_STATE_GLOBAL = 0x04
"""Sets the state of all slaves to byte 1, ``WAITING`` or ``CONFIGURATION``; has no response."""
WAITING, CONFIGURATION = 0, 1
SWITCH_STATE_SELECTIVE = (0x40, 0x41, 0x42, 0x43)
"""Selects the slave whose vendor, product, revision and serial number (u32 each) match."""
SELECTED = 0x44
"""Response of the selected slave, which is now in the configuration state."""
IDENTIFY_REMOTE_SLAVE = (0x46, 0x47, 0x48, 0x49, 0x4A, 0x4B)
"""Vendor, product, lowest and highest revision, lowest and highest serial number (u32 each)."""
IDENTIFY_NON_CONFIGURED = 0x4C
SLAVE_IDENTIFIED = 0x4F
"""Response to an identify request and to a fastscan request."""
NON_CONFIGURED_IDENTIFIED = 0x50
FASTSCAN = 0x51
"""Parameters: identity number (u32); number of the checked bit, part and next part (u8 each)."""
FASTSCAN_START = 0x80
"""Number of the checked bit that starts a fastscan: all slaves without node id respond."""
CONFIGURE_NODE_ID = 0x11
CONFIGURE_BIT_TIMING = 0x13
ACTIVATE_BIT_TIMING = 0x15
STORE_CONFIGURATION = 0x17
INQUIRE_IDENTITY = (0x5A, 0x5B, 0x5C, 0x5D)
"""Requests for the vendor, product, revision and serial number of the selected slave."""
INQUIRE_NODE_ID = 0x5E

UNCONFIGURED = 255
"""Value of the node id field for a slave without node id."""
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
"""Bitrate (bit/s) for each index of the bit timing table in CiA 305; index 5 is reserved."""


class Identity(NamedTuple):
    """Identity of a CANopen device (object 0x1018), which LSS uses as its address.

    The vendor, product, revision and serial number together identify one device uniquely.
    """

    vendor: int
    product: int
    revision: int
    serial: int
