"""``render``, and the pictures of a run: checked before it, drawn after it."""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import typer

from thorvaldc.cli.compiling import compile_one
from thorvaldc.cli.exits import INPUT, OutsideError
from thorvaldc.cli.faults import Faults, message
from thorvaldc.cli.progress import Progress

if TYPE_CHECKING:
    from thorvaldc.model import Fleet, Robot
    from thorvaldc.simulation.control_loop import ControlLoop, Sample
    from thorvaldc.simulation.pictures.video import VideoRecorder
    from thorvaldc.tools.replay import Replay

T = TypeVar("T")


def render_file(
    file: str,
    output: str,
    size: str,
    view: str,
    library: Sequence[str],
    replay: str = "",
    at: str = "",
) -> int:
    """A picture of the robots as they stand, or as the record ``replay`` has them ``at`` a time."""
    from thorvaldc.simulation.pictures import check_pillow
    from thorvaldc.simulation.pictures.opengl_backend import choose_opengl_backend

    with outside_errors():
        check_pillow()
        choose_opengl_backend()
    from thorvaldc.simulation.pictures.render import parse_size, parse_view, render

    pixels = parsed(size, parse_size, "--size")
    camera = parsed(view, parse_view, "--view")
    if at and not replay:
        raise typer.BadParameter("this is a time of --replay", param_hint="'--at'")
    time = parsed(at, parse_time, "--at") if at else math.inf
    if output:
        check_output(output, ["png"], "--output")
    done = compile_one(file, library)
    if done.model is None:
        return INPUT
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.error import DiagnosticError

    path = output or f"{done.model.name}.png"
    if not output:
        check_output(path, ["png"], "--output")
    report = Report()
    arrange = None
    if replay:
        from thorvaldc.cli.replaying import arranged

        arrange = arranged(done, replay, time)
        if arrange is None:
            return INPUT
    try:
        with outside_errors():
            files = emit(done.model, ["mjcf"], report)
            picture = render(done.model, files, pixels, camera, arrange=arrange)
    except DiagnosticError as fault:
        report.put(fault.diagnostic)
    else:
        Path(path).write_bytes(picture)
        print(path)
    faults = Faults("text", sys.stderr)
    faults.add(done.located(report), done.sources)
    return faults.finish()


@contextmanager
def outside_errors() -> Iterator[None]:
    """What the machine lacks for pictures, as a fault of the world."""
    from thorvaldc.simulation.pictures import PictureError

    try:
        yield
    except PictureError as fault:
        raise OutsideError(str(fault)) from None


def parse_time(text: str) -> float:
    """Seconds.  Raises ``ValueError``."""
    from thorvaldc.compiler.source.units import UnitError, parse_quantity

    try:
        seconds = parse_quantity(text, "time")
    except UnitError as fault:
        raise ValueError(f"{text!r}: {fault}") from None
    if not seconds >= 0.0:
        raise ValueError(f"{text!r} is before the beginning")
    return seconds


def parsed(text: str, parse: Callable[[str], T], option: str) -> T:
    """The option's value; raises ``typer.BadParameter`` for the parser's ``ValueError``."""
    try:
        return parse(text)
    except ValueError as fault:
        raise typer.BadParameter(str(fault), param_hint=f"'{option}'") from None


def check_output(path: str, kinds: Sequence[str], option: str) -> None:
    """Whether a file of one of these kinds can be written there, known before the work is done.

    Raises ``typer.BadParameter`` for another suffix and ``OutsideError`` for a folder that is
    missing or not ours to write in.
    """
    target = Path(path)
    if target.suffix.lower().lstrip(".") not in kinds:
        wanted = " or ".join(f".{kind}" for kind in kinds)
        raise typer.BadParameter(f"{path!r} does not end in {wanted}", param_hint=f"'{option}'")
    if target.is_dir():
        raise OutsideError(f"cannot write {path}: it is a folder")
    try:
        with tempfile.TemporaryFile(dir=target.parent):
            pass
    except OSError as fault:
        raise OutsideError(f"cannot write {path}: {fault.strerror or fault}") from None


class RunPictures:
    """The pictures that a run was asked for; empty paths ask for none.

    Make it before the run and before MuJoCo is imported (what cannot be drawn is known
    then), hand ``watch`` to the run and call ``write`` after it.
    """

    def __init__(self, plot: str, video: str = "", *, ideal: bool = False) -> None:
        self.plot = plot
        self.video = video
        self._samples: dict[str, list[Sample]] = {}
        self._film: VideoRecorder | None = None
        if plot:
            self._prepare_plot()
        if video:
            self._prepare_video(ideal)

    def _prepare_plot(self) -> None:
        from thorvaldc.simulation.pictures.plot import FORMATS, check_plotting

        check_output(self.plot, FORMATS, "--plot")
        with outside_errors():
            check_plotting()

    def _prepare_video(self, ideal: bool) -> None:
        from thorvaldc.simulation.pictures import check_pillow
        from thorvaldc.simulation.pictures.opengl_backend import choose_opengl_backend
        from thorvaldc.simulation.pictures.video import FORMATS, RATES, VideoRecorder, encoder

        check_output(self.video, FORMATS, "--video")
        if ideal:
            raise typer.BadParameter(
                "ideal joints move in no scene that could be shown; leave out --ideal",
                param_hint="'--video'",
            )
        kind = Path(self.video).suffix.lower().lstrip(".")
        with outside_errors():
            if kind == "gif":
                check_pillow()
            else:
                encoder()
            choose_opengl_backend()
        self._film = VideoRecorder(RATES[kind])

    def watch(self, loop: ControlLoop) -> None:
        if self.plot:
            self._samples.setdefault(loop.name, []).append(loop.sample())
        if self._film is not None and loop.scene is not None:
            self._film.on_tick(loop.scene)

    def replay(self, samples: Mapping[str, Sequence[Sample]], show: Replay | None) -> None:
        """Take samples that were recorded in place of a run; ``show`` places them in a scene."""
        self._samples = {name: list(of) for name, of in samples.items()}
        if self._film is not None and show is not None:
            for _ in show.times(self._film.rate):
                self._film.store(show.scene)

    def write(
        self,
        model: Robot | Fleet,
        robots: Sequence[tuple[str, Robot]],
        files: Mapping[str, bytes] | None,
    ) -> None:
        with outside_errors():
            if self.plot:
                from thorvaldc.simulation.pictures.plot import plot

                plot(dict(robots), self._samples, self.plot, model.name)
                message(self.plot)
            if self._film is not None and files is not None:
                progress = Progress(len(self._film), "pictures", self.video)
                try:
                    self._film.write(files, Path(self.video), progress=progress.show)
                finally:
                    progress.clear()
                message(self.video)
