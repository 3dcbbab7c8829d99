"""Broken encoders and wrong radii in a recording of ``broken_world``, from the break on.

The driver does not correct commands by measured speeds, so that the motion stays the same.
"""

from __future__ import annotations

import random
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bench.recorded_trials import Recording
from thorvaldc.runtime.calculators import BaseGeometry

Array = NDArray[np.float64]
Speeds = Callable[[random.Random, Array], Array]
"""Measured speeds (n) of a wheel for the true ones, in m/s."""

STUCK_SPEED = 1.0
WRONG_RADIUS = 1.05


def _stuck(rng: random.Random, speeds: Array) -> Array:
    return np.full_like(speeds, rng.uniform(-STUCK_SPEED, STUCK_SPEED))


CLASSES: dict[str, Speeds] = {
    "dead encoders": lambda rng, speeds: 0.0 * speeds,
    "reversed encoders": lambda rng, speeds: -speeds,
    "stuck encoders": _stuck,
    "half-scale encoders": lambda rng, speeds: 0.5 * speeds,
    "wrong radii": lambda rng, speeds: speeds / WRONG_RADIUS,
}
"""Each class breaks any number of wheels."""
ALSO_COMMANDED = ("wrong radii",)
"""Classes in which the commands are wrong too, so that the wheel follows them."""


def broken(recording: Recording, geometry: BaseGeometry, name: str) -> Recording:
    """Returns the recording with random broken wheels in each trial."""
    dt = np.diff(recording.times)[:, np.newaxis]
    speeds, commanded = recording.speeds.copy(), recording.commanded.copy()
    steps = np.diff(recording.positions, axis=1) / dt
    encoders = [i for i, wheel in enumerate(geometry.wheels) if wheel.encoder]
    for trial, first in enumerate(recording.breaks.tolist()):
        rng = random.Random(f"{name} {trial}")
        for i in rng.sample(encoders, rng.randint(1, len(encoders))):
            radius, state = geometry.wheels[i].radius, rng.getstate()
            changed = [steps[trial, first:], speeds[trial, first + 1 :]]
            if name in ALSO_COMMANDED:
                changed.append(commanded[trial, first + 1 :])
            for values in changed:
                rng.setstate(state)  # the same fault in all of them
                values[:, i] = CLASSES[name](rng, radius * values[:, i]) / radius
    start = recording.positions[:, :1]
    positions = np.concatenate([start, start + np.cumsum(steps * dt, axis=1)], axis=1)
    return recording._replace(speeds=speeds, positions=positions, commanded=commanded)
