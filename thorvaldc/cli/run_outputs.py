"""The records, joint logs, plots and videos of a run.

Records and logs are opened before the run; plots and videos are checked before it and drawn after
it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import typer

from thorvaldc.cli.diagnostic_output import Progress, message
from thorvaldc.cli.exits import OutsideError, closing_when_terminated, write_errors
from thorvaldc.cli.options import check_output
from thorvaldc.diagnostics.files import AtomicFile
from thorvaldc.model import Fleet, Robot
from thorvaldc.simulation.control_loop import ControlLoop, Sample, TickCallback
from thorvaldc.simulation.pictures import check_pillow
from thorvaldc.simulation.pictures.plot import FORMATS as PLOT_FORMATS
from thorvaldc.simulation.pictures.plot import check_plotting, plot
from thorvaldc.simulation.pictures.render import choose_opengl_backend
from thorvaldc.simulation.pictures.video import FORMATS as VIDEO_FORMATS
from thorvaldc.simulation.pictures.video import RATES, VideoRecorder, encoder
from thorvaldc.simulation.records.csv_record import CsvRecorder
from thorvaldc.simulation.records.joint_csv import JointLogWriter
from thorvaldc.simulation.records.recorder import Recorder

Robots = Sequence[tuple[str, Robot]]
_UNSUPPORTED_SUFFIXES = (".bag", ".db3", ".json", ".parquet", ".txt")


def open_recorders(
    record: str, robots: Robots, groups: Sequence[str], every: float, stack: ExitStack
) -> Sequence[Recorder]:
    """Opens the file or folder of the option ``--record`` and returns the recorder.

    An empty path means that the run is not recorded. A record path that ends in ``.mcap`` is one
    MCAP file for all robots. A record path that ends in ``.csv`` is a CSV file for one robot. Any
    other record path is a folder with a CSV file for each robot.

    - ``every``: recording period in s.
    - ``stack``: closes the recorder at the end of the run.
    """
    if not record:
        return ()
    path = Path(record)
    _check_path(path, record, len(robots))
    with write_errors(record):
        recorder: Recorder
        if path.suffix.lower() == ".mcap":
            # A run without a record does not need the backends of the robot in it.
            from thorvaldc.simulation.records.mcap_writer import McapRecorder

            recorder = McapRecorder(path, robots, groups, every)
        else:
            recorder = CsvRecorder(path, robots, groups, every)
    stack.enter_context(closing_when_terminated())
    stack.callback(recorder.close)
    return (recorder,)


def _check_path(path: Path, record: str, robot_count: int) -> None:
    suffix = path.suffix.lower()
    if suffix == ".csv" and robot_count > 1:
        raise typer.BadParameter(
            f"{robot_count} robots do not go into one CSV file; name a .mcap file, or a folder for"
            " CSV files",
            param_hint="'--record'",
        )
    if suffix in _UNSUPPORTED_SUFFIXES:
        kinds = "a .mcap file" if robot_count > 1 else "a .mcap or .csv file"
        raise typer.BadParameter(
            f"no record is a {suffix} file; name {kinds}, or a folder for CSV files",
            param_hint="'--record'",
        )
    if suffix not in (".mcap", ".csv") and path.is_file():
        raise OutsideError(f"cannot write {record}: it is a file; name a folder, or a .mcap file")


def record_summary(record: str, robots: Robots) -> str:
    """Returns the file names of a record as one line of text."""
    path = Path(record)
    if path.suffix.lower() == ".mcap":
        from thorvaldc.simulation.records.foxglove_layout import LAYOUT_SUFFIX

        return f"{record}, {path.with_suffix(LAYOUT_SUFFIX)}"
    if path.suffix.lower() == ".csv":
        return record
    return f"{record}: {', '.join(f'{name}.csv' for name, _ in robots)}"


def open_joint_logs(log: str, robots: Robots, stack: ExitStack) -> TickCallback:
    """Opens the joint logs, and returns a function that writes the joint states of each tick.

    For one robot, ``log`` is the path of the joint log file. For several robots, ``log`` is the
    path of a folder with a joint log for each robot.
    """
    folder = Path(log)
    has_fleet = len(robots) > 1
    writers = {}
    with write_errors(log):
        if has_fleet:
            folder.mkdir(parents=True, exist_ok=True)
        for name, robot in robots:
            path = folder / f"{name}.csv" if has_fleet else folder
            file = AtomicFile(path, keep_incomplete=True)
            stack.callback(file.close)  # also after an error of the run
            writers[name] = JointLogWriter(robot, file)

    def watch(loop: ControlLoop) -> None:
        writers[loop.name].on_tick(loop)

    return watch


def call_all(watches: Sequence[TickCallback]) -> TickCallback:
    """Returns a function that calls each callback in ``watches``."""

    def watch(loop: ControlLoop) -> None:
        for call in watches:
            call(loop)

    return watch


class RunOutputs:
    """The plot, the video, the record and the joint logs of a run.  An empty path: none.

    The constructor checks the options. Call ``check_installation`` when the files of the run are
    read, open ``outputs`` around the simulation, and call ``write`` after it.
    """

    def __init__(
        self, plot: str, video: str = "", record: str = "", log: str = "", *, ideal: bool = False
    ) -> None:
        self.plot = plot
        self.video = video
        self.record = record
        self.log = log
        self._samples: dict[str, list[Sample]] = {}
        self._video_recorder: VideoRecorder | None = None
        if plot:
            check_output(plot, PLOT_FORMATS, "--plot")
        if video:
            check_output(video, VIDEO_FORMATS, "--video")
            if ideal:
                raise typer.BadParameter(
                    "a run with ideal joints has no scene for a video; leave out --ideal",
                    param_hint="'--video'",
                )
            self._video_recorder = VideoRecorder(RATES[_suffix(video)])

    def check_installation(self) -> None:
        """Raises ``OutsideError`` if the plot or the video needs something that is not installed.

        Errors in options and files are reported first, because the user can correct them here.
        Call it before the import of MuJoCo, because it selects the OpenGL backend of MuJoCo.
        """
        if self.plot:
            check_plotting()
        if self.video:
            if _suffix(self.video) == "gif":
                check_pillow()
            else:
                encoder()
            choose_opengl_backend()

    @contextmanager
    def open(
        self, robots: Robots, groups: Sequence[str], every: float, duration: float
    ) -> Iterator[tuple[Sequence[Recorder], TickCallback]]:
        """Opens the record and the logs, and yields the recorders and what is called in each tick.

        - ``every``: recording period in s.
        - ``duration``: expected duration of the run in s, for the progress bar.
        """
        with ExitStack() as stack:
            recorders = open_recorders(self.record, robots, groups, every, stack)
            progress = Progress(duration)
            watches: list[TickCallback] = [progress.watch, self.watch]
            if self.log:
                watches.append(open_joint_logs(self.log, robots, stack))
            stack.callback(progress.clear)
            yield recorders, call_all(watches)

    def watch(self, loop: ControlLoop) -> None:
        """Stores the current sample for the plot and the current scene for the video."""
        if self.plot:
            self._samples.setdefault(loop.name, []).append(loop.sample())
        if self._video_recorder is not None and loop.scene is not None:
            self._video_recorder.on_tick(loop.scene)

    def write(
        self,
        model: Robot | Fleet,
        robots: Sequence[tuple[str, Robot]],
        files: Mapping[str, bytes] | None,
    ) -> None:
        """Draws the plot and the video of the run, and names the files on stderr.

        ``files`` contains the MJCF files of the robots by path.
        """
        if self.record:
            message(record_summary(self.record, robots))
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


def _suffix(path: str) -> str:
    return Path(path).suffix.lower().lstrip(".")
