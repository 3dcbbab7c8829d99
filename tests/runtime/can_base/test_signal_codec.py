"""Frame codecs, compared with cantools and our DBC."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace

import cantools.database
import pytest

from tests.robots import SPAN
from tests.runtime.can_base.test_can_base import drives, four_wheels
from thorvaldc.compiler.pipeline import emit
from thorvaldc.model import Robot
from thorvaldc.model.bus import FrameDefinition, Signal
from thorvaldc.runtime.can_base.signal_codec import FrameCodec


@pytest.mark.parametrize("make", [four_wheels, drives], ids=["roboteq", "cia402"])
def test_values_agree_with_cantools(make: Callable[[], Robot]) -> None:
    robot = make()
    text = emit(robot, ["can"])["can/robot.dbc"].decode("cp1252")
    database = cantools.database.load_string(text, "dbc")
    numbers = random.Random(3)
    compared = 0
    for frame in robot.buses[0].frames:
        if not frame.signals:
            continue
        codec = FrameCodec(frame)
        message = database.get_message_by_frame_id(frame.cob_id)
        for _ in range(20):
            data = numbers.randbytes(frame.length)
            try:
                theirs = message.decode(data, decode_choices=False)
            except cantools.database.DecodeError:
                continue  # a value that selects no signals
            ours = codec.decode_named(data)
            assert ours.keys() == theirs.keys(), frame.name
            for name, value in theirs.items():
                assert ours[name] == pytest.approx(value, rel=1e-12), (frame.name, name)
            if not any(signal.selected_by for signal in frame.signals):
                back = codec.encode(codec.decode(data))
                assert codec.decode(back) == pytest.approx(codec.decode(data), rel=1e-12)
            compared += 1
    assert compared > 300


def frame(*signals: Signal, length: int = 8) -> FrameDefinition:
    return FrameDefinition("f", 0x181, "pdo", "n", ("master",), length, None, None, signals, SPAN)


def test_values_beyond_their_bounds_are_limited() -> None:
    codec = FrameCodec(
        frame(
            Signal("a", 0, 16, True, 0.5),
            Signal("b", 16, 8, False, 1.0, minimum=2.0, maximum=9.0),
        )
    )
    assert codec.decode(codec.encode([1e9, 100.0])) == [0.5 * 32767, 9]
    assert codec.decode(codec.encode([-1e9, -100.0])) == [-0.5 * 32768, 2]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_not_encoded(value: float) -> None:
    codec = FrameCodec(frame(Signal("a", 0, 32, True)))
    with pytest.raises(ValueError, match="a is"):
        codec.encode([value])


def test_scale_and_offset_both_ways() -> None:
    codec = FrameCodec(frame(Signal("angle", 8, 16, True, 0.001, 0.25)))
    assert codec.encode([1.25]) == b"\0\xe8\x03\0\0\0\0\0"
    assert codec.decode(b"\0\xe8\x03\0\0\0\0\0") == [1.25]
    assert codec.encode_named({}) == bytes(8)


def test_a_short_frame_is_refused_and_surplus_bytes_are_ignored() -> None:
    codec = FrameCodec(frame(Signal("a", 0, 16), length=2))
    with pytest.raises(ValueError, match="1 bytes, not 2"):
        codec.decode(b"\1")
    assert codec.decode(b"\1\0\xff\xff") == [1]


def test_signals_in_any_order_and_at_any_bit() -> None:
    swapped = FrameCodec(frame(Signal("high", 32, 32), Signal("low", 0, 32, True)))
    data = swapped.encode([7, -2])
    assert data == b"\xfe\xff\xff\xff\x07\0\0\0"
    assert swapped.decode(data) == [7, -2]
    odd = FrameCodec(frame(Signal("a", 3, 5, True), Signal("b", 8, 24), length=4))
    data = odd.encode([-3, 0x123456])
    assert odd.decode(data) == [-3, 0x123456]


def test_codecs_share_no_state() -> None:
    """A frame with another scale gives another codec."""
    first = frame(Signal("a", 0, 16))
    second = replace(first, signals=(Signal("a", 0, 16, scale=2.0),))
    assert FrameCodec(first).decode(b"\2\0" + bytes(6)) == [2]
    assert FrameCodec(second).decode(b"\2\0" + bytes(6)) == [4]
