"""Lidars of one layer and of several layers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from thorvaldc.model import Robot, Sensor
from thorvaldc.model.scenario import SensorSettings
from thorvaldc.model.sensor_numbers import ray_count
from thorvaldc.simulation.sensors.simulated_sensor import (
    Array,
    Measurement,
    SeenScene,
    SimulatedSensor,
)

_OWN_GROUP = 5
"""Group of geoms for those of the robot itself while its lidar measures."""
_GROUPS = np.array([1, 0, 1, 0, 1, 0], np.uint8)
"""Groups of geoms that rays hit: the world and the visual shapes of robots; neither plates of
zones, nor collision shapes, nor the robot itself."""


@dataclass(frozen=True, slots=True)
class Scan(Measurement):
    """A scan of a lidar with one layer.

    - ``first_angle``, ``step``: angle of the first ray about z in rad, and between two rays.
    - ``nearest``, ``farthest``: range of the distances in m.
    - ``period``: time between two scans in s.
    - ``ranges``: (n) distances in m; -inf for a surface that is too near, and inf if nothing
      returns, as in REP 117.
    """

    first_angle: float
    step: float
    nearest: float
    farthest: float
    period: float
    ranges: Array


@dataclass(frozen=True, slots=True)
class PointCloud(Measurement):
    """Points of a lidar with several layers: (n, 3) in m in the measurement frame.

    Rays without a return have no point.
    """

    points: Array


class Lidar(SimulatedSensor):
    """A lidar, whose rays hit the world and other robots.

    All rays of a scan belong to one time: the motion of the robot within a sweep is left out.
    """

    def __init__(
        self, robot: Robot, sensor: Sensor, seen: SeenScene, settings: SensorSettings
    ) -> None:
        super().__init__(robot, sensor, seen, settings)
        values = self.numbers
        half = values["field_of_view"] / 2
        azimuths, self._step = np.linspace(-half, half, ray_count(values), retstep=True)
        tilt = values.get("vertical_field_of_view", 0.0) / 2
        layers = int(values.get("layers", 1))
        elevations = np.linspace(-tilt, tilt, layers) if layers > 1 else np.zeros(1)
        up, about = (angles.ravel() for angles in np.meshgrid(elevations, azimuths, indexing="ij"))
        self.directions = np.stack(
            [np.cos(up) * np.cos(about), np.cos(up) * np.sin(about), np.sin(up)], axis=1
        )
        self._is_planar = sensor.type == "lidar_2d"
        model = seen.model
        root = model.body_rootid[self._base]
        self._own = np.flatnonzero(model.body_rootid[model.geom_bodyid] == root)

    def distances(self, seen: SeenScene) -> Array:
        """Returns the exact distance (n) of each ray in m; inf if it hits nothing in the range."""
        model, count = seen.model, len(self.directions)
        position, rotation = self.pose(seen)
        geoms, distances = np.empty(count, np.int32), np.empty(count)
        groups = model.geom_group[self._own]
        model.geom_group[self._own] = _OWN_GROUP
        try:
            mujoco.mj_multiRay(
                *(model, seen.data, position, (self.directions @ rotation.T).ravel(), _GROUPS),
                *(True, -1, geoms, distances, None, count, self.numbers["range"]),
            )
        finally:
            model.geom_group[self._own] = groups
        distances[geoms < 0] = math.inf
        return distances

    def measure(self, seen: SeenScene) -> Scan | PointCloud:
        values, count = self.numbers, len(self.directions)
        distances = self.distances(seen) + self._errors(values["range_noise"], count)
        lost = self.random.random(count) < values["dropouts"] * self.settings.errors
        near, far = values["minimum_range"], values["range"]
        distances[lost | (distances > far)] = math.inf
        distances[distances < near] = -math.inf
        common = self._common(seen)
        if self._is_planar:
            first = -values["field_of_view"] / 2
            return Scan(*common, first, float(self._step), near, far, self.period, distances)
        returned = np.isfinite(distances)
        return PointCloud(
            *common, self.directions[returned] * distances[returned, np.newaxis]
        )
