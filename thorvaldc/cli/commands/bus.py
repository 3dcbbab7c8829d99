"""The command ``thorvaldc bus``: simulates the CAN buses of a robot for other programs."""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT

if TYPE_CHECKING:
    from thorvaldc.model import Bus, Robot
    from thorvaldc.model.scenario import BusFault
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

REPORTED_DELAY = 50_000_000
"""Longest delay of the simulation behind the clock, in ns, that the command does not report."""


def bus(
    file: options.RobotFile,
    channel: Annotated[
        str,
        typer.Option(
            "--channel",
            metavar="NAME",
            help="Name of the bus for other programs, or the path of its socket.",
            show_default="the robot's name",
        ),
    ] = "",
    physics: options.Physics = "ideal",
    faults: options.InjectedFaults = "",
    seed: options.Seed = "",
    store: options.Store = "",
    delivered: Annotated[
        bool,
        typer.Option(
            "--delivered", help="Devices as delivered by the manufacturer: no ids, no parameters."
        ),
    ] = False,
    lockstep: Annotated[
        bool,
        typer.Option(
            "--lockstep", help="Advance time only while all programs in lockstep wait for it."
        ),
    ] = False,
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.diagnostic_output import report_of, show_report
    from thorvaldc.cli.robot_file import load_robot
    from thorvaldc.cli.virtual_robot import read_store, virtual_robot
    from thorvaldc.diagnostics import DiagnosticError, Report

    options.check_physics(physics)
    number = options.parse_seed(seed)
    loaded = load_robot(file, library, trust)
    if loaded is None:
        return INPUT
    robot = loaded.robot
    gc.enable()
    memory = read_store(store, robot)
    report = Report()
    try:
        simulated = virtual_robot(
            robot,
            file,
            physics,
            faults,
            number,
            report,
            delivered=delivered,
            memory=memory,
            show_fault=_show_injected_fault,
        )
    except DiagnosticError as error:
        return loaded.show(report_of(error))
    sources = {**loaded.sources, **({faults: Path(faults)} if faults else {})}
    show_report(report, sources)
    if report.has_errors:
        return INPUT
    channels = _channels(robot, channel)
    # The robot file may contradict the label of a device whose memory was stored.
    show_start = partial(_show_start, simulated, channels, json, delivered or bool(store))
    _serve(simulated, channels, store, lockstep, show_start)
    return DONE


def _channels(robot: Robot, channel: str) -> dict[str, str]:
    """Returns the channel name of each simulated CAN bus, by the name of the bus.

    If the robot has several CAN buses, each channel name ends with the name of the bus.
    """
    name = channel or robot.name
    if len(robot.buses) == 1:
        return {robot.buses[0].name: name}
    return {bus.name: f"{name}.{bus.name}" for bus in robot.buses}


def _serve(
    simulated: SimulatedRobot,
    channels: Mapping[str, str],
    store: str,
    lockstep: bool,
    show_start: Callable[[], None],
) -> None:
    """Runs the simulated CAN buses until the process receives SIGINT or SIGTERM.

    When the simulation ends, the non-volatile memory of the simulated devices is written to the
    file ``store``.
    """
    from thorvaldc.simulation.bus.bus_server import BusServer
    from thorvaldc.simulation.bus.simulated_robot import write_memory

    server = BusServer(
        simulated.timeline,
        {name: simulated.wires[bus] for bus, name in channels.items()},
        lockstep=lockstep,
    )
    previous_handlers = {
        number: signal.signal(number, lambda *_: server.stop())
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        simulated.power_on()
        show_start()
        server.run()
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)
        if store:
            write_memory(Path(store), simulated)
    _show_end(simulated, server.behind)


def _show_start(
    simulated: SimulatedRobot, channels: Mapping[str, str], json: bool, shows_labels: bool
) -> None:
    from thorvaldc.cli.diagnostic_output import message, print_json

    buses = {bus.name: bus for bus in simulated.robot.buses}
    if json:
        values = [
            {
                "bus": name,
                "channel": channel,
                "interface": "thorvaldc_sim",
                "bitrate": buses[name].bitrate,
                "devices": [node.name for node in buses[name].nodes],
                "labels": _labels(simulated, buses[name]),
            }
            for name, channel in channels.items()
        ]
        print_json(values, one_line=True)
        return
    for name, channel in channels.items():
        bus = buses[name]
        print(
            f"{name}: {len(bus.nodes)} devices at {bus.bitrate // 1000} kbit/s; "
            f'can.Bus(interface="thorvaldc_sim", channel="{channel}")',
            flush=True,
        )
        for device, label in _labels(simulated, bus).items() if shows_labels else ():
            serial = f"serial {label['serial']}" if "serial" in label else "no serial number"
            motors = ", ".join(label["motors"].values())
            print(f"label of {device}: {serial}, wired to {motors}", flush=True)
    if sys.stderr.isatty():
        message("Ctrl-C ends it.")


def _labels(simulated: SimulatedRobot, bus: Bus) -> dict[str, dict[str, Any]]:
    """Returns the serial number and the motors of each controller on a bus."""
    from thorvaldc.simulation.bus.simulated_device import MOTORS, SERIAL

    memory = simulated.memory()
    return {
        node.name: {
            key: memory[node.name][key] for key in (SERIAL, MOTORS) if key in memory[node.name]
        }
        for node in bus.nodes
        if MOTORS in memory[node.name]
    }


def _show_injected_fault(time: float, fault: BusFault, begins: bool) -> None:
    from thorvaldc.cli.virtual_robot import describe_injected_fault

    description = describe_injected_fault(fault, begins)
    print(f"{time:.3f} s: {description}", file=sys.stderr, flush=True)


def _show_end(simulated: SimulatedRobot, behind: int) -> None:
    from thorvaldc.cli.diagnostic_output import message

    seconds = simulated.timeline.seconds
    for name, wire in simulated.wires.items():
        load = wire.busy / max(simulated.timeline.now, 1)
        message(
            f"{name}: {wire.frames} frames in {seconds:.1f} s, load {100 * load:.1f} %, "
            f"{wire.errors} error frames"
        )
    if behind > REPORTED_DELAY:
        message(
            f"the simulation fell behind the clock by up to {behind / 1e9:.2f} s: "
            "times on the bus were longer than on a real bus"
        )
