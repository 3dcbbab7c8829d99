"""Frame codecs, compared with cantools and our DBC."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable
from dataclasses import replace

import cantools.database
import pytest

from tests.backend_files import dbc_message
from tests.robots import SPAN
from tests.runtime.can_base.test_can_base import four_wheels
from tests.simulation.bus.robots import drives, uneven_robot
from thorvaldc.backends.can.dbc import dbc_text
from thorvaldc.can.frame import CanFrame
from thorvaldc.compiler.pipeline import emit
from thorvaldc.model import Bus, FrameDefinition, Robot, Signal
from thorvaldc.model.bus import FLOAT32_MAX
from thorvaldc.runtime.can_base.signal_codec import FrameCodec


@pytest.mark.parametrize(
    "make", [four_wheels, drives, uneven_robot], ids=["roboteq", "cia402", "uneven"]
)
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
        message = dbc_message(database, frame)
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
                values = codec.decode(data)
                lowest = [-math.inf if s.minimum is None else s.minimum for s in frame.signals]
                bounded = [max(value, low) for value, low in zip(values, lowest, strict=True)]
                assert codec.decode(codec.encode(values)) == pytest.approx(bounded, rel=1e-12)
            compared += 1
    assert compared > 300


def frame(*signals: Signal, length: int = 8) -> FrameDefinition:
    return FrameDefinition("f", 0x181, "pdo", "master", (), length, None, None, signals, SPAN)


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


VELOCITY = Signal("velocity", 0, 32, scale=-2.0, offset=1.0, floating_point=True)
FLOAT_FRAMES = {
    "two": (VELOCITY, Signal("torque", 32, 32, floating_point=True)),
    "swapped": (Signal("torque", 32, 32, floating_point=True), VELOCITY),
    "double": (Signal("position", 0, 64, floating_point=True),),
    "with integers": (VELOCITY, Signal("feed", 32, 16, True, 0.001), Signal("more", 48, 16)),
    "between bits": (Signal("flag", 3, 1), Signal("torque", 9, 32, floating_point=True)),
}


@pytest.mark.parametrize("signals", FLOAT_FRAMES.values(), ids=FLOAT_FRAMES)
def test_floating_point_signals_agree_with_cantools(signals: tuple[Signal, ...]) -> None:
    definition = frame(*signals)
    codec = FrameCodec(definition)
    text = dbc_text(Bus("main", 500_000, 0.02, (), (definition,), SPAN))
    message = cantools.database.load_string(text, "dbc").get_message_by_frame_id(0x181)
    numbers = random.Random(5)
    for _ in range(50):
        values = {
            s.name: numbers.uniform(0.0, 1.0) * 10.0 ** numbers.randint(0, 4) for s in signals
        }
        data = codec.encode_named(values)
        theirs = message.decode(data, decode_choices=False)
        assert codec.decode_named(data) == pytest.approx(theirs, rel=1e-12)
        for signal in signals:
            if signal.floating_point:
                assert theirs[signal.name] == pytest.approx(values[signal.name], rel=1e-6, abs=1e-6)
                assert message.get_signal_by_name(signal.name).is_float


def test_a_floating_point_signal_is_limited_to_finite_numbers() -> None:
    codec = FrameCodec(frame(Signal("a", 0, 32, minimum=-1e300, floating_point=True), length=4))
    assert codec.decode(codec.encode([1e200])) == [FLOAT32_MAX]
    assert codec.decode(codec.encode([-1e200])) == [-FLOAT32_MAX]
    limited = FrameCodec(frame(Signal("a", 0, 32, maximum=2.5, floating_point=True), length=4))
    assert limited.decode(limited.encode([3.0])) == [2.5]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_received_number_that_is_not_finite_is_an_error(value: float) -> None:
    codec = FrameCodec(frame(Signal("vel", 0, 32, floating_point=True), length=4))
    data = struct.pack("<f", value)
    assert not codec.is_finite(data)
    with pytest.raises(ValueError, match=f"vel is {value}"):
        codec.decode(data)


def test_a_signal_that_is_not_selected_may_be_anything() -> None:
    codec = FrameCodec(
        frame(
            Signal("kind", 0, 8, multiplexer=True),
            Signal("a", 32, 32, selected_by=(1,), floating_point=True),
            Signal("b", 32, 32, selected_by=(2,)),
        )
    )
    data = b"\2\0\0\0" + struct.pack("<f", math.nan)
    assert codec.is_finite(data)
    assert codec.decode_named(data)["b"] == 0x7FC00000
    with pytest.raises(ValueError, match="a is nan"):
        codec.decode(b"\1" + data[1:])


def test_big_endian_signals_start_at_their_most_significant_bit() -> None:
    """The numbers of the bits are those of a DBC file; both byte orders may be in one frame."""
    signals = (
        Signal("speed", 7, 32, True, big_endian=True),
        Signal("current", 39, 16, True, 0.1, big_endian=True),
        Signal("duty", 48, 16, True, 0.001),
    )
    values = [-51000.0, 12.5, -0.25]
    data = (-51000).to_bytes(4, "big", signed=True) + b"\x00\x7d" + b"\x06\xff"
    assert FrameCodec(frame(*signals)).encode(values) == data
    assert FrameCodec(frame(*signals)).decode(data) == pytest.approx(values)
    big = FrameCodec(frame(*signals[:2], length=6))  # one call of `struct`
    assert big.encode(values[:2]) == data[:6]
    assert big.decode(data) == pytest.approx(values[:2])


@pytest.mark.parametrize(
    ("start", "length", "value", "data"),
    [(0, 1, 1, "0100"), (3, 4, 0xA, "0a00"), (2, 6, 0b101_011, "0560"), (5, 12, 0xABC, "2af0")],
)
def test_big_endian_signals_across_bytes(start: int, length: int, value: int, data: str) -> None:
    codec = FrameCodec(frame(Signal("a", start, length, big_endian=True), length=2))
    assert codec.encode([value]).hex() == data
    assert codec.decode(bytes.fromhex(data)) == [value]


def test_an_extended_frame_is_sent_as_such() -> None:
    codec = FrameCodec(replace(frame(Signal("a", 0, 8)), extended=True))
    assert codec.can_frame(b"\1") == CanFrame(0x181, b"\1", extended=True)
    assert codec.key == CanFrame(0x181, extended=True).key != CanFrame(0x181).key
