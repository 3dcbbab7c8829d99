"""The relay of frames of foreign devices: its rate rule, its queues and its refusals."""

from __future__ import annotations

from dataclasses import replace

from tests.simulation.bus.robots import drives
from thorvaldc.can.frame import CanFrame
from thorvaldc.model.bus import EXTENDED
from thorvaldc.runtime.can_base.foreign_frame_relay import QUEUE_LIMIT, Relay

COMMAND, STATE = 0x240, 0x1C0


def make_relay() -> Relay:
    return Relay(drives().buses[0])


def test_the_mean_rate_is_limited() -> None:
    """At 10 Hz a frame may be half a period early; more frequent frames are dropped."""
    relay = make_relay()
    jittery = [0.1 * i + (0.03 if i % 2 else 0.0) for i in range(20)]
    assert [relay.offer(CanFrame(COMMAND, b""), t) for t in jittery] == [""] * 20
    relay = make_relay()
    reasons = [relay.offer(CanFrame(COMMAND, b""), 0.01 * i) for i in range(1000)]
    assert 98 <= reasons.count("") <= 102 or reasons.count("queue full")
    assert relay.dropped[COMMAND, "too often"] >= 890


def test_of_a_burst_the_first_frames_pass_and_the_others_are_counted() -> None:
    """The original software dropped all of a hundred frames in a cycle."""
    relay = make_relay()
    reasons = [relay.offer(CanFrame(COMMAND, bytes([i])), 1.0) for i in range(100)]
    assert 1 <= reasons.count("") <= 2
    assert relay.dropped[COMMAND, "too often"] == 100 - reasons.count("")
    assert relay.next_outgoing() == CanFrame(COMMAND, b"\0")


def test_a_full_queue_of_device_frames_drops_the_oldest() -> None:
    relay = make_relay()
    for i in range(QUEUE_LIMIT + 10):
        relay.take(STATE, bytes([i]), 0.1 * i)
    kept = relay.received()
    assert [r.frame.data[0] for r in kept] == list(range(10, QUEUE_LIMIT + 10))
    assert relay.dropped[STATE, "queue full"] == 10
    assert relay.passed[STATE] == QUEUE_LIMIT + 10
    relay.take(0x1C1, b"", 0.0)
    assert relay.received() == []


def test_frames_that_are_too_long_or_cannot_be_sent() -> None:
    bus = drives().buses[0]
    short = [replace(f, length=2) if f.cob_id == COMMAND else f for f in bus.frames]
    relay = Relay(replace(bus, frames=tuple(short)))
    assert relay.offer(CanFrame(COMMAND, b"123"), 0.0) == "too long"
    assert relay.offer(CanFrame(COMMAND, b"12"), 1.0) == ""
    frame = relay.next_outgoing()
    assert frame is not None
    relay.count_sent(frame, False)
    assert relay.dropped == {(COMMAND, "too long"): 1, (COMMAND, "not sent"): 1}
    assert relay.passed[COMMAND] == 0


def test_the_example_of_the_rate_rule() -> None:
    """The arrivals that the module's diagram draws, with an interval of 0.1 s."""
    relay = make_relay()
    arrivals = {0.0: "", 0.05: "", 0.075: "too often", 0.155: "", 0.225: "too often", 0.26: ""}
    for time, reason in arrivals.items():
        assert relay.offer(CanFrame(COMMAND, b""), time) == reason, time


def test_only_the_stated_kind_of_identifier_passes() -> None:
    """A frame with 29 bits is another than the frame with the same number and 11 bits."""
    relay = make_relay()
    assert relay.offer(CanFrame(COMMAND, b"", extended=True), 0.0) == "not allowed"
    bus = drives().buses[0]
    frames = [replace(f, extended=f.cob_id in (COMMAND, STATE)) for f in bus.frames]
    relay = Relay(replace(bus, frames=tuple(frames)))
    assert relay.offer(CanFrame(COMMAND, b""), 0.0) == "not allowed"
    command = CanFrame(COMMAND, b"\1", extended=True)
    assert relay.offer(command, 0.0) == ""
    assert relay.next_outgoing() == command
    relay.take(STATE, b"\1", 0.0)
    relay.take(STATE | EXTENDED, b"\2", 0.0)
    assert [r.frame for r in relay.received()] == [CanFrame(STATE, b"\2", extended=True)]
