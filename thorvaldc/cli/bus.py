"""``bus``: a robot's simulated bus as a process that other programs attach to."""

from __future__ import annotations

import gc
import json as json_format
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from thorvaldc.cli.compiling import compile_one
from thorvaldc.cli.exits import DONE, INPUT
from thorvaldc.cli.faults import Faults

if TYPE_CHECKING:
    from thorvaldc.model import Robot
    from thorvaldc.model.bus_faults import BusFault
    from thorvaldc.runtime.base_interface import BaseHandle
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

NOTABLE_LAG = 50_000_000
"""ns behind the clock that are worth a word."""


def run_bus(
    file: str,
    channel: str,
    physics: str,
    faults: str,
    seed: str,
    store: str,
    delivered: bool,
    lockstep: bool,
    json: bool,
    library: Sequence[str],
) -> int:
    """Until it is interrupted or terminated, which are the ways to end it."""
    if physics not in ("ideal", "mujoco"):
        raise typer.BadParameter(
            f"{physics!r} is neither ideal nor mujoco", param_hint="'--physics'"
        )
    number = _seed(seed)
    done = compile_one(file, library)
    from thorvaldc.compiler.injected_fault_file import read_faults
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.error import DiagnosticError
    from thorvaldc.model import Robot
    from thorvaldc.simulation.bus import fault_injection as bus_faults
    from thorvaldc.simulation.bus.bus_server import BusServer
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

    robot = done.model
    if robot is None:
        return INPUT
    if not isinstance(robot, Robot):
        raise typer.BadParameter(f"{file} is no robot", param_hint="FILE")
    gc.enable()
    kept = read_store(store)
    report, found = Report(), Report()
    try:
        script = read_faults(faults, robot, report) if faults else None
        if faults and script is None:
            return _tell(report, done.sources | {faults: Path(faults)})
        base = _mujoco(robot, emit(robot, ["mjcf"], report)) if physics == "mujoco" else None
        chosen = number if number is not None else script.seed if script is not None else 0
        simulated = SimulatedRobot(
            robot, seed=chosen, base=base, delivered=delivered, nonvolatile=kept
        )
    except DiagnosticError as fault:
        found.put(fault.diagnostic)
        return _tell(done.located(found), done.sources)
    _tell(report, done.sources)
    if script is not None:
        bus_faults.FaultInjector(simulated, script, _say_fault)
    channels = _channels(robot, channel)
    server = BusServer(
        simulated.timeline,
        {name: simulated.wires[bus] for bus, name in channels.items()},
        lockstep=lockstep,
    )
    before = {
        number: signal.signal(number, lambda *_: server.stop())
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        simulated.power_on()
        _say_start(simulated, channels, json)
        server.run()
    finally:
        for number_, handler in before.items():
            signal.signal(number_, handler)
        if store:
            write_store(store, simulated)
    _say_end(simulated, server.behind)
    return DONE


def _seed(text: str) -> int | None:
    if not text:
        return None
    try:
        return int(text, 0)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is no whole number", param_hint="'--seed'") from None


def _channels(robot: Robot, channel: str) -> dict[str, str]:
    """The channel of each bus: one name for a single bus, else with the bus's name behind."""
    name = channel or robot.name
    if len(robot.buses) == 1:
        return {robot.buses[0].name: name}
    return {bus.name: f"{name}.{bus.name}" for bus in robot.buses}


def _mujoco(robot: Robot, files: dict[str, bytes]) -> BaseHandle:
    from thorvaldc.simulation.physics.mujoco_base import MujocoBase, MujocoScene

    return MujocoBase(robot, MujocoScene(files))


def _tell(report: Any, sources: dict[str, Path]) -> int:
    shown = Faults("text", sys.stderr)
    shown.add(report, sources)
    return shown.finish()


# -- what devices keep ----------------------------------------------------------------------------


def read_store(store: str) -> dict[str, dict[str, Any]]:
    """What devices kept when the bus was run the last time; nothing the first time."""
    if not store or not os.path.exists(store):
        return {}
    try:
        found = json_format.loads(Path(store).read_text(encoding="utf-8"))
    except (UnicodeDecodeError, ValueError) as fault:
        raise typer.BadParameter(f"{store}: {fault}", param_hint="'--store'") from None
    whole = isinstance(found, dict) and all(
        isinstance(values, dict)
        and all(
            isinstance(value, int)
            or (isinstance(value, dict) and all(isinstance(v, int) for v in value.values()))
            for value in values.values()
        )
        for values in found.values()
    )
    if not whole:
        raise typer.BadParameter(f"{store} is not what devices have kept", param_hint="'--store'")
    return dict(found)


def write_store(store: str, simulated: SimulatedRobot) -> None:
    kept = {name: device.nonvolatile for name, device in simulated.devices.items()}
    text = json_format.dumps(kept, indent=1, ensure_ascii=False) + "\n"
    Path(store).write_text(text, encoding="utf-8")


# -- what is said ----------------------------------------------------------------------------


def _say_start(simulated: SimulatedRobot, channels: dict[str, str], json: bool) -> None:
    buses = {bus.name: bus for bus in simulated.robot.buses}
    if json:
        listed = [
            {
                "bus": name,
                "channel": channel,
                "interface": "thorvaldc_sim",
                "bitrate": buses[name].bitrate,
                "devices": [node.name for node in buses[name].nodes],
            }
            for name, channel in channels.items()
        ]
        print(json_format.dumps(listed), flush=True)
        return
    for name, channel in channels.items():
        bus = buses[name]
        print(
            f"{name}: {len(bus.nodes)} devices at {bus.bitrate // 1000} kbit/s; "
            f'can.Bus(interface="thorvaldc_sim", channel="{channel}")',
            flush=True,
        )
    if sys.stderr.isatty():
        print("Ctrl-C ends it.", file=sys.stderr)


def _say_fault(time: float, fault: BusFault, begins: bool) -> None:
    what = fault.kind.replace("_", " ")
    of = f" of {fault.node}" if fault.node is not None else ""
    ends = "" if begins else " ends"
    print(f"{time:.3f} s: {what}{of}{ends}", file=sys.stderr, flush=True)


def _say_end(simulated: SimulatedRobot, behind: int) -> None:
    seconds = simulated.timeline.seconds
    for name, wire in simulated.wires.items():
        load = wire.busy / max(simulated.timeline.now, 1)
        print(
            f"{name}: {wire.frames} frames in {seconds:.1f} s, {100 * load:.1f} % of the time, "
            f"{wire.errors} error frames",
            file=sys.stderr,
        )
    if behind > NOTABLE_LAG:
        print(
            f"the simulation fell behind the clock, by {behind / 1e9:.2f} s at most: "
            "times on the bus were longer than they should be",
            file=sys.stderr,
        )
