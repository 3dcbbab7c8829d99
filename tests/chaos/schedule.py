"""A schedule: a mission with its faults as a list of events, which JSON can hold."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import Any

READY, POWER_ON, DELIVERED = "ready", "power_on", "delivered"


@dataclass(frozen=True)
class ChaosEvent:
    """What happens at a time.

    - ``at``: time in s after the start of the mission.
    - ``act``: name of the act, a method of ``ChaosWorld`` without the prefix ``act_``.
    - ``values``: arguments of the act.
    """

    at: float
    act: str
    values: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Schedule:
    """A mission on a robot.

    - ``robot``: name of the robot in ``chaos_robots``.
    - ``seed``: seed of the simulated devices and of the injected faults.
    - ``start``: ``ready`` for a mission that begins with a robot that is ready, ``power_on`` for a
      mission that begins when the devices are switched on, ``delivered`` for the commissioning of
      new drives, after which the robot must drive.
    - ``duration``: length of the mission in s; the recovery of the robot follows.
    """

    robot: str
    seed: int
    start: str
    duration: float
    events: tuple[ChaosEvent, ...]

    def with_events(self, events: tuple[ChaosEvent, ...]) -> Schedule:
        return replace(self, events=events)

    def to_json(self) -> str:
        """Returns the schedule as JSON with a line for each event."""
        head = {
            "robot": self.robot,
            "seed": self.seed,
            "start": self.start,
            "duration": self.duration,
        }
        lines = [
            json.dumps({"at": event.at, "act": event.act, **event.values}) for event in self.events
        ]
        body = ",\n    ".join(lines)
        return json.dumps(head)[:-1] + ',\n  "events": [\n    ' + body + "\n  ]}\n"

    @classmethod
    def from_json(cls, text: str) -> Schedule:
        document = json.loads(text)
        events = tuple(
            ChaosEvent(entry.pop("at"), entry.pop("act"), entry) for entry in document["events"]
        )
        return cls(
            document["robot"], document["seed"], document["start"], document["duration"], events
        )
