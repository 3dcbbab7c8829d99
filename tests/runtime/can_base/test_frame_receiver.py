"""The frame receiver: newest reports, the queue of events, and lost interfaces."""

from __future__ import annotations

import pytest

from thorvaldc.can.frame import CanFrame, ReceivedFrame
from thorvaldc.model.bus import EXTENDED
from thorvaldc.runtime.can_base.frame_receiver import FrameReceiver


class FedInterface:
    """A CAN interface that receives the frames it is given."""

    now: float = 0.0
    received_until = 0.0
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


def receiver(limit: int = 4) -> tuple[FrameReceiver, FedInterface]:
    fed = FedInterface()
    return FrameReceiver(fed, {0x181}, limit=limit), fed  # type: ignore[arg-type]


def test_a_full_queue_drops_the_oldest() -> None:
    """The original software kept the oldest and lost the new ones."""
    frame_receiver, fed = receiver()
    fed.feed(*(CanFrame(0x181, bytes([i])) for i in range(10)))
    assert [data[0] for _, _, data in frame_receiver.drain()] == [6, 7, 8, 9]
    assert frame_receiver.dropped == 6
    assert frame_receiver.latest[0x181].data == b"\x09"
    assert frame_receiver.latest[0x181].number == 10
    assert frame_receiver.drain() == []


def test_only_the_newest_report_is_kept() -> None:
    frame_receiver, fed = receiver()
    fed.feed(*(CanFrame(0x281, bytes([i])) for i in range(10)))
    assert frame_receiver.drain() == []
    assert frame_receiver.dropped == 0
    assert frame_receiver.latest[0x281].data == b"\x09"
    assert frame_receiver.latest[0x281].time == 0.009


def test_extended_remote_and_own_frames_are_ignored() -> None:
    frame_receiver, fed = receiver()
    fed.feed(CanFrame(0x181, b"\1", extended=True), CanFrame(0x181, remote=True, requested=8))
    fed.feed(CanFrame(0x181, b"\1"), own=True)
    assert frame_receiver.drain() == []
    assert frame_receiver.latest == {}
    assert frame_receiver.ignored == 2


def test_the_load_counts_all_frames_of_the_bus_once() -> None:
    """A standard frame with n bytes has at most 55 + 10 n bits, an extended one 80 + 10 n."""
    frame_receiver, fed = receiver()
    frame_receiver.drain()
    fed.feed(CanFrame(0x181, bytes(8)), CanFrame(0x18123, bytes(8), extended=True))
    fed.feed(CanFrame(0x201, bytes(8)), own=True)
    frame_receiver.count_sent(CanFrame(0x201, bytes(8)))
    fed.now = 0.9
    frame_receiver.drain()
    assert frame_receiver.bits_per_second is None
    fed.now = 2.0
    frame_receiver.drain()
    assert frame_receiver.bits_per_second == (135 + 160 + 135) / 2.0
    fed.now = 3.0
    frame_receiver.drain()
    assert frame_receiver.bits_per_second == 0.0


def test_known_extended_frames_are_other_frames() -> None:
    fed = FedInterface()
    key = 0x181 | EXTENDED
    frame_receiver = FrameReceiver(fed, {key}, {key, 0x281 | EXTENDED})  # type: ignore[arg-type]
    fed.feed(CanFrame(0x181, b"\1"), CanFrame(0x181, b"\2", extended=True))
    fed.feed(CanFrame(0x281, b"\3", extended=True), CanFrame(0x381, b"\4", extended=True))
    assert [(event.key, event.data) for event in frame_receiver.drain()] == [(key, b"\2")]
    assert {key: newest.data for key, newest in frame_receiver.latest.items()} == {
        0x181: b"\1",
        key: b"\2",
        0x281 | EXTENDED: b"\3",
    }
    assert (frame_receiver.received, frame_receiver.ignored) == (3, 1)
    assert frame_receiver.ignored_id is None


@pytest.mark.parametrize("threaded", [False, True])
def test_a_lost_interface_is_reported(threaded: bool) -> None:
    frame_receiver, fed = receiver()
    fed.broken = True
    if threaded:
        frame_receiver.start()
        assert frame_receiver._receiving is not None
        frame_receiver._receiving.join(2.0)
    frame_receiver.drain()
    assert frame_receiver.lost == "unplugged"
    frame_receiver.stop()
