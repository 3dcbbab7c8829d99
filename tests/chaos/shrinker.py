"""Shrinks a schedule that violates an invariant to a short script (delta debugging)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from tests.chaos.schedule import ChaosEvent, Schedule

MOST_RUNS = 300


class Shrinker:
    """Removes events and simplifies values while the same invariant is still violated.

    ``fails``: function that runs a schedule and returns ``True`` if the invariant is violated.
    """

    def __init__(self, fails: Callable[[Schedule], bool], most_runs: int = MOST_RUNS) -> None:
        self._fails = fails
        self._runs_left = most_runs

    def shrink(self, schedule: Schedule) -> Schedule:
        previous = None
        while previous != schedule and self._runs_left > 0:
            previous = schedule
            schedule = self._without_events(schedule)
            schedule = self._simpler(schedule)
        return schedule

    def _still_fails(self, schedule: Schedule) -> bool:
        if self._runs_left <= 0:
            return False
        self._runs_left -= 1
        return self._fails(schedule)

    def _without_events(self, schedule: Schedule) -> Schedule:
        """Removes halves of the events, then quarters, and so on (ddmin)."""
        size = max(len(schedule.events) // 2, 1)
        while True:
            start = 0
            while start < len(schedule.events):
                events = schedule.events[:start] + schedule.events[start + size :]
                candidate = schedule.with_events(events)
                if self._still_fails(candidate):
                    schedule = candidate
                else:
                    start += size
            if size == 1:
                return schedule
            size = max(size // 2, 1)

    def _simpler(self, schedule: Schedule) -> Schedule:
        for candidate in self._shorter(schedule):
            if self._still_fails(candidate):
                schedule = candidate
                break
        for index in range(len(schedule.events)):
            for event in _simpler_events(schedule.events[index]):
                events = (*schedule.events[:index], event, *schedule.events[index + 1 :])
                candidate = schedule.with_events(events)
                if self._still_fails(candidate):
                    schedule = candidate
        return schedule

    @staticmethod
    def _shorter(schedule: Schedule) -> Iterator[Schedule]:
        last = max((event.at for event in schedule.events), default=0.0)
        for rest in (0.3, 1.0, 2.0):
            if last + rest < schedule.duration:
                yield replace(schedule, duration=round(last + rest, 3))


def _simpler_events(event: ChaosEvent) -> Iterator[ChaosEvent]:
    """Yields simpler forms of an event: round times, round values, shorter durations."""
    for digits in (0, 1, 2):
        if round(event.at, digits) != event.at:
            yield replace(event, at=round(event.at, digits))
            break
    values = event.values
    if values.get("twist") and values["twist"] != [0.8, 0.0, 0.0]:
        yield replace(event, values={**values, "twist": [0.8, 0.0, 0.0]})
    if values.get("rate") not in (None, 20.0):
        yield replace(event, values={**values, "rate": 20.0})
    if isinstance(values.get("seconds"), float):
        seconds = values["seconds"]
        for shorter in (round(seconds / 2.0, 1), round(seconds, 1)):
            if 0.0 < shorter != seconds:
                yield replace(event, values={**values, "seconds": shorter})
    if values.get("times", 1) > 1:
        yield replace(event, values={**values, "times": 1})
    if values.get("sending"):
        yield replace(event, values={**values, "sending": False})
