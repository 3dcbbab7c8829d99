"""Draws a video of a run with MuJoCo, without a display.

The positions of the robots are stored during the run.  The pictures are drawn after the run.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from thorvaldc.diagnostics.files import STAGE_PREFIX, errors_with_name
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.pictures import PictureError
from thorvaldc.simulation.pictures.render import (
    BoundingBoxes,
    View,
    fit_camera,
    picture_scene,
    renderer,
)

FORMATS = ("mp4", "gif")
RATES = {"mp4": 25.0, "gif": 12.5}
"""Pictures per second.  The duration of a GIF picture must be a multiple of 1/100 s."""
SIZES = {"mp4": (960, 540), "gif": (640, 360)}


def encoder() -> str:
    """Returns the path of the program ``ffmpeg``.

    Raises ``PictureError`` if ``ffmpeg`` is not installed.
    """
    path = shutil.which("ffmpeg")
    if path:
        return path
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise PictureError(
            f"an MP4 needs the encoder ffmpeg: {install_command('video')}; or put ffmpeg on the"
            " PATH, or name a .gif file"
        ) from None


class VideoRecorder:
    """Stores the joint positions of a scene during a run, and draws a video from the positions.

    ``rate`` is the number of pictures of the video per second.
    """

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self._positions: list[Any] = []

    def on_tick(self, scene: MujocoScene) -> None:
        """Stores the joint positions if the time of the next picture is reached.

        Call the method ``on_tick`` after each tick.
        """
        if scene.time >= len(self._positions) / self.rate - 1e-9:
            self._positions.append(scene.data.qpos.copy())

    def __len__(self) -> int:
        """Returns the number of pictures in the video."""
        return len(self._positions)

    def write(
        self,
        files: Mapping[str, bytes],
        path: Path,
        size: tuple[int, int] | None = None,
        view: View | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """Draws a video of the scene at the stored joint positions.

        ``files`` are the outputs of the ``mjcf`` backend.  The suffix of ``path`` selects the
        format MP4 or GIF.  The camera of the video follows the robots.  ``progress`` is called with
        the number of finished pictures.  An existing file is replaced only when the new video is
        complete.  Raises ``PictureError`` if MuJoCo or the video encoder fails.  Raises ``OSError``
        if the file cannot be written.
        """
        video_format = path.suffix.lower().lstrip(".")
        size = size or SIZES[video_format]
        pictures = self._pictures(files, size, view or View(), progress)
        with errors_with_name(path):
            handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=STAGE_PREFIX)
        os.close(handle)
        try:
            with errors_with_name(path):
                if video_format == "gif":
                    _write_gif(pictures, temporary, self.rate)
                else:
                    _write_mp4(pictures, temporary, self.rate, size)
                os.chmod(temporary, 0o644)
                os.replace(temporary, path)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise

    def _pictures(
        self,
        files: Mapping[str, bytes],
        size: tuple[int, int],
        view: View,
        progress: Callable[[float], None] | None,
    ) -> Iterator[Any]:
        """Yields the pictures as arrays of bytes with the shape (height, width, 3)."""
        import numpy as np

        scene = picture_scene(files, size, view, quick=True)
        if self._positions and len(self._positions[0]) != scene.model.nq:
            raise PictureError("the scene to draw differs from the simulated one")
        boxes = BoundingBoxes(scene)
        cameras, limits = [], []
        for position in self._positions:
            self._apply(scene, position)
            points = boxes.corners(scene)
            limits += [points.min(axis=0), points.max(axis=0)]
            cameras.append(fit_camera(points, view, size[0] / size[1]))
        if not cameras:
            raise PictureError("the run ended before its first picture")
        # The camera distance is the same in all pictures of the video.  The picture in which the
        # robots are furthest apart determines the camera distance.
        distance = max(camera.distance for camera in cameras)
        with renderer(scene, size, np.array(limits)) as drawing:
            for number, (position, camera) in enumerate(
                zip(self._positions, cameras, strict=True), start=1
            ):
                self._apply(scene, position)
                camera.distance = distance
                drawing.update_scene(scene.data, camera)
                yield drawing.render()
                if progress is not None:
                    progress(number)

    def _apply(self, scene: MujocoScene, position: Any) -> None:
        scene.data.qpos[:] = position
        scene.forward()


def _write_gif(pictures: Iterator[Any], path: str, rate: float) -> None:
    from PIL import Image

    first = Image.fromarray(next(pictures)).quantize(128)
    rest = (
        Image.fromarray(pixels).quantize(palette=first, dither=Image.Dither.NONE)
        for pixels in pictures
    )
    first.save(
        path, "GIF", save_all=True, append_images=rest, duration=round(1000.0 / rate), loop=0
    )


def _write_mp4(pictures: Iterator[Any], path: str, rate: float, size: tuple[int, int]) -> None:
    command = [encoder(), "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{size[0]}x{size[1]}", "-r", f"{rate:g}", "-i", "-"]
    command += ["-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4", path]
    with (
        tempfile.TemporaryFile() as messages,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=messages
        ) as process,
    ):
        with contextlib.suppress(BrokenPipeError):  # ffmpeg ended; its message has the reason
            for pixels in pictures:
                if process.stdin is not None:
                    process.stdin.write(pixels.tobytes())
            if process.stdin is not None:
                process.stdin.close()
        if process.wait():
            messages.seek(0)
            lines = messages.read().decode(errors="replace").split("\n")
            raise PictureError(f"ffmpeg could not write the MP4: {lines[0] or process.returncode}")
