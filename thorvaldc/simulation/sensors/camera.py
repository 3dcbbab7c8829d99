"""Cameras: their calibration, and images where OpenGL is."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from thorvaldc.simulation.sensors.simulated_sensor import Message, SimulatedSensor


class Camera(SimulatedSensor):
    """A camera without distortion, whose optical axis goes through the middle of the image.

    With images, the message of the image is before that of the calibration.
    """

    _renderer: Any = None

    def measure(self) -> list[Message]:
        width, height = int(self.numbers["image_width"]), int(self.numbers["image_height"])
        f = width / 2.0 / math.tan(self.numbers["horizontal_field_of_view"] / 2.0)
        cx, cy = width / 2.0, height / 2.0
        whole = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        calibration = self._message(
            "CameraInfo",
            height=height,
            width=width,
            distortion_model="plumb_bob",
            d=np.zeros(5),
            k=(f, 0.0, cx, 0.0, f, cy, 0.0, 0.0, 1.0),
            r=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
            p=(f, 0.0, cx, 0.0, 0.0, f, cy, 0.0, 0.0, 0.0, 1.0, 0.0),
            binning_x=0,
            binning_y=0,
            roi=Message("sensor_msgs/msg/RegionOfInterest", **whole),
        )
        return [*([self._image(width, height)] if self.settings.images else []), calibration]

    def _image(self, width: int, height: int) -> Message:
        model, data = self.seen.model, self.seen.data
        if self._renderer is None:
            from thorvaldc.simulation.pictures.render import choose_opengl_backend

            choose_opengl_backend()
            size = model.vis.global_
            size.offwidth, size.offheight = max(size.offwidth, width), max(size.offheight, height)
            self._renderer = mujoco.Renderer(model, height, width)
        mujoco.mj_camlight(model, data)
        self._renderer.update_scene(data, self.name)
        return self._message(
            "Image",
            height=height,
            width=width,
            encoding="rgb8",
            is_bigendian=0,
            step=3 * width,
            data=self._renderer.render().ravel(),
        )
