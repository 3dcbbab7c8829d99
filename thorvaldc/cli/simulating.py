"""``sim``: drive a robot in MuJoCo from the files that a build would write."""

from __future__ import annotations

import contextlib
import gc
import json as json_format
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import typer

from thorvaldc.cli.compiling import compile_one
from thorvaldc.cli.exits import INPUT
from thorvaldc.cli.faults import Faults, finite, message
from thorvaldc.cli.options import seconds_of
from thorvaldc.cli.picturing import RunPictures
from thorvaldc.cli.progress import Progress
from thorvaldc.cli.recording import each, open_logs, open_recorder, recorded

if TYPE_CHECKING:
    from thorvaldc.compiler.scenario.variations import Change
    from thorvaldc.simulation.control_loop import TickCallback

SECONDS = 5.0  # of a twist, where the user does not say


@dataclass(frozen=True, slots=True)
class Varying:
    """What ``sim`` was told of variations, as text."""

    settings: Sequence[str]
    own: bool
    draws: str
    seed: str
    jobs: str
    output: str

    def asked(self) -> bool:
        """Whether there are any; raises ``typer.BadParameter`` for what is only for them."""
        if self.settings or self.own:
            return True
        given = {"--draws": self.draws, "--seed": self.seed, "--jobs": self.jobs}
        _refuse({**given, "--output": self.output}, "this is for --set and --variations")
        return False


def _refuse(given: Mapping[str, str | bool], why: str) -> None:
    for option, value in given.items():
        if value:
            raise typer.BadParameter(why, param_hint=f"'{option}'")


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
    scenario: str = "",
    record: str = "",
    junit: str = "",
    replay: str = "",
    varying: Varying | None = None,
) -> int:
    """One twist for a time, or without a twist the manoeuvre that suits the robot.

    A scenario is run where ``file`` is one, or by the robot of ``file`` where it is
    named beside.  The joint states go to ``log`` where it is named.  With ``replay`` nothing is
    simulated: it is a record, which goes through the same outputs.
    """
    seconds = seconds_of(duration, "--duration") if duration else 0.0
    given: dict[str, str | bool]
    changes: Sequence[Change] = ()
    robot = file if scenario else None
    if varying is not None and varying.asked():
        from thorvaldc.cli.batching import only_run, plan, run_batch

        name = scenario or file
        found = plan(name, varying.settings, varying.draws, varying.seed, own=varying.own)
        if found is None:
            return INPUT
        single = only_run(found)
        if single is None:
            given = {"--duration": duration, "--twist": twist, "--parameters": parameters}
            given |= {"--record": record, "--junit": junit, "--log": log, "--plot": plot}
            given |= {"--video": video, "--ideal": ideal, "--open-loop": open_loop}
            given |= {"--replay": replay}
            _refuse(given, f"this is for one run, and there are {found.size}")
            return run_batch(name, found, robot, library, varying.jobs, varying.output, json)
        changes = single
    pictures = RunPictures(plot, video, ideal=ideal)
    done = compile_one(scenario or file, library, robot, changes)
    if done.model is None:
        return INPUT
    if replay:
        given = {"--duration": duration, "--twist": twist, "--log": log, "--junit": junit}
        given |= {"--parameters": parameters, "--ideal": ideal, "--open-loop": open_loop}
        _refuse(given, "a record is played as it is")
        from thorvaldc.cli.replaying import replay as play_back

        return play_back(done, replay, pictures, record, json)
    if done.scenario is not None:
        given = {"--duration": duration, "--twist": twist}
        given |= {"--ideal": ideal, "--open-loop": open_loop}
        _refuse(given, "a scenario says it itself")
        from thorvaldc.cli.scenarios import run_scenario

        return run_scenario(
            done, done.scenario, pictures, parameters or None, record, junit, log, json
        )
    for option, text in {"--scenario": scenario, "--junit": junit}.items():
        if text:
            wrong = scenario or file
            raise typer.BadParameter(f"{wrong} is no scenario", param_hint=f"'{option}'")
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.error import DiagnosticError
    from thorvaldc.model.scenario import GROUPS
    from thorvaldc.runtime.twist_text import parse_twist
    from thorvaldc.simulation.records.recorder import record_ticks
    from thorvaldc.simulation.run_result import result_table
    from thorvaldc.simulation.simulation_run import Simulation

    gc.enable()
    report = Report()
    faults = Faults("text", sys.stderr)
    try:
        files = None if ideal else emit(done.model, ["mjcf"], report)
        simulation = Simulation(done.model, files, parameters or None, open_loop=open_loop)
        motion = parse_twist(twist) if twist else None
        length = seconds or (SECONDS if motion is not None else simulation.demonstration()[1])
        with contextlib.ExitStack() as stack:
            progress = Progress(length)
            watches: list[TickCallback] = [progress.watch, pictures.watch]
            robots = simulation.robots
            recorders = open_recorder(record, robots, GROUPS, 0.0, stack)
            if recorders:
                watches.append(record_ticks(recorders))
            if log:
                watches.append(open_logs(log, robots, stack))
            stack.callback(progress.clear)
            watch = each(watches)
            if motion is not None:
                result = simulation.run(length, motion, report, watch)
            else:
                result = simulation.demonstrate(report, length, watch)
    except DiagnosticError as fault:
        report.put(fault.diagnostic)
        faults.add(done.located(report), done.sources)
        return faults.finish()
    if json:
        print(json_format.dumps(finite(result.as_json()), indent=1, ensure_ascii=False))
    else:
        print(result_table([result]))
    faults.add(done.located(report), done.sources)
    if record:
        message(recorded(record, simulation.robots))
    pictures.write(done.model, simulation.robots, files)
    return faults.finish()
