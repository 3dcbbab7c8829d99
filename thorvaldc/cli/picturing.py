"""``--plot``: pictures of a run, checked before it and drawn after it."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from thorvaldc.cli.exits import OutsideError
from thorvaldc.cli.faults import message

if TYPE_CHECKING:
    from thorvaldc.model import Fleet, Robot
    from thorvaldc.runtime.meter import Meter, Sample
    from thorvaldc.runtime.simulation import Simulation


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
    """The pictures that a run was asked for.

    Make it before the run (what cannot be drawn is known then), hand ``watch`` to the run
    and call ``write`` after it.
    """

    def __init__(self, plot: str) -> None:
        self.plot = plot
        self._samples: dict[str, list[Sample]] = {}
        if plot:
            from thorvaldc.runtime.pictures import PictureError
            from thorvaldc.runtime.pictures.plot import FORMATS, check_plotting

            check_output(plot, FORMATS, "--plot")
            try:
                check_plotting()
            except PictureError as fault:
                raise OutsideError(str(fault)) from None

    def watch(self, meter: Meter) -> None:
        if self.plot:
            self._samples.setdefault(meter.name, []).append(meter.sample())

    def write(self, model: Robot | Fleet, simulation: Simulation) -> None:
        if self.plot:
            from thorvaldc.runtime.pictures.plot import plot

            plot(dict(simulation.robots), self._samples, self.plot, model.name)
            message(self.plot)
