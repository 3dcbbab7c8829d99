"""The plot and the video of a run: checks their files before the run and draws them after the
run."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import typer

from thorvaldc.cli.diagnostic_output import message
from thorvaldc.cli.exits import OutsideError
from thorvaldc.cli.progress import Progress
from thorvaldc.model import Fleet, Robot
from thorvaldc.simulation.control_loop import ControlLoop, Sample
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene
from thorvaldc.simulation.pictures import PictureError, check_pillow
from thorvaldc.simulation.pictures.plot import FORMATS as PLOT_FORMATS
from thorvaldc.simulation.pictures.plot import check_plotting, plot
from thorvaldc.simulation.pictures.render import FORMATS as VIDEO_FORMATS
from thorvaldc.simulation.pictures.render import (
    RATES,
    VideoRecorder,
    choose_opengl_backend,
    encoder,
)


@contextmanager
def picture_errors() -> Iterator[None]:
    """Converts the exception for a missing package or display to ``OutsideError``."""
    try:
        yield
    except PictureError as error:
        raise OutsideError(str(error)) from None


def check_output(path: str, suffixes: Sequence[str], option: str) -> None:
    """Checks before a long run that the plot or video file of an option can be written.

    Raises ``typer.BadParameter`` if the name of the file has none of the allowed suffixes. Raises
    ``OutsideError`` if the folder of the plot or video does not exist or cannot be written.
    """
    target = Path(path)
    if target.suffix.lower().lstrip(".") not in suffixes:
        known = " or ".join(f".{suffix}" for suffix in suffixes)
        raise typer.BadParameter(f"{path!r} does not end in {known}", param_hint=f"'{option}'")
    if target.is_dir():
        raise OutsideError(f"cannot write {path}: it is a folder")
    try:
        with tempfile.TemporaryFile(dir=target.parent):
            pass
    except OSError as error:
        raise OutsideError(f"cannot write {path}: {error.strerror or error}") from None


class RunPictures:
    """The plot and the video of a run. An empty path means that no plot or no video is drawn.

    The constructor must be called before the import of MuJoCo, because it selects the OpenGL
    backend of MuJoCo. The method ``watch`` must be called in each tick of the simulation. The
    method ``write`` draws the plot and the video after the run.
    """

    def __init__(self, plot: str, video: str = "", *, ideal: bool = False) -> None:
        self.plot = plot
        self.video = video
        self._samples: dict[str, list[Sample]] = {}
        self._video_recorder: VideoRecorder | None = None
        if plot:
            check_output(plot, PLOT_FORMATS, "--plot")
            with picture_errors():
                check_plotting()
        if video:
            self._video_recorder = _prepare_video(video, ideal)

    def watch(self, loop: ControlLoop) -> None:
        """Stores the current sample for the plot and the current scene for the video."""
        if self.plot:
            self._samples.setdefault(loop.name, []).append(loop.sample())
        if self._video_recorder is not None and loop.scene is not None:
            self._video_recorder.on_tick(loop.scene)

    def take_record(
        self,
        samples: Mapping[str, Sequence[Sample]],
        scenes: Callable[[float], Iterable[MujocoScene]] | None,
    ) -> None:
        """Stores the samples of a recorded run for the plot and the video.

        The function ``scenes`` returns the MuJoCo scene at each picture of the video, for a rate in
        Hz.
        """
        self._samples = {name: list(of_robot) for name, of_robot in samples.items()}
        if self._video_recorder is not None and scenes is not None:
            for scene in scenes(self._video_recorder.rate):
                self._video_recorder.store(scene)

    def write(
        self,
        model: Robot | Fleet,
        robots: Sequence[tuple[str, Robot]],
        files: Mapping[str, bytes] | None,
    ) -> None:
        """Draws the plot and the video of the run. ``files`` contains the MJCF files of the robots
        by path."""
        with picture_errors():
            if self.plot:
                world = model.world if isinstance(model, Fleet) else None
                plot(dict(robots), self._samples, self.plot, model.name, world)
                message(self.plot)
            if self._video_recorder is not None and files is not None:
                progress = Progress(len(self._video_recorder), "pictures", self.video)
                try:
                    self._video_recorder.write(files, Path(self.video), progress=progress.show)
                finally:
                    progress.clear()
                message(self.video)


def _prepare_video(video: str, ideal: bool) -> VideoRecorder:
    check_output(video, VIDEO_FORMATS, "--video")
    if ideal:
        raise typer.BadParameter(
            "a run with ideal joints has no scene for a video; leave out --ideal",
            param_hint="'--video'",
        )
    suffix = Path(video).suffix.lower().lstrip(".")
    with picture_errors():
        if suffix == "gif":
            check_pillow()
        else:
            encoder()
        choose_opengl_backend()
    return VideoRecorder(RATES[suffix])
