"""Cameras: their calibration, and images where OpenGL is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import mujoco

from thorvaldc.simulation.sensors.simulated_sensor import (
    Array,
    Measurement,
    SeenScene,
    SimulatedSensor,
)


@dataclass(frozen=True, slots=True)
class CameraFrame(Measurement):
    """The calibration of a camera, and an image.

    - ``width``, ``height``: size of the image in pixels.
    - ``focal_length``: in pixels, equal for rows and columns.
    - ``pixels``: (height, width, 3) red, green and blue, 0 to 255, or ``None`` without images.
    """

    width: int
    height: int
    focal_length: float
    pixels: Array | None


class Camera(SimulatedSensor):
    """A camera without distortion, whose optical axis goes through the middle of the image."""

    _renderer: Any = None

    def measure(self, seen: SeenScene) -> CameraFrame:
        values = self.numbers
        width, height = int(values["image_width"]), int(values["image_height"])
        focal_length = width / 2.0 / math.tan(values["horizontal_field_of_view"] / 2.0)
        pixels = self._draw(seen, width, height) if self.settings.images else None
        return CameraFrame(*self._common(seen), width, height, focal_length, pixels)

    def _draw(self, seen: SeenScene, width: int, height: int) -> Array:
        model = seen.model
        if self._renderer is None:
            from thorvaldc.simulation.pictures.render import choose_opengl_backend

            choose_opengl_backend()
            size = model.vis.global_
            size.offwidth, size.offheight = max(size.offwidth, width), max(size.offheight, height)
            self._renderer = mujoco.Renderer(model, height, width)
        mujoco.mj_camlight(model, seen.data)
        self._renderer.update_scene(seen.data, self.name)
        return self._renderer.render()
