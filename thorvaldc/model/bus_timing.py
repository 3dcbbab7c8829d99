"""Load of a CAN bus and worst-case response times of its frames.

After Davis, Burns, Bril and Lukkien, "Controller Area Network (CAN)
schedulability analysis: Refuted, revisited and revised", Real-Time Systems 35
(2007), section 3: every instance in the busy period of a frame's priority is
looked at; and what is sent in one control cycle is taken as a chain (``_beginnings``).
All arithmetic is on whole picoseconds, rounded to the safe side.

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
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from thorvaldc.model.bus import Bus, FrameDefinition

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

    Streams with a ``stage`` belong to one cycle, which is the period of them all: each
    has a frame in it, due at its beginning but for the jitter, and never sent before
    those of a lower stage in that cycle.
    """

    identifier: int
    bits: int
    period: float
    jitter: float = 0.0
    group: str = ""
    stage: int | None = None


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
    # and one entry for each group; those of the cycle by jitter and stage.
    above: dict[tuple[int, int, str], int] = {}
    cycle: dict[tuple[int, int, int], int] = {}
    found: list[float | None] = [None] * len(streams)
    for i in order:
        stream = streams[i]
        length, period = stream.bits * bit, max(1, int(stream.period * _SECOND))
        jitter = math.ceil(stream.jitter * _SECOND)
        others = [(t, j, c, _ANY) for (t, j, _), c in above.items()]
        share = sum([c / t for t, _, c, _ in others]) + sum(
            [c / t for (t, _, _), c in cycle.items()]
        )
        if length / period + share < 1.0:
            times = [
                _longest(length, period, lead, blocked[i], others + also, bit)
                for lead, also in _beginnings(period, jitter, stream.stage, cycle)
            ]
            if None not in times:
                found[i] = max(t for t in times if t is not None) / _SECOND
        if stream.stage is not None:
            staged = (period, jitter, stream.stage)
            cycle[staged] = cycle.get(staged, 0) + length
            continue
        key = (period, jitter, stream.group)
        above[key] = max(above.get(key, 0), length) if stream.group else above.get(key, 0) + length
    return found


_Other = tuple[int, int, int, int]
"""(period, lead, length, most): the n-th frame, from 0, comes at ``n * period - lead`` or, where
that is past, at once; those before the own k-th are at most ``most + k``.  All but the last in ps.
"""
_ANY = 1 << 60


def _beginnings(
    period: int, jitter: int, stage: int | None, cycle: Mapping[tuple[int, int, int], int]
) -> Iterator[tuple[int, list[_Other]]]:
    """The own lead, and the cycle's more urgent frames, for each possible worst case.

    A busy period may begin anywhere in the cycle.  The worst is where a frame of the cycle
    begins it, and is as late as it can be (Palencia and Gonzalez Harbour, "Schedulability
    analysis for tasks with static and dynamic offsets", RTSS 1998).
    """
    if not cycle:
        yield jitter, []
        return
    begins = {late: None for _, late, _ in cycle}
    if stage is not None:
        begins[jitter] = None
    for begin in begins:
        # Of each, the first that can be there: of the earliest cycle where it may be that late.
        first = -((jitter - begin) // period)
        others: list[_Other] = []
        for (length_of_cycle, late, its_stage), length in cycle.items():
            number = -((late - begin) // length_of_cycle)
            later = stage is not None and its_stage > stage
            most = max(first - number, 0) if later else _ANY
            others.append((length_of_cycle, begin - number * length_of_cycle, length, most))
        yield (jitter if stage is None else begin - first * period), others


def _longest(
    length: int, period: int, lead: int, blocked: int, above: Sequence[_Other], bit: int
) -> int | None:
    """The longest response time in ps; ``above`` are the more urgent frames."""
    worst = wait = instance = 0
    while wait < _LONGEST:
        # Then it gets the bus.
        wait = _settled(blocked + instance * length, wait, above, instance, bit)
        if wait + lead < 0:
            return worst  # the busy period is over before it is due
        worst = max(worst, lead + wait - instance * period + length)
        instance += 1
        # More urgent frames that come while it is sent lengthen the busy period.
        end = _settled(blocked + instance * length, wait + length, above, instance, 0)
        if end + lead <= instance * period:
            return worst
    return None


def _settled(own: int, time: int, above: Sequence[_Other], instance: int, bit: int) -> int:
    """The least time from ``time`` on at which all that came before, and ``own``, is sent."""
    while True:
        needed = own
        for period, lead, length, most in above:
            count = -(-(time + lead + bit) // period)
            needed += length * (count if count <= most + instance else most + instance)
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


def frame_response_times(
    bus: Bus, bits: Mapping[str, int] | None = None
) -> dict[str, float | None]:
    """Response times in s of the bus's frames by name, as ``response_times`` has them.

    Those of commands, of SYNC, of what is sent at the SYNC, and of an SDO with its
    answer count from the beginning of the control cycle.  ``bits`` by the frame's name,
    where more is known of its stuffing than the worst.
    """
    names = [frame.name for frame in bus.frames]
    jitter = {frame.name: bus.sync_period for frame in bus.frames if _group(frame) == _ANSWER}
    for _ in range(_ROUNDS):
        found = response_times(frame_streams(bus, jitter, bits or {}), bus.bitrate)
        times = dict(zip(names, found, strict=True))
        late = _lateness(bus, times)
        if late is None:
            return dict.fromkeys(names)
        if late.items() <= jitter.items():
            return times
        jitter.update(late)
    return dict.fromkeys(names)


def frame_streams(bus: Bus, jitter: Mapping[str, float], bits: Mapping[str, int]) -> list[Stream]:
    """The bus's frames as streams, in their order; ``jitter`` (s) and ``bits`` by their names."""
    return [
        Stream(
            frame.cob_id,
            bits.get(frame.name) or frame_bits(frame.length),
            frame.period or frame.minimum_interval or bus.sync_period,
            jitter.get(frame.name, 0.0),
            _group(frame),
            _stage(frame, bus),
        )
        for frame in bus.frames
    ]


def _group(frame: FrameDefinition) -> str:
    """Frames of which there is one in a control cycle, or empty."""
    if frame.period is not None or frame.kind == "relay":
        return ""
    if frame.producer == MASTER:
        return _REQUEST
    return {"sdo": _ANSWER, "emcy": _EMERGENCY}.get(frame.kind, "")


def _stage(frame: FrameDefinition, bus: Bus) -> int | None:
    """Of what each cycle has: commands, then SYNC, then what is sent at the SYNC."""
    if frame.period != bus.sync_period:
        return None
    if frame.producer == MASTER:
        return {"pdo": 0, "sync": 1}.get(frame.kind)
    return 2 if frame.synchronous else None


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
