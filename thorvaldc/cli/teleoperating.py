"""``teleop`` and ``call``: a robot driven by hand, and the services of a running driver."""

from __future__ import annotations

import contextlib
import gc
import json as json_format
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import typer

from thorvaldc.cli.exits import DONE, INPUT, OutsideError
from thorvaldc.cli.faults import Faults, finite, message

if TYPE_CHECKING:
    from thorvaldc.model import Robot
    from thorvaldc.tools.teleoperation.joystick import Search
    from thorvaldc.tools.teleoperation.vehicle import Vehicle

SIMULATIONS = ("sim", "ideal")


def teleoperate(
    file: str,
    on: str,
    to: str,
    name: str,
    source: str,
    speed: str,
    joystick: str,
    mapping: str,
    library: Sequence[str],
) -> int:
    """Until the operator quits, or the process is interrupted, terminated or hung up."""
    if bool(file) == bool(to):
        raise typer.BadParameter("name a robot's FILE, or a driver that is run by --to NAME")
    share = _share(speed)
    if mapping and not joystick:
        raise typer.BadParameter("is for a --joystick", param_hint="'--map'")
    search = _search(joystick, mapping) if joystick else None
    if search is None and not sys.stdin.isatty():
        raise OutsideError("the keyboard needs a terminal, and standard input is none")
    gc.enable()
    with _ending() as ended:
        try:
            vehicle = _remote(to) if to else _local(file, on, name, library)
        except _NotCompiled:
            return INPUT
        try:
            _check_source(source, vehicle.description)
            _drive(vehicle, source, share, search, ended)
        except ConnectionError as fault:
            raise OutsideError(str(fault)) from None
        finally:
            vehicle.close()
    return DONE


class _NotCompiled(Exception):
    """The faults have been told."""


def _local(file: str, on: str, name: str, library: Sequence[str]) -> Vehicle:
    from thorvaldc.cli.running import load_robot
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.error import DiagnosticError

    found = load_robot(file, library)
    if found is None:
        raise _NotCompiled
    robot, sources, located = found
    report = Report()
    try:
        if on in SIMULATIONS:
            return _simulated(robot, file, on, name or robot.name)
        return _on_bus(robot, file, on, name or robot.name)
    except DiagnosticError as fault:
        report.put(fault.diagnostic)
        faults = Faults("text", sys.stderr)
        faults.add(located(report), sources)
        raise typer.Exit(faults.finish()) from None


def _simulated(robot: Robot, file: str, on: str, name: str) -> Vehicle:
    from thorvaldc.cli.running import mujoco_base
    from thorvaldc.diagnostics import Report
    from thorvaldc.runtime.driver import BaseDriver
    from thorvaldc.simulation.physics.sim_base import SimBase
    from thorvaldc.tools.teleoperation.vehicle import SimulatedVehicle

    base = mujoco_base(robot, file, Report()) if on == "sim" else SimBase(robot)
    try:
        return SimulatedVehicle(BaseDriver(robot, base), name)
    except OSError as fault:
        raise OutsideError(f"{fault}; --name gives this one another name") from None


def _on_bus(robot: Robot, file: str, on: str, name: str) -> Vehicle:
    import math

    from thorvaldc.cli.running import SIMULATED, Session, ports_of, say_untried
    from thorvaldc.diagnostics import Report
    from thorvaldc.tools.teleoperation.bus_vehicle import RunningVehicle

    if on != "virtual" and on != "udp" and ":" not in on:
        raise typer.BadParameter(
            f"{on!r} is none of sim, ideal, virtual, sim:NAME, slcan:PORT, socketcan:can0, udp",
            param_hint="'--on'",
        )
    simulated, ports = ports_of(robot, file, on, "ideal", "", "", Report())
    session = Session(robot, ports, simulated, "", None, math.inf, False, name)
    if on.partition(":")[0] not in SIMULATED:
        say_untried()
    return RunningVehicle(session.runner, session.control)


def _remote(name: str) -> Vehicle:
    from thorvaldc.runtime.control.control_client import ControlClient
    from thorvaldc.tools.teleoperation.vehicle import RemoteVehicle

    return RemoteVehicle(ControlClient(name))


def _drive(
    vehicle: Vehicle, source: str, share: float, search: Search | None, ended: Callable[[], bool]
) -> None:
    from thorvaldc.tools.teleoperation.joystick import HELP as STICKS
    from thorvaldc.tools.teleoperation.joystick import Joystick, Together
    from thorvaldc.tools.teleoperation.keyboard import HELP, Keyboard
    from thorvaldc.tools.teleoperation.operator import Limits, Operator
    from thorvaldc.tools.teleoperation.teleop_loop import operate
    from thorvaldc.tools.teleoperation.terminal import Terminal

    described = vehicle.description
    limits = Limits.of(described)
    keys = sys.stdin if sys.stdin.isatty() else None
    print(f"{described['robot']}, as {source}")
    print(
        *([HELP] * (keys is not None) + [STICKS] * (search is not None)), "", sep="\n", flush=True
    )
    # A pause of the collector would be a pause of the robot: what is there now stays.
    gc.collect()
    gc.freeze()
    with Terminal(keys, sys.stdout) as terminal:
        operator: Operator = Keyboard(limits, terminal.read, share, described["parameter_sets"])
        if search is not None:
            operator = Together(operator, Joystick(limits, search, share))
        try:
            operate(vehicle, operator, source, terminal.show, ended)
        finally:
            operator.close()


def _search(joystick: str, mapping: str) -> Search:
    """How to look for the joystick, which is there now."""
    from thorvaldc.runtime.errors import ParameterError
    from thorvaldc.tools.teleoperation.joystick import evdev_search

    try:
        search = evdev_search("" if joystick == "auto" else joystick, mapping)
    except ImportError:
        raise OutsideError(
            "a joystick needs the package evdev (Linux): pip install 'thorvaldc[joystick]'"
        ) from None
    except ParameterError as fault:
        raise typer.BadParameter(str(fault), param_hint="'--map'") from None
    found = search()
    if found is None:
        where = "under /dev/input" if joystick == "auto" else f"at {joystick}"
        raise OutsideError(
            f"no joystick is found {where}; is it plugged in, and may you read it (group `input`)?"
        )
    found[0].close()
    return search


def _check_source(source: str, description: dict[str, Any]) -> None:
    known = description["sources"]
    if source not in known:
        raise typer.BadParameter(
            f"the robot has no source {source!r}; it has {', '.join(known)}",
            param_hint="'--source'",
        )


def _share(text: str) -> float:
    from thorvaldc.tools.teleoperation.operator import SMALLEST_SHARE

    try:
        number = float(text.rstrip("% ")) / 100
    except ValueError:
        number = 0.0
    if not SMALLEST_SHARE <= number <= 1.0:
        raise typer.BadParameter(
            f"{text!r} is no share of the top speed from {SMALLEST_SHARE * 100:.0f} to 100 %",
            param_hint="'--speed'",
        )
    return number


@contextlib.contextmanager
def _ending() -> Iterator[Callable[[], bool]]:
    """Whether an orderly end was asked for; a second Ctrl-C does not wait for it."""
    asked: list[int] = []
    before = {}

    def handle(number: int, frame: object) -> None:
        if asked and number == signal.SIGINT:
            raise KeyboardInterrupt
        asked.append(number)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        before[number] = signal.signal(number, handle)
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# -- call ---------------------------------------------------------------------------------------


def call_service(name: str, service: str, given: Sequence[str], json: bool) -> int:
    """One call of a running driver; without a service, a list of those there are."""
    from thorvaldc.runtime.control.control_client import ControlClient
    from thorvaldc.runtime.control.service_table import ServiceError

    arguments = dict(_argument(text) for text in given)
    client = ControlClient(name)
    try:
        found = client.call(service or "services", **arguments)
    except ServiceError as fault:
        message(f"error: {fault}")
        return INPUT
    except ConnectionError as fault:
        raise OutsideError(str(fault)) from None
    finally:
        client.close()
    if json:
        print(json_format.dumps(finite(found), indent=1, ensure_ascii=False))
    elif service:
        _show(found)
    else:
        _show_services(found)
    return DONE


def _argument(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise typer.BadParameter(f"{text!r} is not NAME=VALUE", param_hint="ARGUMENTS")
    try:
        return name, json_format.loads(value)
    except ValueError:
        return name, value


def _show(found: Any, indent: str = "") -> None:
    if not isinstance(found, dict):
        if found is not None:
            print(f"{indent}{_text(found)}")
        return
    for key, value in found.items():
        if isinstance(value, dict) and any(isinstance(v, dict) for v in value.values()):
            print(f"{indent}{key}:")
            _show(value, indent + "  ")
        elif isinstance(value, dict) and value:
            listed = "  ".join(f"{k} {_text(v)}" for k, v in value.items())
            print(f"{indent}{key}: {listed}")
        else:
            print(f"{indent}{key}: {_text(value)}")


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value + 0.0:.4g}"
    if isinstance(value, list):
        return ", ".join(_text(entry) for entry in value) or "-"
    return str(value) if value not in ("", None, {}) else "-"


def _show_services(found: list[dict[str, Any]]) -> None:
    for service in found:
        arguments = " ".join(
            f"{a['name']}=..." if a["required"] else f"[{a['name']}=...]"
            for a in service["arguments"]
        )
        print(f"{service['name']} {arguments}".rstrip())
        print(f"    {service['summary']}")
