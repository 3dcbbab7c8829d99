"""``run``: the base driver on a robot's bus."""

from __future__ import annotations

import gc
import json as json_format
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from thorvaldc.cli.compiling import compile_one
from thorvaldc.cli.exits import DONE, INPUT, OutsideError
from thorvaldc.cli.faults import Faults, finite, message
from thorvaldc.cli.options import seconds_of

if TYPE_CHECKING:
    from thorvaldc.can.interface import CanInterface
    from thorvaldc.diagnostics import Diagnostic, Report
    from thorvaldc.model import Robot
    from thorvaldc.runtime.base_interface import BaseHandle
    from thorvaldc.runtime.driver import BaseDriver, DriverState
    from thorvaldc.runtime.runner import BaseRunner
    from thorvaldc.runtime.se2 import Twist
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

VIRTUAL = "virtual"
SIMULATED = ("virtual", "sim", "udp")
STATUS_PERIOD = 0.2
UNTRIED = (
    "thorvaldc's driver was never tried on physical hardware. Lift the wheels off the ground first,"
    " keep the emergency stop in reach, and do not rely on any stop in software."
)


def run(
    file: str,
    bus: str,
    duration: str,
    twist: str,
    parameters: str,
    physics: str,
    faults: str,
    seed: str,
    fast: bool,
    name: str,
    json: bool,
    library: Sequence[str],
) -> int:
    """Until its time is over, a fault ends it, or it is interrupted or terminated."""
    seconds = seconds_of(duration, "--duration") if duration else math.inf
    virtual = bus == VIRTUAL
    if physics not in ("ideal", "mujoco"):
        raise typer.BadParameter(
            f"{physics!r} is neither ideal nor mujoco", param_hint="'--physics'"
        )
    if not virtual:
        for option, given in {
            "--faults": faults,
            "--seed": seed,
            "--fast": fast,
            "--physics": physics != "ideal",
        }.items():
            if given:
                raise typer.BadParameter(
                    "is for a simulated robot, --bus virtual", param_hint=f"'{option}'"
                )
    if fast and not duration:
        raise typer.BadParameter("needs a --duration", param_hint="'--fast'")
    if fast and name:
        raise typer.BadParameter(
            "time that runs fast is nobody's to drive in", param_hint="'--name'"
        )
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.error import DiagnosticError

    found = load_robot(file, library)
    if found is None:
        return INPUT
    robot, sources, located = found
    report = Report()
    try:
        asked = _parse(twist)
        simulated, ports = ports_of(robot, file, bus, physics, faults, seed, report)
        # Who runs a robot for others to drive wants the channel; a run of its own has one if named.
        channel = name or ("" if twist or duration else robot.name)
        session = Session(robot, ports, simulated, parameters, asked, seconds, fast, channel)
    except DiagnosticError as fault:
        report.put(fault.diagnostic)
        return _tell(located(report), sources)
    if report.has_errors:
        return _tell(located(report), sources)
    if bus.partition(":")[0] not in SIMULATED:
        say_untried()
    _tell(located(report), sources)
    ended = session.play(not json)
    if json:
        print(json_format.dumps(finite(session.summary()), indent=1, ensure_ascii=False))
    else:
        print(session.line())
    final = Report()
    if ended is not None:
        final.put(ended)
    return _tell(located(final), sources)


class Session:
    """A run from start to end: the loop, its signals, what is shown of it."""

    def __init__(
        self,
        robot: Robot,
        ports: Mapping[str, CanInterface],
        simulated: SimulatedRobot | None,
        parameters: str,
        twist: Twist | None,
        seconds: float,
        fast: bool,
        channel: str = "",
    ) -> None:
        """Raises ``DiagnosticError``, and ``OutsideError`` where the control channel is in use.

        The ports are closed then.
        """
        from thorvaldc.diagnostics.error import DiagnosticError
        from thorvaldc.runtime.can_base.can_base import CanBase
        from thorvaldc.runtime.control.runner_services import RunnerControl
        from thorvaldc.runtime.runner import BaseRunner

        self.robot = robot
        self.simulated = simulated
        self.twist = twist
        self.seconds = seconds
        self.alone = twist is not None or seconds < math.inf
        self.stop = False
        clock = ports[robot.buses[0].name]
        try:
            base = CanBase(robot, ports, threaded=simulated is None)
            self.runner: BaseRunner = BaseRunner(robot, base, clock, parameters=parameters or None)
            self.control = RunnerControl(self.runner, channel)
        except (DiagnosticError, OSError) as fault:
            for port in ports.values():
                port.close()
            if isinstance(fault, OSError):
                raise OutsideError(f"{fault}; --name gives this one another name") from None
            raise
        self.runner.feed = self._feed
        self.started = clock.now
        self.ready_at = math.nan
        if simulated is not None and not fast:
            begun = time.monotonic() - clock.now
            self.runner.pace = lambda at: time.sleep(max(begun + at - time.monotonic(), 0.0))
        self._shown_at = -math.inf
        self._status = False

    def play(self, shows: bool) -> Diagnostic | None:
        """Run it; returns what ended it before its time, if anything did."""
        before = {
            number: signal.signal(number, self._ask_to_stop)
            for number in (signal.SIGINT, signal.SIGTERM)
        }
        # A pause of the collector would be a pause of the robot: what is there now stays.
        gc.collect()
        gc.freeze()
        gc.enable()
        try:
            self.runner.run(watch=self._watch if shows else None, stop=self._over)
            ended = self._verdict()
            self.runner.shutdown()
        except BaseException:
            # Nothing is sent any more: the drives stop by themselves.
            self.runner.base.close()
            raise
        finally:
            self.control.close()
            for number, handler in before.items():
                signal.signal(number, handler)
            self._clear()
        return ended

    def _ask_to_stop(self, *_: Any) -> None:
        self.stop = True

    def _feed(self, driver: BaseDriver, now: float) -> None:
        """Who drives by the control channel; where nobody does, the command line's twist."""
        selected = self.control.feed(driver, now)
        free = not selected.source and not selected.locks
        # As soon as the robot stands ready.
        if self.twist is not None and free and self.runner.ready and self.runner.base.armed:
            driver.command(self.twist, now)

    def _over(self) -> bool:
        from thorvaldc.runtime.can_base.base_state_machine import State

        runner, now = self.runner, self.runner.clock.now
        if runner.ready and math.isnan(self.ready_at):
            self.ready_at = now
        if self.stop:
            return True
        if runner.state in (State.FAULT, State.ESTOP):
            lost = any(c.receiver.lost for c in runner.base.connections)
            return self.alone or lost or not runner.base.supervisor.was_ready
        return now - self.ready_at >= self.seconds - 1e-9

    def _verdict(self) -> Diagnostic | None:
        """Why it ended, where that is a fault."""
        from thorvaldc.diagnostics import CODES, Diagnostic
        from thorvaldc.runtime.can_base.base_state_machine import State

        supervisor = self.runner.base.supervisor
        if supervisor.state not in (State.FAULT, State.ESTOP):
            return None
        code, hint = "bus-stopped", None
        if supervisor.mismatch:
            code = "bus-mismatch"
            hint = "is it this robot's file? `thorvaldc can plan` shows what differs"
        elif not supervisor.was_ready:
            code = "bus-start"
        return Diagnostic(CODES[code], supervisor.reason, self.robot.span, hint)

    # -- what is shown -------------------------------------------------------------------------

    def _watch(self, runner: BaseRunner, state: DriverState) -> None:
        changes = runner.changes
        if changes:
            self._clear()
            for change in changes:
                why = f": {change.reason}" if change.reason else ""
                message(f"{change.time - self.started:8.2f} s  {change.state.value}{why}")
            changes.clear()
        now = time.monotonic()
        if sys.stderr.isatty() and now - self._shown_at >= STATUS_PERIOD:
            self._shown_at = now
            self._show(f"{runner.clock.now - self.started:8.1f} s  {self.line()}")

    def _show(self, text: str) -> None:
        width = max(os.get_terminal_size(sys.stderr.fileno()).columns - 1, 20)
        sys.stderr.write("\r" + text[:width] + "\x1b[K")  # and nothing behind it
        sys.stderr.flush()
        self._status = True

    def _clear(self) -> None:
        if self._status:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()
            self._status = False

    def line(self) -> str:
        """State, speed, pose and how the loop does, in a line."""
        runner = self.runner
        state = runner.driver.state
        twist, pose = state.odometry.twist, state.pose
        timing = runner.timing
        parts = [
            f"{runner.state.value:8}",
            f"{twist.vx:+.2f} {twist.vy:+.2f} m/s {twist.wz:+.2f} rad/s",
            f"at {pose.x:.2f} {pose.y:.2f} m {math.degrees(pose.yaw):.0f} deg",
        ]
        charges = [b.charge for b in runner.batteries().values() if not math.isnan(b.charge)]
        if charges:
            parts.append(f"battery {100.0 * min(charges):.0f} %")
        if timing.overruns:
            parts.append(f"{timing.overruns} overruns")
        drops = sum(runner.relay_drops().values())
        if drops:
            parts.append(f"{drops} frames not relayed")
        return "  ".join(parts)

    def summary(self) -> dict[str, Any]:
        """Of the run, for tools: SI, poses relative to where the robot became ready."""
        runner = self.runner
        supervisor, timing = runner.base.supervisor, runner.timing
        pose = runner.driver.state.pose
        found: dict[str, Any] = {
            "robot": self.robot.name,
            "state": runner.state.value,
            "reason": supervisor.reason,
            "was_ready": supervisor.was_ready,
            "seconds": runner.clock.now - self.started,
            "pose": {"x": pose.x, "y": pose.y, "yaw": pose.yaw},
            "timing": {
                "cycles": timing.cycles,
                "overruns": timing.overruns,
                "skipped": timing.skipped,
                "latest": timing.latest,
                "longest": timing.longest,
            },
            "buses": {
                connection.bus.name: {
                    "received": connection.receiver.received,
                    "dropped": connection.receiver.dropped,
                    "malformed": connection.malformed,
                    "not_sent": connection.not_sent,
                }
                for connection in runner.base.connections
            },
            "changes": [
                {"time": c.time - self.started, "state": c.state.value, "reason": c.reason}
                for c in runner.changes
            ],
            "batteries": {
                name: {"voltage": b.voltage, "current": b.current, "charge": b.charge}
                for name, b in runner.batteries().items()
            },
            "warnings": runner.warnings(),
            "not_relayed": runner.relay_drops(),
        }
        return found


def say_untried() -> None:
    """Once for a user, before anything is done with hardware."""
    folder = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    mark = folder / "thorvaldc" / "untried-told"
    if mark.exists():
        return
    message(f"note: {UNTRIED}")
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.write_text("The note on untried hardware was shown.\n", encoding="utf-8")
    except OSError:
        return  # then it is said again the next time


# -- what it starts from ----------------------------------------------------------------------


def load_robot(
    file: str, library: Sequence[str]
) -> tuple[Robot, Mapping[str, Path], Callable[[Report], Report]] | None:
    """The robot of a robot.yaml or of a build's model.json; what is wrong has been said."""
    from thorvaldc.model import Robot

    if file.endswith(".json"):
        from thorvaldc.diagnostics import Report
        from thorvaldc.diagnostics.error import DiagnosticError
        from thorvaldc.model.model_file import load_model

        path = Path(file)
        try:
            model = load_model(path.parent) if path.name == "model.json" else None
        except DiagnosticError as fault:
            report = Report()
            report.put(fault.diagnostic)
            _tell(report, {})
            return None
        if model is None:
            raise typer.BadParameter(f"{file} is no build's model.json", param_hint="FILE")
        sources: Mapping[str, Path] = {}
        located: Callable[[Report], Report] = _as_it_is
    else:
        done = compile_one(file, library)
        model, sources, located = done.model, done.sources, done.located
    if model is None:
        return None
    if not isinstance(model, Robot):
        raise typer.BadParameter(f"{file} is no robot", param_hint="FILE")
    return model, sources, located


def _as_it_is(report: Report) -> Report:
    return report


def _parse(twist: str) -> Twist | None:
    from thorvaldc.runtime.twist_text import parse_twist

    return parse_twist(twist) if twist else None


def ports_of(
    robot: Robot, file: str, bus: str, physics: str, faults: str, seed: str, report: Report
) -> tuple[SimulatedRobot | None, Mapping[str, CanInterface]]:
    """The ports of the robot's buses; simulated ones with their robot.

    Raises ``DiagnosticError``.
    """
    if bus != VIRTUAL:
        from thorvaldc.can.open_interface import open_interfaces

        return None, open_interfaces(bus, robot)
    from thorvaldc.compiler.injected_fault_file import read_faults
    from thorvaldc.simulation.bus import fault_injection as bus_faults
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

    script = read_faults(faults, robot, report) if faults else None
    number = _number(seed) if seed else script.seed if script is not None else 0
    base = mujoco_base(robot, file, report) if physics == "mujoco" else None
    simulated = SimulatedRobot(robot, seed=number, base=base)
    if script is not None:
        bus_faults.FaultInjector(simulated, script, _say_fault)
    simulated.power_on()
    return simulated, {b.name: simulated.interface(b.name, fifo=True) for b in robot.buses}


def mujoco_base(robot: Robot, file: str, report: Report) -> BaseHandle:
    """The robot in MuJoCo, from its file or the build beside its model."""
    from thorvaldc.compiler.pipeline import emit
    from thorvaldc.simulation.physics.mujoco_base import MujocoBase, MujocoScene

    # A build's model has no meshes in it: they lie beside it.
    files = Path(file).parent if file.endswith(".json") else emit(robot, ["mjcf"], report)
    return MujocoBase(robot, MujocoScene(files))


def _say_fault(time: float, fault: Any, begins: bool) -> None:
    what = fault.kind.replace("_", " ")
    of = f" of {fault.node}" if fault.node is not None else ""
    message(f"{time:8.2f} s  simulated: {what}{of}{'' if begins else ' ends'}")


def _number(text: str) -> int:
    try:
        return int(text, 0)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is no whole number", param_hint="'--seed'") from None


def _tell(report: Report, sources: Mapping[str, Path]) -> int:
    shown = Faults("text", sys.stderr)
    shown.add(report, sources)
    return shown.finish() if len(report) else DONE
