"""Random buses, and traffic on a simulated wire that does all that the budget allows for.

Every sender keeps to what ``model.bus_timing`` takes for granted of it, and no more.  What the
budget leaves open is drawn from a seed, or chosen to be as bad for one frame as it can be:
all that goes before it comes at the same instant, just after a less urgent frame has begun.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache

from thorvaldc.can.frame import INTERFRAME_BITS, CanFrame
from thorvaldc.can.frame import frame_bits as exact_bits
from thorvaldc.can.nanoseconds import to_ns
from thorvaldc.diagnostics import Span
from thorvaldc.model.bus import Bus, FrameDefinition
from thorvaldc.model.bus_timing import MASTER, bus_load, frame_response_times
from thorvaldc.simulation.bus.can_controller import CanController
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import Wire

_SPAN = Span("traffic", 1, 1)
_PATTERNS = (0x0F, 0x1E, 0x3C, 0x78, 0x87, 0xC3, 0xE1, 0xF0)
"""Bytes that, repeated, ask for a stuff bit after every four; which is worst, the header says."""
QUEUE = 256
FIRST_CYCLE = 2
"""Cycles before the one in which the worst is made to happen."""


def random_bus(number: int) -> Bus:
    """A bus as the compiler makes and accepts them: drives, batteries, a foreign device."""
    draw = random.Random(f"bus {number}")
    while True:
        cycle = draw.choice((0.01, 0.02, 0.02, 0.05))
        frames = tuple(_frames(draw, cycle))
        bus = Bus(
            "main", draw.choice((125_000, 250_000, 500_000, 1_000_000)), cycle, (), frames, _SPAN
        )
        times = frame_response_times(bus)
        timely = all(time is not None for time in times.values()) and all(
            f.deadline is None or (times[f.name] or 0.0) <= f.deadline for f in frames
        )
        if timely and 0.2 <= bus_load(bus) <= 0.8:
            timed = tuple(replace(f, response_time=times[f.name]) for f in frames)
            return replace(bus, frames=timed, load=bus_load(bus))


def _frames(draw: random.Random, cycle: float) -> Iterator[FrameDefinition]:
    synchronous = draw.random() < 0.5
    yield _frame(0x000, "nmt", MASTER, 2)
    yield _frame(0x080, "sync", MASTER, 0, cycle)
    yield _frame(0x77F, "heartbeat", MASTER, 1, 0.1)
    report_periods = (cycle, 2 * cycle, 0.1, 0.5)
    for node in sorted(draw.sample(range(1, 32), draw.randint(1, 10))):
        name = f"node{node}"
        for rpdo in draw.sample((0x200, 0x300, 0x400, 0x500), draw.randint(1, 2)):
            period = cycle if rpdo < 0x400 or draw.random() < 0.5 else None
            yield _frame(rpdo + node, "pdo", MASTER, draw.randint(2, 8), period, to=name)
        for tpdo in draw.sample((0x180, 0x280, 0x380, 0x480), draw.randint(1, 3)):
            at_sync = synchronous and draw.random() < 0.7
            period = cycle if at_sync else draw.choice(report_periods)
            found = _frame(tpdo + node, "pdo", name, draw.randint(2, 8), period)
            yield replace(found, synchronous=at_sync)
        yield _frame(0x580 + node, "sdo", name, 8)
        yield _frame(0x600 + node, "sdo", MASTER, 8, to=name)
        yield _frame(0x700 + node, "heartbeat", name, 1, draw.choice((0.1, 0.2, 0.5)))
        yield _frame(0x080 + node, "emcy", name, 8)
    for battery in range(draw.randint(0, 3)):
        for first in (0x3C0, 0x3D0, 0x3E0):
            yield _frame(first + battery, "broadcast", f"battery{battery}", 8, 0.1)
    if draw.random() < 0.5:
        yield replace(
            _frame(0x1F0, "relay", "foreign", 8), minimum_interval=draw.choice((0.02, 0.1))
        )
        yield replace(_frame(0x2F0, "relay", MASTER, 8), minimum_interval=0.1)


def _frame(
    cob_id: int,
    kind: str,
    producer: str,
    length: int,
    period: float | None = None,
    to: str = "",
) -> FrameDefinition:
    return FrameDefinition(
        f"{kind}_{cob_id:03x}", cob_id, kind, producer, (to,), length, period, period, (), _SPAN
    )


@cache
def worst_payload(cob_id: int, length: int) -> CanFrame:
    """The frame with the data that need most stuff bits, as far as a short search finds them."""
    best = max(
        (CanFrame(cob_id, bytes([p]) * length) for p in _PATTERNS),
        key=exact_bits,
    )
    for place in range(length):
        data = best.data
        tries = (data[:place] + bytes([p]) + data[place + 1 :] for p in range(256))
        best = max((best, *(CanFrame(cob_id, t) for t in tries)), key=exact_bits)
    return best


# -- traffic ---------------------------------------------------------------------------------


@dataclass
class Traffic:
    """A bus's traffic in one run.  ``seen`` is the longest response time in s by frame name.

    With a ``target`` the worst is made to happen to that frame; all else comes as ``seed`` says.
    """

    bus: Bus
    seed: int
    target: FrameDefinition | None = None
    seen: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._draw = random.Random(f"traffic {self.seed}")
        self._timeline = Timeline()
        self._wire = Wire(self._timeline, self.bus.bitrate)
        names = sorted({frame.producer for frame in self.bus.frames})
        self._controllers = {name: self._controller(name) for name in names}
        self._controller("listener")
        self._cycle = to_ns(self.bus.sync_period)
        self._frames = {frame.cob_id: frame for frame in self.bus.frames}
        self._sent = {f.cob_id: worst_payload(f.cob_id, f.length) for f in self.bus.frames}
        self._due: dict[int, deque[int]] = {f.cob_id: deque() for f in self.bus.frames}
        self._interframe = INTERFRAME_BITS * 1_000_000_000 // self.bus.bitrate
        self._critical = FIRST_CYCLE * self._cycle
        self._open_commands = 0
        self._cycle_start = 0
        self._asked: dict[str, int] = {}

    def run(self, cycles: int = 12) -> dict[str, float]:
        """So many control cycles from the start; gives ``seen``."""
        end = cycles * self._cycle
        for start in range(self._cycle, end, self._cycle):
            self._timeline.at(start, self._commands)
        self._one_a_cycle("request", end)
        self._one_a_cycle("emcy", end)
        for frame in self.bus.frames:
            self._alone(frame, end)
        self._timeline.run_until(end + self._cycle)
        return self.seen

    # -- who sends what ------------------------------------------------------------------------

    def _controller(self, name: str) -> CanController:
        controller = CanController(self._wire, name, self.bus.bitrate, queue_limit=QUEUE)
        controller.on_sent = self._through
        controller.on_frame = lambda frame: self._heard(name, frame)
        self._wire.attach(controller)
        controller.switch_on()
        return controller

    def _send(self, frame: FrameDefinition, due: int) -> None:
        self._due[frame.cob_id].append(due)
        self._controllers[frame.producer].send(self._sent[frame.cob_id])

    def _commands(self) -> None:
        """The master's commands; SYNC follows when the last of them is through."""
        self._cycle_start = self._timeline.now
        for frame in self.bus.frames:
            if frame.producer == MASTER and frame.period is not None and frame.kind == "pdo":
                self._open_commands += 1
                self._send(frame, self._cycle_start)
        if not self._open_commands:
            self._sync()

    def _sync(self) -> None:
        for frame in self.bus.frames:
            if frame.kind == "sync":
                self._send(frame, self._cycle_start)

    def _one_a_cycle(self, group: str, end: int) -> None:
        """Requests of the master, or emergencies of anybody: one in a cycle."""
        if group == "emcy":
            choice = [f for f in self.bus.frames if f.kind == "emcy"]
        else:
            choice = [
                f
                for f in self.bus.frames
                if f.producer == MASTER and f.period is None and f.kind != "relay"
            ]
        if not choice:
            return
        urgent = [f for f in choice if self._goes_before(f)]
        # With the target, or so that the answer that one of them has comes with it.
        before = urgent or self._with_urgent_answer(choice)
        phase = self._phase((before or choice)[0], self._cycle)
        if before:
            phase = self._critical % self._cycle
        for start in range(phase, end, self._cycle):
            frame = self._draw.choice(choice)
            if start == self._critical and urgent:
                answered = self._with_urgent_answer(urgent)
                frame = max(urgent, key=lambda f: (f.length, f in answered))
            if start == self._critical - self._cycle:
                frame = self._draw.choice(self._with_urgent_answer(choice) or choice)
            if start == self._critical and self.target in choice:
                frame = self.target
            self._timeline.at(start, lambda f=frame: self._request(f))  # type: ignore[misc]

    def _with_urgent_answer(self, choice: list[FrameDefinition]) -> list[FrameDefinition]:
        """Requests that are answered with a frame that goes before the target."""
        urgent = {f.producer for f in self.bus.frames if f.kind == "sdo" and self._goes_before(f)}
        return [f for f in choice if f.kind == "sdo" and f.consumers[0] in urgent]

    def _request(self, frame: FrameDefinition) -> None:
        if frame.kind == "sdo":
            self._asked[frame.consumers[0]] = self._timeline.now
        self._send(frame, self._timeline.now)

    def _alone(self, frame: FrameDefinition, end: int) -> None:
        """What a device sends of itself, as often as it may."""
        interval = frame.period if frame.kind != "relay" else frame.minimum_interval
        grouped = frame.kind == "pdo" and frame.producer == MASTER
        if interval is None or grouped or frame.kind == "sync" or frame.synchronous:
            return
        period = to_ns(interval)
        for start in range(self._phase(frame, period), end, period):
            self._timeline.at(start, lambda: self._send(frame, self._timeline.now))

    def _phase(self, frame: FrameDefinition, period: int) -> int:
        """When it comes first: what goes before the target with it, what blocks just before."""
        if self.target is not None:
            if self._goes_before(frame) or frame.cob_id == self.target.cob_id:
                return self._critical % period
            if frame.cob_id == self._blocker():
                return (self._critical - 1) % period
        return self._draw.randrange(period)

    def _goes_before(self, frame: FrameDefinition) -> bool:
        return self.target is not None and frame.cob_id < self.target.cob_id

    def _blocker(self) -> int:
        """The longest less urgent frame that comes by itself."""
        less = [
            f
            for f in self.bus.frames
            if self.target is not None
            and f.cob_id > self.target.cob_id
            and f.period is not None
            and f.producer != MASTER
            and not f.synchronous
        ]
        return max(less, key=lambda f: exact_bits(self._sent[f.cob_id])).cob_id if less else -1

    # -- what happens on the wire -----------------------------------------------------------------

    def _through(self, sent: CanFrame) -> None:
        frame = self._frames[sent.id]
        # The budget counts until the bus is free again.
        took = self._timeline.now + self._interframe - self._due[sent.id].popleft()
        self.seen[frame.name] = max(self.seen.get(frame.name, 0.0), took / 1e9)
        if frame.producer == MASTER and frame.period is not None and frame.kind == "pdo":
            self._open_commands -= 1
            if not self._open_commands:
                self._sync()

    def _heard(self, name: str, frame: CanFrame) -> None:
        if frame.id == 0x080:
            for other in self.bus.frames:
                if other.synchronous and other.producer == name:
                    self._send(other, self._cycle_start)
        asked = self._frames[frame.id]
        if asked.kind == "sdo" and asked.producer == MASTER and asked.consumers == (name,):
            # The node answers within a cycle of the request.
            began = self._asked[name]
            late = self._cycle if self._draw.random() < 0.3 else self._draw.randrange(self._cycle)
            if self.target is not None and began == self._critical - self._cycle:
                late = self._cycle
            elif self.target is not None and began == self._critical:
                late = 0
            for answer in self.bus.frames:
                if answer.kind == "sdo" and answer.producer == name:
                    self._timeline.at(
                        began + late,
                        lambda a=answer: self._send(a, began),  # type: ignore[misc]
                    )


# -- what the runs say together ----------------------------------------------------------------


@dataclass(frozen=True)
class Reached:
    """Of one bus over several runs: the longest response time of each frame over its bound.

    ``of_bound`` by frame name; ``of_sent`` the same with the bits of the very frames sent
    in place of the worst that any identifier and data can need.
    """

    bus: Bus
    of_bound: dict[str, float]
    of_sent: dict[str, float]

    @property
    def last(self) -> str:
        """The least urgent periodic frame, which waits for all the others."""
        return max((f for f in self.bus.frames if f.period), key=lambda f: f.cob_id).name


def reached(bus: Bus, seeds: int) -> Reached:
    """Half of the runs with a target, the least urgent frames first, half as it comes."""
    order = sorted(bus.frames, key=lambda f: -f.cob_id)
    targets = -(-seeds // 2)
    seen: dict[str, float] = {}
    for seed in range(seeds):
        target = None if seed % 2 else order[seed // 2 * len(order) // targets]
        for name, took in Traffic(bus, seed, target).run().items():
            seen[name] = max(seen.get(name, 0.0), took)
    sent = {f.name: exact_bits(worst_payload(f.cob_id, f.length)) for f in bus.frames}
    bounds, of_sent = frame_response_times(bus), frame_response_times(bus, sent)
    return Reached(
        bus,
        {name: took / (bounds[name] or 1e-9) for name, took in seen.items()},
        {name: took / (of_sent[name] or 1e-9) for name, took in seen.items()},
    )
