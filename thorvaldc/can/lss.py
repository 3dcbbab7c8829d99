"""Layer setting services (CiA 305): COB-IDs, bit timings and the address of a device."""

from __future__ import annotations

from typing import NamedTuple

REQUEST, RESPONSE = 0x7E5, 0x7E4
UNCONFIGURED = 255
"""The node id of a slave that has none."""
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
"""The standard's table of bit timings (bit/s); 5 is reserved."""


class Identity(NamedTuple):
    """The LSS address of a device, object 0x1018: no two devices share all four."""

    vendor: int
    product: int
    revision: int
    serial: int
