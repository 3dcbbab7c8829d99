"""What the programs of the readers share; each runs in an environment without thorvaldc.

A program reads a JSON list of jobs from stdin and prints a JSON list of results. A result is what
the reader makes of one file, or ``{"error": message}``:

- ``states``: for each state of the job, ``mass`` (total in kg), ``com`` (m), ``inertia`` (kg m^2,
  about ``com``), and ``poses`` (position in m and rotation matrix of each body); all in the frame
  of the first body.
- ``contacts``: the number of collision shapes by kind.
- ``friction``: sliding friction by collision shape.
- ``actuators``: position gain and velocity gain by joint.
- ``actuator_count``: the number of actuators.
- ``springs``: stiffness by joint, of the joints that have one.
- ``limits``: lower and upper limit by joint, of the joints that have them.

A key is absent where the reader has no such thing.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np


def composite(parts: Iterable[tuple[float, Any, Any, Any, Any]]) -> dict[str, Any]:
    """Mass, centre of mass and inertia about it of bodies: each has its mass, position, rotation
    matrix, centre of mass in its frame, and inertia about that in its axes."""
    bodies = [
        (float(m), np.asarray(p) + np.asarray(r) @ c, np.asarray(r) @ i @ np.asarray(r).T)
        for m, p, r, c, i in parts
    ]
    mass = sum(m for m, _, _ in bodies)
    com = sum(m * c for m, c, _ in bodies) / mass
    inertia = np.zeros((3, 3))
    for m, center, own in bodies:
        d = center - com
        inertia += own + m * (d @ d * np.eye(3) - np.outer(d, d))
    return {"mass": mass, "com": com.tolist(), "inertia": inertia.tolist()}


def rotation(w: float, x: float, y: float, z: float) -> Any:
    """The rotation matrix of a unit quaternion."""
    v, cross = np.array([x, y, z]), np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return (w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * cross


def state_of(
    bodies: dict[str, tuple[Any, Any]], parts: Iterable[tuple[float, Any, Any, Any, Any]]
) -> dict[str, Any]:
    """One of the ``states``; ``bodies`` has position and rotation matrix by name."""
    poses = {name: [*map(float, p), *np.ravel(r).tolist()] for name, (p, r) in bodies.items()}
    return {**composite(parts), "poses": poses}


KINDS = {"bvhmodelobbrss": "mesh", "cube": "box", "convex_mesh": "mesh", "convex": "mesh"}


def count(contacts: dict[str, int], kind: str) -> None:
    """Counts a collision shape, under MuJoCo's name of its kind."""
    kind = kind.lower()
    kind = KINDS.get(kind, kind)
    contacts[kind] = contacts.get(kind, 0) + 1


def main(read: Callable[..., dict[str, Any]]) -> None:
    # Some readers print to stdout.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    results = []
    for job in json.load(sys.stdin):
        try:
            results.append(read(**job))
        except Exception as error:
            results.append({"error": f"{type(error).__name__}: {error}"})
    json.dump(results, answers)
    answers.close()
