"""Frames compiled from the model against cantools by our DBC; the receiver's ring."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace

import cantools.database
import pytest

from tests.robots import SPAN
from tests.runtime.can_base.test_can_base import drives, four_wheels
from thorvaldc.can.frame import CanFrame, ReceivedFrame
from thorvaldc.compiler.pipeline import emit
from thorvaldc.model import Robot
from thorvaldc.model.bus import FrameDefinition, Signal
from thorvaldc.runtime.can_base.frame_receiver import FrameReceiver
from thorvaldc.runtime.can_base.signal_codec import FrameCodec


@pytest.mark.parametrize("make", [four_wheels, drives], ids=["roboteq", "cia402"])
def test_values_are_those_of_cantools(make: Callable[[], Robot]) -> None:
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
                continue  # a multiplexer's value that is none
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


def test_values_beyond_their_bounds_are_drawn_back() -> None:
    codec = FrameCodec(
        frame(
            Signal("a", 0, 16, True, 0.5),
            Signal("b", 16, 8, False, 1.0, minimum=2.0, maximum=9.0),
        )
    )
    assert codec.decode(codec.encode([1e9, 100.0])) == [0.5 * 32767, 9]
    assert codec.decode(codec.encode([-1e9, -100.0])) == [-0.5 * 32768, 2]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_never_encoded(value: float) -> None:
    codec = FrameCodec(frame(Signal("a", 0, 32, True)))
    with pytest.raises(ValueError, match="a is"):
        codec.encode([value])


def test_scale_and_offset_both_ways() -> None:
    codec = FrameCodec(frame(Signal("angle", 8, 16, True, 0.001, 0.25)))
    assert codec.encode([1.25]) == b"\0\xe8\x03\0\0\0\0\0"
    assert codec.decode(b"\0\xe8\x03\0\0\0\0\0") == [1.25]
    assert codec.encode_named({}) == bytes(8)


def test_a_short_frame_is_refused_and_a_long_one_cut() -> None:
    codec = FrameCodec(frame(Signal("a", 0, 16), length=2))
    with pytest.raises(ValueError, match="1 bytes, not 2"):
        codec.decode(b"\1")
    assert codec.decode(b"\1\0\xff\xff") == [1]


def test_signals_need_not_stand_in_order_or_on_bytes() -> None:
    swapped = FrameCodec(frame(Signal("high", 32, 32), Signal("low", 0, 32, True)))
    data = swapped.encode([7, -2])
    assert data == b"\xfe\xff\xff\xff\x07\0\0\0"
    assert swapped.decode(data) == [7, -2]
    odd = FrameCodec(frame(Signal("a", 3, 5, True), Signal("b", 8, 24), length=4))
    data = odd.encode([-3, 0x123456])
    assert odd.decode(data) == [-3, 0x123456]


# -- the receiver -----------------------------------------------------------------------


class Fed:
    """A port that gives what it is fed."""

    now = 0.0
    overruns = 0

    def __init__(self) -> None:
        self.waiting: list[ReceivedFrame] = []
        self.broken = False

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        if self.broken:
            raise ConnectionError("unplugged")
        return self.waiting.pop(0) if self.waiting else None

    def feed(self, *frames: CanFrame, own: bool = False) -> None:
        self.waiting += [ReceivedFrame(1_000_000 * i, f, own) for i, f in enumerate(frames)]


def receiver(limit: int = 4) -> tuple[FrameReceiver, Fed]:
    fed = Fed()
    return FrameReceiver(fed, {0x181}, limit=limit), fed  # type: ignore[arg-type]


def test_a_full_ring_loses_the_oldest() -> None:
    """The original kept the oldest and lost what was news."""
    found, fed = receiver()
    fed.feed(*(CanFrame(0x181, bytes([i])) for i in range(10)))
    assert [data[0] for _, _, data in found.drain()] == [6, 7, 8, 9]
    assert found.dropped == 6
    assert found.latest[0x181].data == b"\x09"
    assert found.latest[0x181].number == 10
    assert found.drain() == []


def test_of_reports_only_the_newest_counts() -> None:
    found, fed = receiver()
    fed.feed(*(CanFrame(0x281, bytes([i])) for i in range(10)))
    assert found.drain() == []
    assert found.dropped == 0
    assert found.latest[0x281].data == b"\x09"
    assert found.latest[0x281].time == 0.009


def test_strange_frames_and_own_ones_do_not_count() -> None:
    found, fed = receiver()
    fed.feed(CanFrame(0x181, b"\1", extended=True), CanFrame(0x181, remote=True, requested=8))
    fed.feed(CanFrame(0x181, b"\1"), own=True)
    assert found.drain() == []
    assert found.latest == {}
    assert found.ignored == 2


@pytest.mark.parametrize("threaded", [False, True])
def test_a_port_that_is_gone_is_said(threaded: bool) -> None:
    found, fed = receiver()
    fed.broken = True
    if threaded:
        found.start()
        assert found._thread is not None
        found._thread.join(2.0)
    found.drain()
    assert found.lost == "unplugged"
    found.stop()


def test_frames_are_replaced_whole() -> None:
    """A model with another scale gives another codec: nothing is kept between them."""
    one = frame(Signal("a", 0, 16))
    two = replace(one, signals=(Signal("a", 0, 16, scale=2.0),))
    assert FrameCodec(one).decode(b"\2\0" + bytes(6)) == [2]
    assert FrameCodec(two).decode(b"\2\0" + bytes(6)) == [4]
