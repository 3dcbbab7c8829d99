"""``sim``: drive a robot in MuJoCo from the files that a build would write."""

from __future__ import annotations

import contextlib
import gc
import json as json_format
import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import typer

from thorvaldc.cli.compiling import compile_one
from thorvaldc.cli.exits import INPUT
from thorvaldc.cli.faults import Faults
from thorvaldc.cli.picturing import RunPictures

if TYPE_CHECKING:
    from thorvaldc.runtime.meter import Meter, Watch

SECONDS = 5.0  # of a twist, where the user does not say


def simulate(
    file: str,
    duration: str,
    twist: str,
    parameters: str,
    json: bool,
    ideal: bool,
    open_loop: bool,
    log: str,
    library: Sequence[str],
    plot: str = "",
    video: str = "",
) -> int:
    """One twist for a time, or without a twist the manoeuvre that suits the robot.

    The joint states go to ``log`` where it is named.
    """
    seconds = _seconds(duration) if duration else 0.0
    pictures = RunPictures(plot, video, ideal=ideal)
    done = compile_one(file, library)
    if done.model is None:
        return INPUT
    from thorvaldc.diagnostics import Report
    from thorvaldc.model import Robot
    from thorvaldc.pipeline import emit
    from thorvaldc.runtime.faults import RuntimeFault
    from thorvaldc.runtime.joint_log import JointLogWriter
    from thorvaldc.runtime.manoeuvre import parse_twist
    from thorvaldc.runtime.simulation import DemoRow, Simulation, demo_table

    if log and not isinstance(done.model, Robot):
        raise typer.BadParameter("a fleet has no log; simulate one robot", param_hint="'--log'")
    gc.enable()
    report = Report()
    faults = Faults("text", sys.stderr)
    try:
        files = None if ideal else emit(done.model, ["mjcf"], report)
        simulation = Simulation(done.model, files, parameters or None, open_loop=open_loop)
        with contextlib.ExitStack() as stack:
            watches: list[Watch] = [pictures.watch]
            if log and isinstance(done.model, Robot):
                stream = stack.enter_context(open(log, "w", encoding="utf-8", newline="\n"))
                watches.append(JointLogWriter(done.model, stream).watch)
            watch = _each(watches)
            if twist:
                result = simulation.run(seconds or SECONDS, parse_twist(twist), report, watch)
            else:
                result = simulation.demonstrate(report, seconds or None, watch)
    except RuntimeFault as fault:
        report.put(fault.diagnostic)
        faults.add(done.located(report), done.sources)
        return faults.finish()
    if json:
        print(json_format.dumps(_finite(result.as_json()), indent=1, ensure_ascii=False))
    else:
        print(demo_table([DemoRow(run, result.real_time_factor) for run in result.robots]))
    faults.add(done.located(report), done.sources)
    pictures.write(done.model, simulation, files)
    return faults.finish()


def _each(watches: Sequence[Watch]) -> Watch:
    def watch(meter: Meter) -> None:
        for one in watches:
            one(meter)

    return watch


def _seconds(text: str) -> float:
    from thorvaldc.source.units import UnitError, parse_quantity

    try:
        seconds = parse_quantity(text, "time")
    except UnitError as fault:
        raise typer.BadParameter(f"{text!r}: {fault}", param_hint="'--duration'") from None
    if not 0.0 < seconds <= 86400.0:
        raise typer.BadParameter(
            f"{text!r} is not between 0 and 86400 s", param_hint="'--duration'"
        )
    return seconds


def _finite(value: Any) -> Any:
    """JSON has no infinities: a number that a run away simulation left becomes null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return value
