"""Load of a CAN bus and worst-case response times of its frames.

After Davis, Burns, Bril and Lukkien, "Controller Area Network (CAN)
schedulability analysis: Refuted, revisited and revised", Real-Time Systems 35
(2007), section 3: every instance in the busy period of a frame's priority is
looked at.  All arithmetic is on whole picoseconds, rounded to the safe side.

What is taken for granted of a bus (``frame_streams``):

- every sender offers the most urgent of its frames first;
- the master sends its commands, then SYNC, and in each control cycle at most one
  frame on demand besides (NMT, SDO or a command without a period), and a node
  answers an SDO within a cycle;
- there is one EMCY in a control cycle, of all nodes together (when many nodes fail
  at once the robot stops, and nobody waits for its commands);
- a node sends another frame on demand once a control cycle at most, and a relayed
  frame comes no more often than its limit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from thorvaldc.model.bus import Bus, Frame

MASTER = "master"
_SECOND = 10**12  # ps
_LONGEST = 100 * _SECOND  # beyond, a response time is of no use
_ROUNDS = 100  # of jitters that depend on one another; on a bus that works there are two or three
_REQUEST, _ANSWER, _EMERGENCY = "request", "answer", "emergency"


class Stream(NamedTuple):
    """Frames of one identifier: ``bits`` long with stuffing, ``period`` s apart at least.

    A frame may be due up to ``jitter`` s late.  The lower identifier wins the bus.
    Of the streams of a ``group`` only one has a frame in a period; they have
    period and jitter in common.
    """

    identifier: int
    bits: int
    period: float
    jitter: float = 0.0
    group: str = ""


def frame_bits(length: int) -> int:
    """Bits of a standard frame of ``length`` bytes at worst, stuffing included.

    47 bits of overhead with the interframe space, and a stuff bit for every four
    of the 34 + 8n bits that are stuffed, after the first.
    """
    return 47 + 8 * length + (34 + 8 * length - 1) // 4


def response_times(streams: Sequence[Stream], bitrate: int) -> list[float | None]:
    """The longest time in s from when a frame is due until it is received, for each stream.

    It counts from the instant without jitter, as a deadline does, and includes
    the interframe space.  ``None``: no bound, because frames of its priority and
    above ask for the whole bus.  Identifiers must differ.
    """
    bit = -(-_SECOND // bitrate)
    order = sorted(range(len(streams)), key=lambda i: streams[i].identifier)
    blocked = [0] * len(streams)
    longest = 0
    for i in reversed(order):
        blocked[i] = longest
        longest = max(longest, streams[i].bits * bit)
    # More urgent frames matter only by period and jitter: one sum for each pair,
    # and one entry for each group.
    above: dict[tuple[int, int, str], int] = {}
    found: list[float | None] = [None] * len(streams)
    for i in order:
        stream = streams[i]
        length, period = stream.bits * bit, max(1, int(stream.period * _SECOND))
        jitter = math.ceil(stream.jitter * _SECOND)
        others = [(t, j, c) for (t, j, _), c in above.items()]
        if length / period + sum(c / t for t, _, c in others) < 1.0:
            time = _longest(length, period, jitter, blocked[i], others, bit)
            found[i] = time / _SECOND if time is not None else None
        key = (period, jitter, stream.group)
        above[key] = max(above.get(key, 0), length) if stream.group else above.get(key, 0) + length
    return found


def _longest(
    length: int,
    period: int,
    jitter: int,
    blocked: int,
    above: Sequence[tuple[int, int, int]],
    bit: int,
) -> int | None:
    """The longest response time in ps; ``above`` are (period, jitter, length) of others."""
    worst = wait = instance = 0
    while wait < _LONGEST:
        wait = _settled(blocked + instance * length, wait, above, bit)  # then it gets the bus
        worst = max(worst, jitter + wait - instance * period + length)
        instance += 1
        # More urgent frames that come while it is sent lengthen the busy period.
        end = _settled(blocked + instance * length, wait + length, above, 0)
        if end + jitter <= instance * period:
            return worst
    return None


def _settled(own: int, time: int, above: Sequence[tuple[int, int, int]], bit: int) -> int:
    """The least time from ``time`` on at which all that came before, and ``own``, is sent."""
    while True:
        needed = own
        for period, jitter, length in above:
            needed += -(-(time + jitter + bit) // period) * length
        if needed <= time or time > _LONGEST:
            return time
        time = needed


# -- a robot's bus ----------------------------------------------------------------------


def bus_load(bus: Bus) -> float:
    """Share of the bus's time that is taken at worst.

    Counted are periodic frames, relayed ones at their limit, and in each control
    cycle one frame on demand of the master and one SDO's answer.
    """
    bits, groups = 0.0, dict[str, int]()
    for frame in bus.frames:
        length = frame_bits(frame.length)
        group = _group(frame)
        if group == _EMERGENCY:
            continue
        if group:
            groups[group] = max(groups.get(group, 0), length)
        elif frame.period is not None:
            bits += length / frame.period
        elif frame.kind == "relay" and frame.minimum_interval is not None:
            bits += length / frame.minimum_interval
    return (bits + sum(groups.values()) / bus.sync_period) / bus.bitrate


def frame_response_times(bus: Bus) -> dict[str, float | None]:
    """Response times in s of the bus's frames by name, as ``response_times`` has them.

    Those of commands, of SYNC, of what is sent at the SYNC, and of an SDO with its
    answer count from the beginning of the control cycle.
    """
    names = [frame.name for frame in bus.frames]
    jitter = {frame.name: bus.sync_period for frame in bus.frames if _group(frame) == _ANSWER}
    for _ in range(_ROUNDS):
        found = response_times(frame_streams(bus, jitter), bus.bitrate)
        times = dict(zip(names, found, strict=True))
        late = _lateness(bus, times)
        if late is None:
            return dict.fromkeys(names)
        if late.items() <= jitter.items():
            return times
        jitter.update(late)
    return dict.fromkeys(names)


def frame_streams(bus: Bus, jitter: Mapping[str, float]) -> list[Stream]:
    """The bus's frames as streams, in their order; ``jitter`` in s by the frame's name."""
    return [
        Stream(
            frame.cob_id,
            frame_bits(frame.length),
            frame.period or frame.minimum_interval or bus.sync_period,
            jitter.get(frame.name, 0.0),
            _group(frame),
        )
        for frame in bus.frames
    ]


def _group(frame: Frame) -> str:
    """Frames of which there is one in a control cycle, or empty."""
    if frame.period is not None or frame.kind == "relay":
        return ""
    if frame.producer == MASTER:
        return _REQUEST
    return {"sdo": _ANSWER, "emcy": _EMERGENCY}.get(frame.kind, "")


def _lateness(bus: Bus, times: Mapping[str, float | None]) -> dict[str, float] | None:
    """How late SYNC is after the commands, and what is sent at the SYNC; ``None``: no bound."""
    commands = [
        times[f.name]
        for f in bus.frames
        if f.producer == MASTER and f.period is not None and f.kind == "pdo"
    ]
    late: dict[str, float] = {}
    for frame in bus.frames:
        if frame.kind == "sync":
            if None in commands or times[frame.name] is None:
                return None
            late[frame.name] = max((t for t in commands if t is not None), default=0.0)
            at_sync = times[frame.name] or 0.0
            for other in bus.frames:
                if other.synchronous and other.producer != MASTER:
                    late[other.name] = at_sync
    return late
