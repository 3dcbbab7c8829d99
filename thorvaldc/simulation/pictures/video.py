"""Films of runs: positions are kept while it runs and drawn when it is over."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thorvaldc.simulation.physics.mujoco_base import MujocoScene
from thorvaldc.simulation.pictures import PictureError
from thorvaldc.simulation.pictures.render import View, aim, picture_scene, renderer

if TYPE_CHECKING:
    from thorvaldc.simulation.pictures.visible_shapes import Points

FORMATS = ("mp4", "gif")
RATES = {"mp4": 25.0, "gif": 12.5}
"""Pictures a second; a GIF counts in hundredths of a second."""
SIZES = {"mp4": (960, 540), "gif": (640, 360)}


def encoder() -> str:
    """The ``ffmpeg`` to make MP4 by.  Raises ``PictureError`` where there is none."""
    found = shutil.which("ffmpeg")
    if found:
        return found
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise PictureError(
            "an MP4 needs an encoder, and there is none: pip install 'thorvaldc[video]', put"
            " ffmpeg on the PATH, or ask for a .gif"
        ) from None


class VideoRecorder:
    """What is to be seen of a run in ``scene``, at ``rate`` pictures a second."""

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self._positions: list[Any] = []

    def on_tick(self, scene: MujocoScene) -> None:
        """Keep where everything is, if it is time for a picture.  Call it at each tick."""
        if scene.time >= len(self._positions) / self.rate - 1e-9:
            self.keep(scene)

    def keep(self, scene: MujocoScene) -> None:
        """Keep where everything is, for the next picture."""
        self._positions.append(scene.data.qpos.copy())

    def __len__(self) -> int:
        """How many pictures there will be."""
        return len(self._positions)

    def write(
        self,
        files: Mapping[str, bytes],
        path: Path,
        size: tuple[int, int] | None = None,
        view: View | None = None,
        drawn: Callable[[float], None] | None = None,
    ) -> None:
        """Draw the scene of ``files`` (the ``mjcf`` outputs) at those positions, to MP4 or GIF.

        The camera follows the robots; ``drawn`` is told how many pictures are.  A file that is
        there is replaced when the new one is whole.  Raises ``PictureError`` and ``OSError``.
        """
        kind = path.suffix.lower().lstrip(".")
        size = size or SIZES[kind]
        pictures = self._pictures(files, size, view or View(), drawn)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        os.close(handle)
        try:
            if kind == "gif":
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
        drawn: Callable[[float], None] | None,
    ) -> Iterator[Any]:
        """Arrays (height, width, 3) of bytes."""
        import numpy as np

        scene = picture_scene(files, size, view, quick=True)
        if self._positions and len(self._positions[0]) != scene.model.nq:
            raise PictureError("the scene to draw is not the one that was simulated")
        boxes = BoundingBoxes(scene)
        cameras, limits = [], []
        for position in self._positions:
            self._place(scene, position)
            points = boxes.corners(scene)
            limits += [points.min(axis=0), points.max(axis=0)]
            cameras.append(aim(points, view, size[0] / size[1]))
        if not cameras:
            raise PictureError("the run ended before its first picture")
        # Near enough for the moment at which the robots are furthest apart, and steady.
        distance = max(camera.distance for camera in cameras)
        with renderer(scene, size, np.array(limits)) as drawing:
            for number, (position, camera) in enumerate(
                zip(self._positions, cameras, strict=True), start=1
            ):
                self._place(scene, position)
                camera.distance = distance
                drawing.update_scene(scene.data, camera)
                yield drawing.render()
                if drawn is not None:
                    drawn(number)

    def _place(self, scene: MujocoScene, position: Any) -> None:
        scene.data.qpos[:] = position
        scene.forward()


class BoundingBoxes:
    """The boxes about all that is seen of what can move: quick to tell where it is."""

    def __init__(self, scene: MujocoScene) -> None:
        import numpy as np

        model = scene.model
        seen = (model.geom_group <= 2) & (model.geom_bodyid > 0)
        self._geoms = np.flatnonzero(seen)
        signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        centre, half = model.geom_aabb[seen, None, :3], model.geom_aabb[seen, None, 3:]
        self._local = centre + signs * half

    def corners(self, scene: MujocoScene) -> Points:
        """Their corners in the world, (n, 3)."""
        import numpy as np

        if not len(self._geoms):
            return np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])
        turned = scene.data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        places = scene.data.geom_xpos[self._geoms][:, None, :]
        world: Points = (self._local @ turned.transpose(0, 2, 1) + places).reshape(-1, 3)
        return world


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
        tempfile.TemporaryFile() as said,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said
        ) as process,
    ):
        with contextlib.suppress(BrokenPipeError):  # it says why
            for pixels in pictures:
                if process.stdin is not None:
                    process.stdin.write(pixels.tobytes())
            if process.stdin is not None:
                process.stdin.close()
        if process.wait():
            said.seek(0)
            lines = said.read().decode(errors="replace").split("\n")
            raise PictureError(f"ffmpeg could not make the MP4: {lines[0] or process.returncode}")
