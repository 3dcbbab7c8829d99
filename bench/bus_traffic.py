"""Random buses, and the worst traffic on a simulated wire that the bus budget allows.

Every sender obeys the assumptions of ``model.bus_timing``, and nothing beyond them.  A seed
determines everything that the budget leaves open, or it is chosen to be the worst case for one
target frame (the critical instant of Davis et al. 2007):

    blocker    |=========|                                 starts one ns before the instant
    urgent 1             |=====|                           all frames with lower identifiers
    urgent 2                   |=====|                     are queued at the instant
    target                           |=====|
               ^ critical instant          ^ response time
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache

from thorvaldc.can.frame import CanFrame, to_ns
from thorvaldc.can.frame_bits import INTERFRAME_BITS
from thorvaldc.can.frame_bits import frame_bits as exact_bits
from thorvaldc.diagnostics import Span
from thorvaldc.model import Bus, FrameDefinition
from thorvaldc.model.bus_timing import MASTER, bus_load, frame_response_times
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import CanController, Wire

_SPAN = Span("traffic", 1, 1)
_PATTERNS = (0x0F, 0x1E, 0x3C, 0x78, 0x87, 0xC3, 0xE1, 0xF0)
"""Bytes that, repeated, need a stuff bit after every 4 bits; the header decides which is worst."""
QUEUE = 256
FIRST_CYCLE = 2
"""Number of control cycles before the critical instant."""


def random_bus(number: int) -> Bus:
    """Returns a bus that the compiler would accept: drives, batteries, a foreign device."""
    return _random_bus(number, 0.2, 0.8, timely=True)


def loaded_bus() -> Bus:
    """Returns a bus at 90 % load, on which some frames may be later than the compiler accepts."""
    return _random_bus(122, 0.9, 0.91, timely=False)


def _random_bus(number: int, least: float, most: float, *, timely: bool) -> Bus:
    draw = random.Random(f"bus {number}")
    while True:
        cycle = draw.choice((0.01, 0.02, 0.02, 0.05))
        frames = tuple(_frames(draw, cycle))
        bus = Bus(
            "main", draw.choice((125_000, 250_000, 500_000, 1_000_000)), cycle, (), frames, _SPAN
        )
        if not least <= bus_load(bus) <= most:
            continue
        times = frame_response_times(bus)
        in_time = (
            f.deadline is None or (times[f.name] or 0.0) <= f.deadline or not timely for f in frames
        )
        if all(time is not None for time in times.values()) and all(in_time):
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
            report = _frame(tpdo + node, "pdo", name, draw.randint(2, 8), period)
            yield replace(report, synchronous=at_sync)
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
    """Returns the frame with the most stuff bits that a short search finds."""
    best = max(
        (CanFrame(cob_id, bytes([p]) * length) for p in _PATTERNS),
        key=exact_bits,
    )
    for position in range(length):
        data = best.data
        variants = (data[:position] + bytes([p]) + data[position + 1 :] for p in range(256))
        best = max((best, *(CanFrame(cob_id, variant) for variant in variants)), key=exact_bits)
    return best


# -- traffic ---------------------------------------------------------------------------------


@dataclass
class Traffic:
    """The traffic of one run.  ``seen``: longest response time (s) by frame name.

    ``target``: the frame for which the run contains the critical instant.  ``seed`` determines
    all other times.
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
        self._requested_at: dict[str, int] = {}

    def run(self, cycles: int = 12) -> dict[str, float]:
        """Runs a number of control cycles; returns ``seen``."""
        end = cycles * self._cycle
        for start in range(self._cycle, end, self._cycle):
            self._timeline.at(start, self._commands)
        self._plan_one_per_cycle("request", end)
        self._plan_one_per_cycle("emcy", end)
        for frame in self.bus.frames:
            self._plan_periodic(frame, end)
        self._timeline.run_until(end + self._cycle)
        return self.seen

    # -- senders ------------------------------------------------------------------------

    def _controller(self, name: str) -> CanController:
        controller = CanController(self._wire, name, self.bus.bitrate, queue_limit=QUEUE)
        controller.on_sent = self._frame_sent
        controller.on_frame = lambda frame: self._frame_received(name, frame)
        self._wire.attach(controller)
        controller.switch_on()
        return controller

    def _send(self, frame: FrameDefinition, due: int) -> None:
        self._due[frame.cob_id].append(due)
        self._controllers[frame.producer].send(self._sent[frame.cob_id])

    def _commands(self) -> None:
        """Sends the commands of the master; SYNC follows after the last of them."""
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

    def _plan_one_per_cycle(self, group: str, end: int) -> None:
        """Plans requests of the master, or emergencies of any node: one per cycle."""
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
        urgent = [f for f in choice if self._is_more_urgent(f)]
        # At the critical instant, or so that the response to one of them is sent then.
        critical = urgent or self._with_urgent_response(choice)
        phase = self._phase((critical or choice)[0], self._cycle)
        if critical:
            phase = self._critical % self._cycle
        for start in range(phase, end, self._cycle):
            frame = self._draw.choice(choice)
            if start == self._critical and urgent:
                with_response = self._with_urgent_response(urgent)
                frame = max(urgent, key=lambda f: (f.length, f in with_response))
            if start == self._critical - self._cycle:
                frame = self._draw.choice(self._with_urgent_response(choice) or choice)
            if start == self._critical and self.target in choice:
                frame = self.target
            self._timeline.at(start, lambda f=frame: self._request(f))  # type: ignore[misc]

    def _with_urgent_response(self, choice: list[FrameDefinition]) -> list[FrameDefinition]:
        """Returns the requests whose response is more urgent than the target."""
        urgent = {
            f.producer for f in self.bus.frames if f.kind == "sdo" and self._is_more_urgent(f)
        }
        return [f for f in choice if f.kind == "sdo" and f.consumers[0] in urgent]

    def _request(self, frame: FrameDefinition) -> None:
        if frame.kind == "sdo":
            self._requested_at[frame.consumers[0]] = self._timeline.now
        self._send(frame, self._timeline.now)

    def _plan_periodic(self, frame: FrameDefinition, end: int) -> None:
        """Plans the periodic frames of a device, as often as the budget allows."""
        interval = frame.period if frame.kind != "relay" else frame.minimum_interval
        grouped = frame.kind == "pdo" and frame.producer == MASTER
        if interval is None or grouped or frame.kind == "sync" or frame.synchronous:
            return
        period = to_ns(interval)
        for start in range(self._phase(frame, period), end, period):
            self._timeline.at(start, lambda: self._send(frame, self._timeline.now))

    def _phase(self, frame: FrameDefinition, period: int) -> int:
        """Returns the time (ns) of the first frame: random, or fixed by the critical instant."""
        if self.target is not None:
            if self._is_more_urgent(frame) or frame.cob_id == self.target.cob_id:
                return self._critical % period
            if frame.cob_id == self._blocker():
                return (self._critical - 1) % period
        return self._draw.randrange(period)

    def _is_more_urgent(self, frame: FrameDefinition) -> bool:
        return self.target is not None and frame.cob_id < self.target.cob_id

    def _blocker(self) -> int:
        """Returns the COB-ID of the longest less urgent frame of a node; -1: none."""
        less_urgent = [
            f
            for f in self.bus.frames
            if self.target is not None
            and f.cob_id > self.target.cob_id
            and f.period is not None
            and f.producer != MASTER
            and not f.synchronous
        ]
        return (
            max(less_urgent, key=lambda f: exact_bits(self._sent[f.cob_id])).cob_id
            if less_urgent
            else -1
        )

    # -- on the wire -----------------------------------------------------------------

    def _frame_sent(self, sent: CanFrame) -> None:
        frame = self._frames[sent.id]
        # The budget includes the interframe space.
        response_time = self._timeline.now + self._interframe - self._due[sent.id].popleft()
        self.seen[frame.name] = max(self.seen.get(frame.name, 0.0), response_time / 1e9)
        if frame.producer == MASTER and frame.period is not None and frame.kind == "pdo":
            self._open_commands -= 1
            if not self._open_commands:
                self._sync()

    def _frame_received(self, name: str, frame: CanFrame) -> None:
        if frame.id == 0x080:
            for report in self.bus.frames:
                if report.synchronous and report.producer == name:
                    self._send(report, self._cycle_start)
        request = self._frames[frame.id]
        if request.kind == "sdo" and request.producer == MASTER and request.consumers == (name,):
            # The node responds within one cycle.
            requested_at = self._requested_at[name]
            delay = self._cycle if self._draw.random() < 0.3 else self._draw.randrange(self._cycle)
            if self.target is not None and requested_at == self._critical - self._cycle:
                delay = self._cycle
            elif self.target is not None and requested_at == self._critical:
                delay = 0
            for response in self.bus.frames:
                if response.kind == "sdo" and response.producer == name:
                    self._timeline.at(
                        requested_at + delay,
                        lambda r=response: self._send(r, requested_at),  # type: ignore[misc]
                    )


# -- results of several runs ----------------------------------------------------------------


@dataclass(frozen=True)
class Reached:
    """Longest response time of each frame in several runs, divided by its bound, by frame name.

    ``of_bound``: by the bound of the budget, which assumes the worst stuffing.  ``of_sent``: by the
    bound with the exact bits of the frames sent.
    """

    bus: Bus
    of_bound: dict[str, float]
    of_sent: dict[str, float]

    @property
    def last(self) -> str:
        """Name of the least urgent periodic frame, which waits for all others."""
        return max((f for f in self.bus.frames if f.period), key=lambda f: f.cob_id).name


def reached(bus: Bus, seeds: int) -> Reached:
    """Runs a bus ``seeds`` times: half with a target, least urgent first, and half at random."""
    order = sorted(bus.frames, key=lambda f: -f.cob_id)
    targets = -(-seeds // 2)
    seen: dict[str, float] = {}
    for seed in range(seeds):
        target = None if seed % 2 else order[seed // 2 * len(order) // targets]
        for name, time in Traffic(bus, seed, target).run().items():
            seen[name] = max(seen.get(name, 0.0), time)
    sent = {f.name: exact_bits(worst_payload(f.cob_id, f.length)) for f in bus.frames}
    bounds, of_sent = frame_response_times(bus), frame_response_times(bus, sent)
    return Reached(
        bus,
        {name: time / (bounds[name] or 1e-9) for name, time in seen.items()},
        {name: time / (of_sent[name] or 1e-9) for name, time in seen.items()},
    )
