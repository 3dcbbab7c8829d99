"""Cameras: their calibration, and images where OpenGL is."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.simulation.pictures import PictureError
from thorvaldc.simulation.pictures.render import choose_opengl_backend
from thorvaldc.simulation.sensors.simulated_sensor import Message, SimulatedSensor


class Camera(SimulatedSensor):
    """A camera without distortion, whose optical axis goes through the middle of the image.

    With images, the message of the image is before that of the calibration.
    """

    def __init__(self, *arguments: Any) -> None:
        """Raises ``DiagnosticError`` if it shall draw images and MuJoCo cannot draw."""
        super().__init__(*arguments)
        self._size = int(self.numbers["image_width"]), int(self.numbers["image_height"])
        if self.settings.images:
            try:
                choose_opengl_backend()
            except PictureError as error:
                raise DiagnosticError("simulation-scene", str(error)) from None
            (width, height), size = self._size, self.seen.model.vis.global_
            size.offwidth, size.offheight = max(size.offwidth, width), max(size.offheight, height)
            try:
                self._renderer = mujoco.Renderer(self.seen.model, height, width)
            except mujoco.FatalError as error:
                message = f"`{self.name}` cannot draw {width} x {height} pixels: {error}"
                hint = "state fewer pixels, or leave the images out"
                raise DiagnosticError("simulation-scene", message, hint=hint) from None

    def measure(self) -> list[Message]:
        width, height = self._size
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
        if not self.settings.images:
            return [calibration]
        mujoco.mj_camlight(self.seen.model, self.seen.data)
        self._renderer.update_scene(self.seen.data, self.name)
        form = {"encoding": "rgb8", "is_bigendian": 0, "step": 3 * width}
        pixels = self._renderer.render().ravel()
        image = self._message("Image", height=height, width=width, data=pixels, **form)
        return [image, calibration]
