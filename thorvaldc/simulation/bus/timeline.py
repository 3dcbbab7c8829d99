"""Virtual time: events in the order of their times, to the nanosecond, the same in every run."""

from __future__ import annotations

import heapq
from collections.abc import Callable

from thorvaldc.can.nanoseconds import NANOSECONDS, NEVER

Action = Callable[[], None]


class Event:
    """Something to be done at ``time`` (ns), unless it is cancelled."""

    __slots__ = ("action", "time")

    def __init__(self, time: int, action: Action) -> None:
        self.time = time
        self.action: Action | None = action

    def cancel(self) -> None:
        self.action = None


class Timeline:
    """The time of a simulation and what is still to happen in it.

    ``now`` is in ns.  Events of the same time come in the order in which they were
    planned, those that are planned ``last`` after all others of that time.
    """

    def __init__(self) -> None:
        self.now = 0
        self._queue: list[tuple[int, int, int, Event]] = []
        self._planned = 0
        self._running = False

    @property
    def seconds(self) -> float:
        return self.now / NANOSECONDS

    @property
    def next_time(self) -> int:
        """When the next event is due, ``NEVER`` if there is none."""
        queue = self._queue
        while queue and queue[0][3].action is None:
            heapq.heappop(queue)
        return queue[0][0] if queue else NEVER

    def at(self, time: int, action: Action, last: bool = False) -> Event:
        """Plan ``action`` for ``time`` (ns); what is past happens now."""
        event = Event(max(time, self.now), action)
        self._planned += 1
        heapq.heappush(self._queue, (event.time, int(last), self._planned, event))
        return event

    def after(self, delay: int, action: Action) -> Event:
        """Plan ``action`` for ``delay`` ns from now."""
        return self.at(self.now + delay, action)

    def step(self) -> bool:
        """Let the next event happen; ``False`` where there is none."""
        queue = self._queue
        while queue:
            time, _, _, event = heapq.heappop(queue)
            action, event.action = event.action, None
            if action is not None:
                self.now = time
                action()
                return True
        return False

    def run_until(self, time: int, stop: Callable[[], bool] | None = None) -> bool:
        """Let everything happen up to and with ``time``, or until ``stop()`` after an event.

        Says whether it was stopped; if not, ``now`` is ``time`` afterwards.  Raises
        ``RuntimeError`` where an event itself wants to run the time on.
        """
        if self._running:
            raise RuntimeError("an event of the simulation cannot wait for the simulation")
        self._running = True
        try:
            while self.next_time <= time:
                self.step()
                if stop is not None and stop():
                    return True
            self.now = max(self.now, time)
            return False
        finally:
            self._running = False
