"""Lidars of one layer and of several layers."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from thorvaldc.model.sensor_numbers import ray_count
from thorvaldc.simulation.sensors.simulated_sensor import Array, Message, SimulatedSensor

_OWN_GROUP = 5
"""Group of geoms for those of the robot itself while its lidar measures."""
_GROUPS = np.array([1, 0, 1, 0, 1, 0], np.uint8)
"""Groups of geoms that rays hit: the world and the visual shapes of robots; neither plates of
zones, nor collision shapes, nor the robot itself."""
_FLOAT32 = 7
"""Value of ``PointField.datatype``."""


class Lidar(SimulatedSensor):
    """A lidar, whose rays hit the world and other robots.

    All rays of a scan belong to one time: the motion of the robot within a sweep is left out.  In a
    scan, a distance is inf if nothing returns, and -inf if the surface is too near (REP 117).
    Points have only rays with a return.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        values = self.numbers
        half, tilt = values["field_of_view"] / 2, values.get("vertical_field_of_view", 0.0) / 2
        azimuths, self._step = np.linspace(-half, half, ray_count(values), retstep=True)
        layers = int(values.get("layers", 1))
        elevations = np.linspace(-tilt, tilt, layers) if layers > 1 else np.zeros(1)
        up, about = (angles.ravel() for angles in np.meshgrid(elevations, azimuths, indexing="ij"))
        level = np.cos(up)
        self.directions = np.stack([level * np.cos(about), level * np.sin(about), np.sin(up)], 1)
        model = self.seen.model
        root = model.body_rootid[self._base]
        self._own = np.flatnonzero(model.body_rootid[model.geom_bodyid] == root)

    def distances(self) -> Array:
        """Returns the exact distance (n) of each ray in m; inf if it hits nothing in the range."""
        model, count = self.seen.model, len(self.directions)
        position, rotation = self.pose()
        geoms, distances = np.empty(count, np.int32), np.empty(count)
        groups = model.geom_group[self._own]
        model.geom_group[self._own] = _OWN_GROUP
        rays = (self.directions @ rotation.T).ravel()
        mujoco.mj_multiRay(
            *(model, self.seen.data, position, rays, _GROUPS, True, -1),
            *(geoms, distances, None, count, self.numbers["range"]),
        )
        model.geom_group[self._own] = groups
        distances[geoms < 0] = math.inf
        return distances

    def measure(self) -> list[Message]:
        values, count = self.numbers, len(self.directions)
        distances = self.distances() + self._errors(values["range_noise"], count)
        lost = self.random.random(count) < values["dropouts"] * self.settings.errors
        distances[lost | (distances > values["range"])] = math.inf
        distances[distances < values["minimum_range"]] = -math.inf
        if self.sensor.type == "lidar_3d":
            return [self._points(distances)]
        scan = self._message(
            "LaserScan",
            angle_min=-values["field_of_view"] / 2,
            angle_max=values["field_of_view"] / 2,
            angle_increment=float(self._step),
            time_increment=0.0,  # all rays have the time of the stamp
            scan_time=self.period,
            range_min=values["minimum_range"],
            range_max=values["range"],
            ranges=distances.astype(np.float32),
            intensities=np.zeros(0, np.float32),
        )
        return [scan]

    def _points(self, distances: Array) -> Message:
        returned = np.isfinite(distances)
        points = self.directions[returned] * distances[returned, np.newaxis]
        field = {"datatype": _FLOAT32, "count": 1}
        return self._message(
            "PointCloud2",
            height=1,
            width=len(points),
            fields=[
                Message("sensor_msgs/msg/PointField", name=name, offset=4 * i, **field)
                for i, name in enumerate("xyz")
            ],
            is_bigendian=False,
            point_step=12,
            row_step=12 * len(points),
            data=np.ascontiguousarray(points, np.dtype("<f4")).view(np.uint8).ravel(),
            is_dense=True,
        )
