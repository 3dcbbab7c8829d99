"""The commands ``thorvaldc run``, which runs the base driver on the CAN buses of a robot, and
``bus``, which simulates the CAN buses for other programs."""

from __future__ import annotations

import contextlib
import gc
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import message, print_json, report_of, show_report
from thorvaldc.cli.exits import DONE, INPUT, OutsideError, check_full_installation
from thorvaldc.cli.options import bus_interfaces
from thorvaldc.cli.robot_file import (
    LoadedRobot,
    is_hardware,
    load_robot,
    path_beside,
    read_store,
    start_virtual_robot,
    virtual_robot,
    warn_once,
)
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.runtime.state_text import page_text

if TYPE_CHECKING:
    from thorvaldc.can.frame import CanInterface
    from thorvaldc.commissioning.commission_report import CommissionReport
    from thorvaldc.model import Bus, Robot
    from thorvaldc.runtime.driven_robot import DrivenRobot
    from thorvaldc.runtime.driver import DriverState
    from thorvaldc.runtime.run_session import RunSession
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot


Commissioned = Annotated[
    bool,
    typer.Option(
        "--commissioned",
        help="Refuse a robot whose report of `can commission` is missing, old, not passed, or of"
        " other controllers.",
    ),
]

ChannelName = Annotated[
    str,
    typer.Option(
        "--name",
        metavar="NAME",
        help="Name of the control channel, for `teleop --to` and `call`.",
        show_default="the robot's; none with --twist or --duration",
    ),
]
StatusPort = Annotated[
    str,
    typer.Option(
        "--status-port",
        metavar="PORT",
        help="Serve a page with the state and a stop button on this computer; 0: any port.",
    ),
]


def run(
    file: options.RobotFile,
    bus: Annotated[
        str,
        typer.Option(
            "--bus",
            metavar="BUS",
            autocompletion=bus_interfaces,
            help="virtual, sim:NAME, slcan:PORT, socketcan:can0, udp, or INTERFACE:CHANNEL of"
            " python-can.",
        ),
    ],
    duration: Annotated[
        str,
        typer.Option(
            "--duration", metavar="TIME", help="Duration of the run once the robot is ready: 20 s."
        ),
    ] = "",
    twist: Annotated[
        str,
        typer.Option("--twist", metavar="VX,VY,WZ", help="Twist to drive, in m/s, m/s and rad/s."),
    ] = "",
    parameters: options.Parameters = "",
    physics: options.Physics = "ideal",
    faults: options.InjectedFaults = "",
    seed: options.Seed = "",
    fast: Annotated[
        bool, typer.Option("--fast", help="Simulate a virtual robot faster than real time.")
    ] = False,
    name: ChannelName = "",
    status_port: StatusPort = "",
    commissioned: Commissioned = False,
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.can.open_interface import lock_buses, open_interfaces
    from thorvaldc.runtime.loopback import HOST, listen
    from thorvaldc.runtime.run_session import RunSession
    from thorvaldc.runtime.se2 import parse_twist
    from thorvaldc.runtime.status_page import status_page

    seconds = options.parse_duration(duration, "--duration") if duration else math.inf
    commanded_twist = options.parsed(twist, parse_twist, "--twist") if twist else None
    options.check_physics(physics)
    virtual = bus == "virtual"
    if not virtual:
        _refuse_simulation(faults, seed, physics, fast)
    if fast and not duration:
        raise typer.BadParameter("needs a --duration", param_hint="'--fast'")
    if fast:
        options.refuse_options({"--name": name}, "a run with --fast has no control channel")
    port = options.parse_port(status_port, "--status-port") if status_port else None
    if port is not None and (twist or duration) and not name:
        raise typer.BadParameter(
            "needs a control channel; --name selects one", param_hint="'--status-port'"
        )
    loaded = load_robot(file, library, trust)
    # Without a twist and a duration, other programs drive the robot through the control channel.
    channel = name or ("" if twist or duration else loaded.robot.name)
    with contextlib.ExitStack() as locks:
        listener = None
        if port is not None:
            listener = locks.enter_context(listen(port, "--status-port"))
        report = Report()
        try:
            checked = _read_report(file, loaded.robot) if commissioned else None
            if not virtual:
                lock_buses(bus, loaded.robot, locks)
            interfaces = (
                _virtual_interfaces(
                    loaded.robot, file, physics, faults, options.parse_seed(seed), report
                )
                if virtual
                else open_interfaces(bus, loaded.robot)
            )
            session = RunSession(
                _identified(loaded.robot, checked, interfaces),
                interfaces,
                parameters=parameters or None,
                twist=commanded_twist,
                duration=seconds,
                channel=channel,
                threaded=not virtual,
                paced=virtual and not fast,
            )
        except DiagnosticError as error:
            report.put(error.diagnostic)
            return loaded.show(report)
        except OSError as error:  # the control channel is in use
            raise OutsideError(f"{error}; --name selects another name") from None
        if report.has_errors:
            return loaded.show(report)
        if is_hardware(bus):
            warn_once()
        loaded.show(report)
        if listener is not None:
            message(f"status page: http://{HOST}:{listener.getsockname()[1]}/")
            locks.enter_context(status_page(listener, channel))
        return _drive(session, loaded, json)


def _read_report(file: str, robot: Robot) -> tuple[Path, CommissionReport]:
    from thorvaldc.commissioning.commission_report import SUFFIX, read_report

    path = path_beside(file, robot, SUFFIX)
    return path, read_report(path)


def _identified(
    robot: Robot,
    checked: tuple[Path, CommissionReport] | None,
    interfaces: Mapping[str, CanInterface],
) -> Robot:
    """Compares a report with the robot and with the devices on its buses, before anything can move.

    Returns the robot with the serial numbers of the devices, or as it is if no report is demanded.
    """
    from thorvaldc.commissioning.commission_report import identity_note, require_commissioned
    from thorvaldc.commissioning.scanner import scan_robot, with_serial_numbers

    if checked is None:
        return robot
    try:
        devices = scan_robot(robot, interfaces)
        require_commissioned(*checked, robot, devices)
    except DiagnosticError:
        for interface in interfaces.values():
            interface.close()
        raise
    if note := identity_note(robot, devices):
        message(f"note: {note}")
    return with_serial_numbers(robot, devices)


def _refuse_simulation(faults: str, seed: str, physics: str, fast: bool) -> None:
    simulated = {"--faults": faults, "--seed": seed, "--fast": fast}
    simulated["--physics"] = physics != "ideal"
    options.refuse_options(simulated, "is for a simulated robot, --bus virtual")


def _drive(session: RunSession, loaded: LoadedRobot, json: bool) -> int:
    """Runs the base driver, prints its state and returns the exit status."""
    with StatusView(session) as view:
        diagnostic = session.run(None if json else view.watch)
    if json:
        print_json(session.summary())
    else:
        print(session.status_line())
    report = Report()
    if diagnostic is not None:
        report.put(diagnostic)
    return loaded.show(report)


def _virtual_interfaces(
    robot: Robot, file: str, physics: str, faults: str, seed: int | None, report: Report
) -> Mapping[str, CanInterface]:
    check_full_installation("`--bus virtual`")
    simulated = start_virtual_robot(robot, file, physics, faults, seed, report)
    return {bus.name: simulated.interface(bus.name, fifo=True) for bus in robot.buses}


STATUS_PERIOD = 0.2
"""Time in s between two updates of the status line."""


class StatusView:
    """Prints each new state of the base driver and, on a terminal, a status line."""

    def __init__(self, session: RunSession) -> None:
        self._session = session
        self._last_time = -math.inf
        self._line_shown = False
        self._versions_shown = 0
        self._waits_for = ""
        self._end_shown = False

    def __enter__(self) -> StatusView:
        return self

    def __exit__(self, *error: object) -> None:
        self._erase_line()

    def watch(self, driven: DrivenRobot, state: DriverState) -> None:
        """Prints new state changes of the base driver and updates the status line.

        The method ``watch`` must be called after each control cycle of the base driver.
        """
        session = self._session
        changes = session.base.changes
        if changes:
            self._erase_line()
            for change in filter(session.is_news, changes):
                reason = f": {change.reason}" if change.reason else ""
                if change.reason and (code := session.base.fault_code) is not None:
                    reason += f" ({page_text(code)})"
                elapsed = change.time - session.start_time
                message(f"{elapsed:8.2f} s  {change.state.value}{reason}")
            changes.clear()
        if session.waits_for != self._waits_for:
            self._waits_for = session.waits_for
            if self._waits_for:
                self._erase_line()
                message(f"{session.elapsed:8.2f} s  waits, disarmed, until all controllers answer")
        if session.twist_ended and not self._end_shown:
            self._erase_line()
            message(f"{session.elapsed:8.2f} s  the twist has ended: {session.twist_ended}")
            self._end_shown = True
        for text in list(driven.other_versions.values())[self._versions_shown :]:
            self._erase_line()
            message(f"warning: {text}")
            self._versions_shown += 1
        now = time.monotonic()
        if sys.stderr.isatty() and now - self._last_time >= STATUS_PERIOD:
            self._last_time = now
            self._show_line(f"{session.elapsed:6.1f} s  {session.status_line()}")

    def _show_line(self, text: str) -> None:
        width = max(os.get_terminal_size(sys.stderr.fileno()).columns - 1, 20)
        sys.stderr.write("\r" + text[:width] + "\x1b[K")
        sys.stderr.flush()
        self._line_shown = True

    def _erase_line(self) -> None:
        if self._line_shown:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()
            self._line_shown = False


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
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    options.check_physics(physics)
    number = options.parse_seed(seed)
    loaded = load_robot(file, library, trust)
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
    _serve(simulated, channels, store, show_start)
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
    show_start: Callable[[], None],
) -> None:
    """Runs the simulated CAN buses until the process receives SIGINT or SIGTERM.

    When the simulation ends, the non-volatile memory of the simulated devices is written to the
    file ``store``.
    """
    from thorvaldc.simulation.bus.bus_server import BusServer
    from thorvaldc.simulation.bus.simulated_robot import write_memory

    server = BusServer(
        simulated.timeline, {name: simulated.wires[bus] for bus, name in channels.items()}
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


def _show_end(simulated: SimulatedRobot, behind: int) -> None:
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
