"""The response-time bounds, compared with a simulated wire with worst-case senders.

``python -m bench response_times`` does the same for 30 buses x 30 seeds.
"""

from __future__ import annotations

import pytest

from bench.bus_traffic import random_bus, reached, worst_payload
from tests.slow import mostly_slow
from thorvaldc.can.frame_bits import frame_bits
from thorvaldc.model.bus_timing import worst_case_bits as worst_bits


@pytest.mark.parametrize("number", mostly_slow(range(8), 2, slow=2))
def test_bounds_hold_on_the_simulated_bus_and_are_reached(number: int) -> None:
    found = reached(random_bus(number), 10)
    assert len(found.of_sent) > len(found.bus.frames) * 0.8, "nearly all have been sent"
    # The bounds for the actual number of bits have no margin that could hide an error.
    assert max(found.of_sent.values()) <= 1.0
    assert max(found.of_bound.values()) >= 0.95
    assert found.of_sent[found.last] >= 0.95


def test_worst_payloads_come_near_the_worst_stuffing() -> None:
    for identifier in (0x081, 0x201, 0x381, 0x701):
        for length in (1, 2, 4, 8):
            bits = frame_bits(worst_payload(identifier, length))
            assert 0.9 * worst_bits(length) <= bits <= worst_bits(length)
