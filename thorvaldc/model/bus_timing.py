"""The load of a CAN bus, the worst-case response times of its CAN frames, and the time in which
the driver reads all objects of the nodes.

The analysis follows Davis, Burns, Bril and Lukkien, "Controller Area Network (CAN) schedulability
analysis: Refuted, revisited and revised", Real-Time Systems 35 (2007), section 3. A level-m busy
period is a time in which the bus always has CAN frames of priority m or higher to send. Response
time R(k) of instance k of a CAN frame in the busy period:

    R(k) = J + w(k) - k T + C,
    w(k) = B + k C + sum over more urgent frames i of ceil((w(k) + J_i + bit) / T_i) C_i.

The symbols are:

- C: transmission time of the frame.
- T: period of the frame.
- J: jitter of the frame.
- B: transmission time of the longest frame of lower priority. A CAN frame that is being sent cannot
  be interrupted by a frame of higher priority.
- bit: duration of one bit.

The analysis computes the response time of every instance of the CAN frame in the busy period. In
each control cycle, the CAN bus carries the commands first, then SYNC, and then the reports of the
nodes. Because of this fixed order, CAN frames of one control cycle delay each other less, see
``_critical_instants``:

    0 s                                                     sync_period
    |command 1|command 2|...|SYNC|report 1|report 2|...     |command 1|...
     stage 0                 1    stage 2

All times in the analysis are integers in picoseconds. Times are rounded so that the computed
worst-case response time is never too short.

Assumptions of ``frame_streams``:

- Every node sends the most urgent of its waiting frames first.
- In each control cycle, the master sends its commands first and SYNC after the commands.
- In each control cycle, the master sends at most one frame on demand. A CAN frame on demand of the
  master is an NMT frame, an SDO or a command without a period.
- A node answers an SDO within one control cycle.
- All nodes together send at most one EMCY frame in a control cycle. If many nodes fail at the same
  time, the robot stops, so late commands do no harm.
- A node sends any other frame on demand at most once in a control cycle.
- A relayed frame is not more frequent than its limit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from thorvaldc.model import Bus, FrameDefinition, Node, ObjectValue, Robot
from thorvaldc.model.bus import MASTER
from thorvaldc.model.number_origins import derived
from thorvaldc.model.stopping import motor_nodes
from thorvaldc.model.sums import float_sum

_SECOND = 10**12  # ps
_LONGEST = 100 * _SECOND  # a longer response time counts as no bound
_ROUNDS = 100  # limit of the iterations over jitters; a working bus needs two or three
_REQUEST, _ANSWER, _EMERGENCY = "request", "answer", "emergency"


class Stream(NamedTuple):
    """All CAN frames with one identifier.

    - ``identifier``: number of the CAN frame in the arbitration, which the lower number wins.
    - ``bits``: length of a frame in bits, including stuff bits.
    - ``period``: shortest time in s between two frames.
    - ``jitter``: largest delay in s until a frame is due.
    - ``group``: name of a group of streams with the same period and the same jitter. All streams of
      a group together send one CAN frame in a period.
    - ``stage``: number of the stage in the control cycle, ``None`` for a stream outside the control
      cycle.

    A stream with a ``stage`` sends one CAN frame in each control cycle. For a stream with a
    ``stage``, ``period`` is the period of the control cycle. The CAN frame of the stream is due at
    most ``jitter`` s after the beginning of the control cycle. The CAN frames of a stage are sent
    after the CAN frames of all lower stages in the control cycle.
    """

    identifier: int
    bits: int
    period: float
    jitter: float = 0.0
    group: str = ""
    stage: int | None = None


def worst_case_bits(length: int, extended: bool = False) -> int:
    """Return the largest number of bits of a CAN frame with ``length`` data bytes.

    A CAN frame with n data bytes has 8 n data bits and 47 other bits (67 with a 29-bit identifier),
    including 3 bits of interframe space. The CAN controller inserts stuff bits into all but the
    last 13 of them. In the worst case, it inserts a stuff bit after the first five bits, and then a
    stuff bit after every four bits.
    """
    stuffed = (54 if extended else 34) + 8 * length
    return stuffed + (stuffed - 1) // 4 + 13


def response_times(streams: Sequence[Stream], bitrate: int) -> list[float | None]:
    """Return the worst-case response time in s of the CAN frames of each stream.

    The response time of a CAN frame begins when the frame is due without jitter. The response time
    of a CAN frame ends when the frame and the interframe space after the frame are received. The
    response time is ``None`` if CAN frames of the same or higher priority use the whole bandwidth
    of the bus. Each stream must have a different CAN identifier.
    """
    bit = -(-_SECOND // bitrate)
    order = sorted(range(len(streams)), key=lambda i: streams[i].identifier)
    blocked = [0] * len(streams)
    longest = 0
    for i in reversed(order):
        blocked[i] = longest
        longest = max(longest, streams[i].bits * bit)
    # The delay of a CAN frame depends only on the periods, jitters and lengths of more urgent CAN
    # frames. CAN frames with the same period and jitter are therefore stored as one entry with the
    # sum of their lengths, and each group of streams has one entry. CAN frames of the control cycle
    # with the same period, jitter and stage are also stored as one entry.
    above: dict[tuple[int, int, str], int] = {}
    cycle: dict[tuple[int, int, int], int] = {}
    bounds: list[float | None] = [None] * len(streams)
    for i in order:
        stream = streams[i]
        length, period = stream.bits * bit, max(1, int(stream.period * _SECOND))
        jitter = math.ceil(stream.jitter * _SECOND)
        more_urgent = [(t, j, c, _ANY) for (t, j, _), c in above.items()]
        share = float_sum([c / t for t, _, c, _ in more_urgent]) + float_sum(
            [c / t for (t, _, _), c in cycle.items()]
        )
        if length / period + share < 1.0:
            times = [
                _longest(length, period, lead, blocked[i], more_urgent + cycle_frames, bit)
                for lead, cycle_frames in _critical_instants(period, jitter, stream.stage, cycle)
            ]
            if None not in times:
                bound = max(t for t in times if t is not None) / _SECOND
                bounds[i] = derived(bound, streams, bitrate)
        if stream.stage is not None:
            staged = (period, jitter, stream.stage)
            cycle[staged] = cycle.get(staged, 0) + length
            continue
        key = (period, jitter, stream.group)
        above[key] = max(above.get(key, 0), length) if stream.group else above.get(key, 0) + length
    return bounds


_Other = tuple[int, int, int, int]
"""A more urgent frame: (period, lead, length, most). Period, lead and length are in ps.

Instance n of a more urgent frame, counted from 0, is due at ``n * period - lead``. If this time is
negative, instance n is due at 0. At most ``most + k`` instances of the more urgent frame are sent
before instance k of the examined frame.
"""
_ANY = 1 << 60


def _critical_instants(
    period: int, jitter: int, stage: int | None, cycle: Mapping[tuple[int, int, int], int]
) -> Iterator[tuple[int, list[_Other]]]:
    """Yield the leads of a CAN frame and of the more urgent CAN frames for each candidate.

    A candidate is a time in the control cycle at which the worst busy period of the CAN bus can
    begin. The worst busy period begins with a CAN frame of the control cycle that has its largest
    jitter (Palencia and Gonzalez Harbour, "Schedulability analysis for tasks with static and
    dynamic offsets", RTSS 1998). There is therefore one candidate for each CAN frame of the control
    cycle.
    """
    if not cycle:
        yield jitter, []
        return
    begins = {late: None for _, late, _ in cycle}
    if stage is not None:
        begins[jitter] = None
    for begin in begins:
        # The busy period can contain CAN frames of earlier control cycles that are late because of
        # jitter, so the first instance belongs to the earliest such cycle.
        first = -((jitter - begin) // period)
        others: list[_Other] = []
        for (cycle_time, late, other_stage), length in cycle.items():
            number = -((late - begin) // cycle_time)
            later = stage is not None and other_stage > stage
            most = max(first - number, 0) if later else _ANY
            others.append((cycle_time, begin - number * cycle_time, length, most))
        yield (jitter if stage is None else begin - first * period), others


def _longest(
    length: int, period: int, lead: int, blocked: int, above: Sequence[_Other], bit: int
) -> int | None:
    """Return the longest response time of a CAN frame in ps.

    ``above`` lists the CAN frames with a higher priority. Returns ``None`` if the response time of
    the CAN frame is longer than 100 s.
    """
    worst = wait = instance = 0
    while wait < _LONGEST:
        # ``wait`` is the time in ps until the bus starts to send this instance of the CAN frame.
        wait = _fixed_point(blocked + instance * length, wait, above, instance, bit)
        if wait + lead < 0:
            return worst  # the busy period ends before this instance is due
        worst = max(worst, lead + wait - instance * period + length)
        instance += 1
        # CAN frames with a higher priority that become due during the transmission extend the busy
        # period.
        end = _fixed_point(blocked + instance * length, wait + length, above, instance, 0)
        if end + lead <= instance * period:
            return worst
    return None


def _fixed_point(own: int, time: int, above: Sequence[_Other], instance: int, bit: int) -> int:
    """Return the time in ps at which the bus has sent a CAN frame and all more urgent CAN frames.

    ``own`` is the transmission time in ps of the blocking CAN frame and of the examined CAN frame.
    ``time`` is the time in ps at which the fixed-point iteration begins. The function solves the
    equation for w(k) in the docstring of this module by fixed-point iteration.
    """
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
    """Return the worst-case load of a CAN bus, as a fraction of its bandwidth.

    The bus load includes all periodic CAN frames, and the relayed CAN frames at their highest
    allowed rate. The bus load also includes one CAN frame on demand of the master and one SDO
    answer in each control cycle.
    """
    bits, groups = 0.0, dict[str, int]()
    for frame in bus.frames:
        length = worst_case_bits(frame.length, frame.extended)
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
    """Return the worst-case response time in s of each CAN frame of a bus by frame name.

    The response times of commands, SYNC, synchronous PDOs and SDO answers count from the beginning
    of the control cycle. The value ``None`` means that the response time of the CAN frame has no
    upper bound. ``bits`` maps the names of CAN frames to their exact lengths in bits, if the
    lengths are known.

    The jitter of a CAN frame depends on the response times of the CAN frames that trigger it. The
    master sends SYNC after the commands, and the nodes send the synchronous PDOs after SYNC. The
    response times are computed again until the jitter of no CAN frame grows.
    """
    names = [frame.name for frame in bus.frames]
    jitter = {frame.name: bus.sync_period for frame in bus.frames if _group(frame) == _ANSWER}
    for _ in range(_ROUNDS):
        bounds = response_times(frame_streams(bus, jitter, bits or {}), bus.bitrate)
        times = dict(zip(names, bounds, strict=True))
        late = _lateness(bus, times)
        if late is None:
            return dict.fromkeys(names)
        if late.items() <= jitter.items():
            return times
        jitter.update(late)
    return dict.fromkeys(names)


def frame_streams(bus: Bus, jitter: Mapping[str, float], bits: Mapping[str, int]) -> list[Stream]:
    """Return the CAN frames of a bus as streams, in the order of ``Bus.frames``.

    ``jitter`` maps the names of CAN frames to their jitter in s. ``bits`` maps the names of CAN
    frames to their lengths in bits.
    """
    return [
        Stream(
            frame.arbitration,
            bits.get(frame.name) or worst_case_bits(frame.length, frame.extended),
            frame.period or frame.minimum_interval or bus.sync_period,
            jitter.get(frame.name, 0.0),
            _group(frame),
            _stage(frame, bus),
        )
        for frame in bus.frames
    ]


def _group(frame: FrameDefinition) -> str:
    """Return the group of a CAN frame on demand, or an empty text for a CAN frame without a group.

    At most one CAN frame of a group is sent in each control cycle.
    """
    if frame.period is not None or frame.kind == "relay":
        return ""
    if frame.producer == MASTER:
        return _REQUEST
    return {"sdo": _ANSWER, "emcy": _EMERGENCY}.get(frame.kind, "")


def _stage(frame: FrameDefinition, bus: Bus) -> int | None:
    """Return the stage of a CAN frame in the control cycle.

    Stage 0 of the control cycle has the commands, stage 1 the SYNC frame, and stage 2 the
    synchronous PDOs of the nodes.
    """
    if frame.period != bus.sync_period:
        return None
    if frame.producer == MASTER:
        return {"pdo": 0, "sync": 1}.get(frame.kind)
    return 2 if frame.synchronous else None


def _lateness(bus: Bus, times: Mapping[str, float | None]) -> dict[str, float] | None:
    """Return the jitter in s of the SYNC frame and of each synchronous PDO, by frame name.

    Returns ``None`` if the response time of a CAN frame has no upper bound.
    """
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


# -- objects of the CANopen nodes ----------------------------------------------------------------
#
# The objects that must have the values of the robot file:
#
# - `can flash` writes the objects that can be written, and `can verify` compares them all;
# - the base driver compares them all at the start-up, and reads them again and again;
# - docs/faults.md tells for each group of objects why its values matter.
#
# While a robot runs, another interface of a drive (USB, a service tool) can change each of these
# objects, and nothing else on the bus shows it.  The base driver reads one object in each control
# cycle T on each bus.  With N objects of all nodes of the bus, a change is found within N T, as
# long as each node answers within a cycle:
#
#     cycle    |    1    |    2    |    3    |         |    N    |   N + 1
#     driver   RPDO SYNC SDO upload of object 1        ...  N         1
#     node               value of object 1


def written_objects(node: Node) -> Iterator[ObjectValue]:
    """Yields the objects that `can flash` writes."""
    return (entry for entry in node.objects if entry.access == "rw" and entry.value is not None)


def required_objects(bus: Bus, node: Node) -> Iterator[ObjectValue]:
    """Yields the objects that the base driver compares with the robot file.

    They are the objects with a value, but not those that an RPDO contains: the base driver writes
    them itself, in each control cycle, and a drive keeps the last value of an earlier run, such as
    the mode of operation of a homing.
    """
    commanded = {
        (index, subindex)
        for frame in bus.frames
        if frame.producer == MASTER and node.name in frame.consumers
        for index, subindex, _ in frame.mapping
    }
    return (
        entry
        for entry in node.objects
        if entry.value is not None and (entry.index, entry.subindex) not in commanded
    )


def reading_time(bus: Bus, cycle: float) -> float:
    """Returns the time in s in which the base driver reads all required objects of a bus once.

    ``cycle``: control cycle of the robot in s.
    """
    motors = [n for n in bus.nodes if any(c.actuator is not None for c in n.channels)]
    return cycle * sum(1 for node in motors for _ in required_objects(bus, node))


def start_reading_time(robot: Robot) -> float:
    """Returns the time in s in which the base driver reads all required objects at its start.

    It reads one object of each motor controller per control cycle, while it reads one of each bus
    during the drive (``reading_time``).
    """
    counts = [len(list(required_objects(bus, node))) for bus, node in motor_nodes(robot)]
    return max(counts, default=0) / robot.driver.rate
