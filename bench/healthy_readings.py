"""Are the readings of all wheels those of a healthy drive?  The question is independent of the
estimator: the noise model and the equations of the module ``twist_fit``, over arrays.

The readings of a tick are healthy if no wheel deviates from its command, and none disagrees with
the others by more than the chi-square that 99.2 % of the ticks of healthy robots stay below.
Wheels that skid in turns always disagree, and are not tested; a gyro is.
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from thorvaldc.runtime.calculators import BaseGeometry, Noise
from thorvaldc.runtime.calculators.base_geometry import FixedWheels

Array = NDArray[np.float64]

FOLLOWING, FOLLOWING_FLOOR = 0.03, 0.015
"""Relative error, and error in m/s, of a wheel that follows its command."""
_FALSE_ALARMS = 0.008
_STEPS = 3
_GYRO = -1
"""Stands for the gyro in the place of a wheel."""


class Readings(Protocol):
    """Joint values (trials, n, wheels), as in ``broken_world.Recording``."""

    @property
    def times(self) -> Array: ...
    @property
    def angles(self) -> Array: ...
    @property
    def positions(self) -> Array: ...
    @property
    def commanded(self) -> Array: ...


class HealthyFit(NamedTuple):
    """Twists (trials, n - 1, 3) and covariances of a fit that trusts all wheels, and whether the
    readings allow that."""

    twists: Array
    covariances: Array
    is_healthy: NDArray[np.bool_]


def healthy_fit(
    geometry: BaseGeometry, noise: Noise, readings: Readings, yaw_rates: Array | None
) -> HealthyFit:
    """Fits the mean twists between two ticks; ``yaw_rates`` (trials, n): of a gyro, rad/s."""
    dt = np.diff(readings.times)[:, np.newaxis]
    speeds = np.diff(readings.positions, axis=1) / dt
    angles = (readings.angles[:, 1:] + readings.angles[:, :-1]) / 2.0
    rates = np.diff(readings.angles, axis=1) / dt
    skids = FixedWheels(geometry.wheels).skids
    rows, values, owners, is_rolling = [], [], [], []
    follows = np.full(speeds.shape[:2], True)
    for i, w in enumerate(geometry.wheels):
        if w.swivel:
            continue
        direction = w.heading + w.sign * angles[:, :, i] if w.steered else w.heading
        turning = w.sign * rates[:, :, i] if w.steered else np.zeros(speeds.shape[:2])
        c, s = (np.broadcast_to(f(direction), turning.shape) for f in (np.cos, np.sin))
        if w.encoder:
            speed, command = w.radius * speeds[:, :, i], w.radius * readings.commanded[:, 1:, i]
            follows &= np.abs(speed - command) <= FOLLOWING_FLOOR + FOLLOWING * np.abs(command)
            rows.append((c, s, s * w.x - c * w.y - w.lateral))
            values.append(speed + w.lateral * turning)
            owners.append(i)
            is_rolling.append(True)
        rows.append((-s, c, c * w.x + s * w.y + w.trail))
        values.append(-w.trail * turning)
        owners.append(i)
        is_rolling.append(False)
    if yaw_rates is not None:
        zero = np.zeros(speeds.shape[:2])
        rows.append((zero, zero, zero + 1.0))
        values.append((yaw_rates[:, 1:] + yaw_rates[:, :-1]) / 2.0)
        owners.append(_GYRO)
        is_rolling.append(False)
    h = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    z = np.stack(values, axis=-1)
    variances = np.ones_like(z)
    twists = np.zeros((*z.shape[:2], 3))
    for _ in range(_STEPS):
        twists, covariances = _solved(h, z, variances)
        variances = _variances(geometry, noise, twists, owners, is_rolling, skids, z.shape)
    twists, covariances = _solved(h, z, variances)
    tested = [i for i in dict.fromkeys(owners) if i not in skids]
    agrees = _agree(h, z - (h @ twists[..., np.newaxis])[..., 0], variances, covariances, owners)
    is_healthy = follows & np.all([agrees[i] for i in tested], axis=0) if tested else follows
    return HealthyFit(twists, covariances, is_healthy)


def _solved(h: Array, z: Array, variances: Array) -> tuple[Array, Array]:
    weighted = h / variances[..., np.newaxis]
    # A small part of the diagonal is for motions that no wheel measures.
    information = np.swapaxes(weighted, -1, -2) @ h + 1e-3 * np.eye(3)
    covariances = np.asarray(np.linalg.inv(information), np.float64)
    right = np.swapaxes(weighted, -1, -2) @ z[..., np.newaxis]
    return (covariances @ right)[..., 0], covariances


def _variances(
    geometry: BaseGeometry,
    noise: Noise,
    twists: Array,
    owners: list[int],
    is_rolling: list[bool],
    skids: tuple[int, ...],
    shape: tuple[int, ...],
) -> Array:
    vx, vy, wz = np.moveaxis(twists, -1, 0)
    variances = np.full(shape, noise.gyro**2)
    for k, (i, rolling) in enumerate(zip(owners, is_rolling, strict=True)):
        if i == _GYRO:
            continue
        w = geometry.wheels[i]
        moving = (vx - wz * w.y) ** 2 + (vy + wz * w.x) ** 2
        ratio, floor = noise.angle, noise.slip_floor
        if rolling:
            ratio, floor = noise.speed_ratio, noise.speed_floor
        if i in skids:
            ratio = noise.skid_ratio
        variances[..., k] = ratio**2 * moving + floor**2
    return variances


def _agree(
    h: Array, residuals: Array, variances: Array, covariances: Array, owners: list[int]
) -> dict[int, NDArray[np.bool_]]:
    """Returns for each wheel in which ticks its measurements agree with all others.

    The residual r of a wheel has the covariance S = R - H P H', and the chi-square r' S^-1 r.
    """
    share = _FALSE_ALARMS / len(set(owners))
    gates = {1: NormalDist().inv_cdf(1.0 - share / 2.0) ** 2, 2: -2.0 * math.log(share)}
    agree = {}
    for i in dict.fromkeys(owners):
        own = [k for k, owner in enumerate(owners) if owner == i]
        part, r = h[..., own, :], residuals[..., own]
        noise = variances[..., own, np.newaxis] * np.eye(len(own))
        s = noise - part @ covariances @ np.swapaxes(part, -1, -2)
        # A measurement that nothing confirms has no residual.
        inverse = np.linalg.pinv(s / noise.max(axis=(-1, -2), keepdims=True), rcond=1e-6)
        chi_square = (r[..., np.newaxis, :] @ inverse @ r[..., np.newaxis])[..., 0, 0]
        agree[i] = chi_square / noise.max(axis=(-1, -2)) <= gates[len(own)]
    return agree
