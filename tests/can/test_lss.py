"""Numbers of LSS, compared with the tables of CiA 305."""

from __future__ import annotations

from thorvaldc.can import lss


def test_the_table_of_bit_timings() -> None:
    kbit_s = {0: 1000, 1: 800, 2: 500, 3: 250, 4: 125, 6: 50, 7: 20, 8: 10}
    assert {index: 1000 * rate for index, rate in kbit_s.items()} == lss.BITRATES


def test_the_node_id_of_a_device_without_one() -> None:
    assert lss.UNCONFIGURED == 0xFF
