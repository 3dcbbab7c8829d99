"""Virtual time: a queue of events, ordered to the nanosecond and the same in every run."""

from __future__ import annotations

import heapq
from collections.abc import Callable

from thorvaldc.can.nanoseconds import NANOSECONDS, NEVER

Action = Callable[[], None]


class Event:
    """An action that is due at ``time`` (ns), unless it is cancelled."""

    __slots__ = ("action", "time")

    def __init__(self, time: int, action: Action) -> None:
        self.time = time
        self.action: Action | None = action

    def cancel(self) -> None:
        self.action = None


class Timeline:
    """The clock of a simulation and its planned events.

    ``now`` is in ns.  Events of the same time run in the order in which they were planned;
    events planned with ``last`` run after all others of that time.
    """

    def __init__(self) -> None:
        self.now = 0
        self._queue: list[tuple[int, int, int, Event]] = []
        self._planned = 0
        self._running = False

    @property
    def seconds(self) -> float:
        """The present time in s."""
        return self.now / NANOSECONDS

    @property
    def next_time(self) -> int:
        """Time (ns) of the next event; ``NEVER`` if none is planned."""
        queue = self._queue
        while queue and queue[0][3].action is None:
            heapq.heappop(queue)
        return queue[0][0] if queue else NEVER

    def at(self, time: int, action: Action, last: bool = False) -> Event:
        """Plans ``action`` for ``time`` (ns).  A time in the past counts as now."""
        event = Event(max(time, self.now), action)
        self._planned += 1
        heapq.heappush(self._queue, (event.time, int(last), self._planned, event))
        return event

    def after(self, delay: int, action: Action) -> Event:
        """Plans ``action`` for ``delay`` ns from now."""
        return self.at(self.now + delay, action)

    def step(self) -> bool:
        """Runs the next event.  ``False``: none is planned."""
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
        """Runs all events up to and including ``time`` (ns), or until ``stop()`` is true.

        ``stop`` is called after each event.  Returns whether it ended the run; otherwise
        ``now`` is ``time`` afterwards.  Raises ``RuntimeError`` if an event calls this method.
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
