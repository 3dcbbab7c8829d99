"""The virtual time of a simulation: a queue of events with times in ns."""

from __future__ import annotations

import heapq
from collections.abc import Callable

from thorvaldc.can.frame import NANOSECONDS, NEVER

Action = Callable[[], None]


class Event:
    """A scheduled call of ``action`` at the virtual time ``time`` (ns), which can be cancelled."""

    __slots__ = ("action", "time")

    def __init__(self, time: int, action: Action) -> None:
        self.time = time
        self.action: Action | None = action

    def cancel(self) -> None:
        self.action = None


class Timeline:
    """The virtual clock of a simulation and the queue of scheduled events.

    ``now`` is the virtual time (ns).  Simulation events with equal times run in the order in which
    the events were scheduled.  An event with ``last`` runs after all other events with the same
    time.
    """

    def __init__(self) -> None:
        self.now = 0
        self._queue: list[tuple[int, bool, int, Event]] = []
        self._planned = 0
        self._running = False

    @property
    def seconds(self) -> float:
        """Virtual time in s."""
        return self.now / NANOSECONDS

    @property
    def next_time(self) -> int:
        """Time (ns) of the next event, or ``NEVER`` if no event is scheduled."""
        queue = self._queue
        while queue and queue[0][3].action is None:
            heapq.heappop(queue)
        return queue[0][0] if queue else NEVER

    def at(self, time: int, action: Action, last: bool = False) -> Event:
        """Schedules a call of ``action`` at the virtual time ``time`` (ns).

        A virtual time in the past is replaced by the current virtual time.
        """
        if time < self.now:
            time = self.now
        event = Event(time, action)
        self._planned += 1
        heapq.heappush(self._queue, (time, last, self._planned, event))
        return event

    def after(self, delay: int, action: Action) -> Event:
        """Schedules a call of ``action`` after ``delay`` ns."""
        return self.at(self.now + delay, action)

    def run_until(self, time: int, stop: Callable[[], bool] | None = None) -> bool:
        """Runs all events until ``time`` (ns), including events at ``time``.

        The function ``stop`` is called after each event of the simulation.  If ``stop`` returns
        true, the method ends early and returns true.  If no call of ``stop`` returns true, the
        method sets ``now`` to ``time`` and returns false.  Raises ``RuntimeError`` if an event
        calls ``run_until``.
        """
        if self._running:
            raise RuntimeError("an event of the simulation cannot wait for the simulation")
        self._running = True
        queue, pop = self._queue, heapq.heappop
        try:
            while queue and queue[0][0] <= time:
                event = pop(queue)[3]
                action, event.action = event.action, None
                if action is None:
                    continue
                self.now = event.time
                action()
                if stop is not None and stop():
                    return True
            self.now = max(self.now, time)
            return False
        finally:
            self._running = False
