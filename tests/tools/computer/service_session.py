"""Installs a robot on a computer with systemd, and ends its base driver in several ways.

Runs in the container of ``test_running_service.py``.
"""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from tests.cli.conftest import GOOD
from tests.container import record_session
from tests.simulation.bus.robots import CIA402
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Robot
from thorvaldc.runtime.control_channel import ControlClient, ServiceError
from thorvaldc.simulation.bus.bus_server import serving
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

PROGRAM, ASKING = (f"/opt/thorvaldc-env/bin/{name}" for name in ("thorvaldc", "asking"))
UNIT = "thorvaldc-good.service"
FILE = Path("/etc/thorvaldc/good/current/robot/good.yaml")
BUS = "/run/can.sock"
PAGE = "http://127.0.0.1:8321/state"
ROBOT = f"{GOOD}computer: {{status_port: 8321, power_off: 3 %}}\n"
WATCH, INSTEAD = "thorvaldc-good.path", "instead-of-poweroff.service"
SPEED = 0.5
"""Commanded speed (m/s)."""
PATIENCE = 60.0
"""Longest time (s) for what a computer under load may do slowly."""


class Wheels:
    """The speed of the fastest simulated motor, measured every 10 ms of simulated time.

    While ``frozen``, the devices report their last speeds and positions.
    """

    def __init__(self, simulated: SimulatedRobot) -> None:
        self._simulated = simulated
        self.speed = 0.0
        self.moved = self.frozen = False
        self._measure()

    def _measure(self) -> None:
        now = self._simulated.timeline.seconds
        motors = self._simulated.motors.values()
        self.speed = max(abs(motor.read(now).velocity) for motor in motors)
        self.moved = self.moved or self.speed > 1e-6
        for device in self._simulated.devices.values():
            if isinstance(device, CanopenDevice) and device.frozen_reports != self.frozen:
                device.frozen_reports = self.frozen
        self._simulated.timeline.after(10_000_000, self._measure)


def until(what: str, reached: Callable[[], Any]) -> Any:
    """Returns the first true value of a function; its errors mean that it is not reached yet."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            if value := reached():
                return value
        except (OSError, ServiceError):
            pass
        time.sleep(0.02)
    raise AssertionError(f"after {PATIENCE:g} s still not: {what}")


def shown(key: str) -> str:
    command = ["systemctl", "show", UNIT, "--value", f"--property={key}"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def made() -> list[str]:
    """Returns what the installation has made."""
    return [str(path) for path in Path("/etc").rglob("*good*")]


def run(*command: str) -> tuple[int, str]:
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    return ran.returncode, ran.stdout + ran.stderr


def state() -> dict[str, Any]:
    client = ControlClient("/run/thorvaldc/good/control")
    try:
        answer: dict[str, Any] = client.call("state")
        return answer
    finally:
        client.close()


def drive(wheels: Wheels) -> None:
    """Arms the robot and drives it until its wheels turn."""
    client = ControlClient("/run/thorvaldc/good/control")
    try:
        until("arming", lambda: client.call("arm") is not False)
        until("armed", lambda: client.call("state")["armed"])
        client.call("twist", source="teleop_joy", vx=0.0)

        def turn() -> bool:
            client.call("twist", source="teleop_joy", vx=SPEED)
            return wheels.speed > 2.0

        until("wheels that turn", turn)
    finally:
        client.close()


def disarm() -> None:
    client = ControlClient("/run/thorvaldc/good/control")
    try:
        client.call("disarm")
    finally:
        client.close()


def driver() -> int:
    """Waits for a base driver that answers, and returns its process."""
    until("a base driver", state)
    return int(shown("MainPID"))


def ask_for_the_end() -> tuple[int, str]:
    """Makes the file of an empty battery, as the service does; returns whether it was too early.

    Another unit starts in the place of `poweroff.target`, which would end the session.
    """
    folder = Path("/etc/systemd/system")
    service = "[Service]\nType=oneshot\nRemainAfterExit=yes\nExecStart=/bin/true\n"
    (folder / INSTEAD).write_text(service, encoding="utf-8")
    link = folder / WATCH
    installed, text = link.readlink(), link.read_text(encoding="utf-8")
    link.unlink()
    link.write_text(text.replace("poweroff.target", INSTEAD), encoding="utf-8")
    run("systemctl", "daemon-reload")
    run("systemctl", "restart", WATCH)
    before = run("systemctl", "is-active", INSTEAD)
    run("runuser", "-u", "robot", "--", "touch", "/run/thorvaldc/good/power-off")
    until("the end", lambda: run("systemctl", "is-active", INSTEAD)[0] == 0)
    link.unlink()
    link.symlink_to(installed)
    return before


def session(record: dict[str, Any]) -> None:
    os.chdir(Path.home())
    Path("good.yaml").write_text(ROBOT, encoding="utf-8")
    robot = compile_file(Path("good.yaml")).model
    assert isinstance(robot, Robot)
    subprocess.run(["useradd", "--system", "--user-group", "robot"], check=True)
    simulated = SimulatedRobot(robot)
    simulated.power_on()
    wheels = Wheels(simulated)
    with serving(simulated.timeline, {BUS: simulated.wire()}):
        os.chmod(BUS, 0o666)
        # The bus keeps real time beside busy programs, as the unit lets the driver do.
        for thread in threading.enumerate():
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(thread.native_id or 0, policy, os.sched_param(25))
        other = CIA402.replace("with_cia402", "good")
        Path("other.yaml").write_text(other, encoding="utf-8")
        record["other"] = run(ASKING, "install", "other.yaml")
        record["changed"] = made()
        record["same"] = run(ASKING, "install", "good.yaml")
        run(PROGRAM, "uninstall", "good")
        record["install"] = run(PROGRAM, "install", "good.yaml")
        process = driver()
        record["started"] = {**state(), "moved": wheels.moved}
        record["process"] = run("ps", "-o", "user=,cls=,rtprio=", "-p", str(process))
        record["page"] = until("the page", lambda: urlopen(PAGE, timeout=5.0).read().decode())
        record["page_process"] = run("ps", "-o", "user=,cls=", "--ppid", str(process))
        record["status"] = run(PROGRAM, "status")
        record["watch"] = run("systemctl", "show", WATCH, "--property=ActiveState,Triggers")
        record["asked"] = ask_for_the_end()
        run("systemctl", "restart", UNIT)  # which removes the file
        process = driver()
        drive(wheels)
        record["armed"] = run(ASKING, "install", "other.yaml")
        disarm()
        Path("good.yaml").write_text(ROBOT + "# another version\n", encoding="utf-8")
        record["running"] = run(ASKING, "install", "good.yaml")
        driver()
        good = FILE.read_text(encoding="utf-8")
        FILE.write_text(good.replace("modules:", "modulse:", 1), encoding="utf-8")
        record["restart"] = run("systemctl", "restart", UNIT)
        process = driver()  # the last build
        record["errors"] = run("journalctl", "--unit", UNIT, "--output", "cat", "--no-pager")
        FILE.write_text(good, encoding="utf-8")
        record["ends"] = []
        kill, stop = signal.SIGKILL, signal.SIGSTOP
        for how, frozen in ((kill, False), (kill, True), (stop, False), (stop, True), (kill, True)):
            drive(wheels)
            wheels.frozen = frozen
            run("systemctl", "reset-failed", UNIT)  # the limit of starts comes later
            os.kill(process, how)
            killed = time.monotonic()
            until("wheels at rest", lambda: wheels.speed < 1e-6)
            entry: dict[str, Any] = {"how": how.name, "rest": time.monotonic() - killed}
            record["ends"].append(entry)
            wheels.frozen = False
            old = process
            until("another process", lambda old=old: shown("MainPID") not in ("0", str(old)))
            wheels.moved = False
            process = driver()
            entry.update(armed=state()["armed"], moved=wheels.moved)

        def failed() -> bool:
            if (process := int(shown("MainPID"))) != 0:
                os.kill(process, signal.SIGKILL)
            return shown("ActiveState") == "failed"

        until("the end of restarts", failed)
        record["at_last"] = {"result": shown("Result"), "speed": wheels.speed}
        record["failed"] = run(PROGRAM, "status")
        record["uninstall"] = run(PROGRAM, "uninstall", "good")
        record["left"] = made()


if __name__ == "__main__":
    record_session(session, UNIT)
