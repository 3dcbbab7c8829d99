"""Writes the events before a violation of ``exploration`` as a mission of tests/chaos."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

from tests.runtime.exploration import FAST, STEP, Violation

_EVENT_PERIOD = 0.1
"""Time (s) between two events of a mission: a few control cycles."""


def script(violation: Violation) -> str:
    """Returns the events before a violation as a mission of tests/chaos."""
    events: list[dict[str, Any]] = []
    at = 0.0
    for name in violation.path:
        at += _EVENT_PERIOD
        events += [{"at": round(at, 3), **act} for act in _acts(name)]
    lines = ",\n    ".join(json.dumps(event) for event in events)
    head = {"robot": "differential_cia402", "seed": 1, "start": "ready"}
    head["duration"] = round(at + 2.0, 3)
    return json.dumps(head)[:-1] + ',\n  "events": [\n    ' + lines + "\n  ]}\n"


def _acts(name: str) -> Iterator[dict[str, Any]]:
    """Yields the acts of tests/chaos for an event; none for a control cycle, which comes anyway."""
    client, _, rest = name.partition(" ")
    call = {"act": "call", "client": client}
    if match := re.fullmatch(r"publishes (.+): (\w+)", rest):
        speed = {"zero": 0.0, "a step": STEP.vx, "a motion": FAST.vx}[match[1]]
        yield {**call, "service": "twist", "arguments": {"source": match[2], "vx": speed}}
    elif match := re.fullmatch(r"(sets|releases) (.+?)( by force)?", rest):
        locked, force = match[1] == "sets", {"force": True} if match[3] else {}
        if match[2] == "the safety stop":
            service = "safety_stop" if locked else "release_safety_stop"
            yield {**call, "service": service, "arguments": force}
        else:
            arguments = {"name": match[2], "locked": locked, **force}
            yield {**call, "service": "lock", "arguments": arguments}
    elif rest.startswith("arms"):
        yield {**call, "service": "arm"}
    elif rest == "ends":
        yield {"act": "close", "client": client}
    elif "gap in time" in name:
        yield {"act": "stall", "seconds": 0.4 if "long" in name else 0.15}
    elif name.startswith("a person "):
        service = {"disarms": "disarm", "resets": "reset_faults", "homes": "home_steering"}
        yield {"act": "call", "client": "person", "service": service[name.split()[-1]]}
