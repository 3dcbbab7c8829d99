"""Quirks of simulated CANopen devices: behaviour of real protocol stacks that differs from the
default behaviour of the simulated devices.

CiA 301 and CiA 305 permit most of this behaviour.  docs/simulated-bus.md describes each quirk.
"""

from __future__ import annotations

import enum


class Quirk(enum.StrEnum):
    """A deviation of a simulated CANopen device from the default behaviour."""

    LSS_RESPONDS_WHEN_SELECTED = "lss_responds_when_selected"
    """In the LSS state CONFIGURATION, the device responds to every fastscan request and to the last
    request of every selective switch, whatever the identity in the request."""
    LENGTH_ABORTS = "length_aborts"
    """A value that is too long or too short aborts with 0x06070012 or 0x06070013 instead of
    0x06070010."""
    ERROR_HISTORY_ABORTS = "error_history_aborts"
    """Reading an unused entry of object 0x1003 aborts with 0x08000024 instead of returning 0."""
    ONE_CONSUMER_PER_NODE = "one_consumer_per_node"
    """A second entry of object 0x1016 for the same node aborts with 0x06040043."""
    FIXED_COB_IDS = "fixed_cob_ids"
    """The COB-IDs of SYNC (object 0x1005) and of EMCY (object 0x1014) are read-only."""
    SEGMENTED_TRANSFERS = "segmented_transfers"
    """Values of up to 4 bytes are also uploaded in segments, and expedited downloads are refused
    with the abort code 0x05040001."""
    BLOCK_TRANSFERS = "block_transfers"
    """The device also supports block transfers, which the other devices abort with 0x05040001."""
    INHIBIT_TIMES = "inhibit_times"
    """The factory setting of the inhibit time of all TPDOs is 50 ms."""
    NO_INHIBIT_TIMES = "no_inhibit_times"
    """The TPDOs have no inhibit time (subindex 3)."""
