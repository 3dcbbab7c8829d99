"""What an installed robot does: its service, its base driver, and its files."""

from __future__ import annotations

import contextlib
import hashlib
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from thorvaldc.backends.computer import CONTROL, STATE, robot_file_of, starts_ros
from thorvaldc.cli.robot_file import read_robot_file
from thorvaldc.diagnostics import OutsideError
from thorvaldc.model import Robot
from thorvaldc.model.model_json import model_hash
from thorvaldc.runtime.state_text import state_rows
from thorvaldc.tools.computer.installed_versions import Computer

_PROPERTIES = ("ActiveState", "SubState", "ActiveEnterTimestamp", "NRestarts", "Result")


def robot_status(computer: Computer, name: str, *, is_live: bool) -> dict[str, Any]:
    """Returns the status of an installed robot as JSON values.

    - ``version``: name of the installed version, or empty.
    - ``edited``: files of the version that were edited on the computer.
    - ``differs``: whether the base driver was started with another robot than the robot file
      describes now, or ``None`` if there is no build or the file has errors.
    - ``errors``: errors of the robot file.
    - ``service``: properties of the unit as systemd names them, or empty if systemd does not
      answer.
    - ``ros``: whether the service starts ROS 2, where the base driver has no control channel.
    - ``driver``: result of the service `state` of the base driver, or ``None``.
    - ``driver_error``: why the base driver does not answer.
    - ``clock``: ``synchronised`` of the clock of this computer, or ``None`` if nobody knows it;
      empty of another file system.
    """
    current = computer.current(name)
    status: dict[str, Any] = {
        "name": name,
        "version": current.name if current is not None else "",
        "edited": computer.edited(current) if current is not None else [],
        "differs": None,
        "errors": [],
        "service": {},
        "ros": False,
        "driver": None,
        "driver_error": "",
        "clock": {"synchronised": _clock_is_synchronised()} if is_live else {},
    }
    for unit, text in computer.units(name).items():
        if is_live:
            status["service"] = _service(unit)
        status["ros"] = starts_ros(text)
        if (file := robot_file_of(text)) and current is not None:
            try:
                compilation = read_robot_file(str(current / "robot" / file), [], False)
            except OutsideError as error:  # this is the runtime alone
                status["errors"] = [str(error)]
                continue
            status["errors"] = [str(d.message) for d in compilation.report.errors]
            built = computer.path(STATE.format(name=name)) / "model.json"
            with contextlib.suppress(OSError):  # no service has built it yet
                if isinstance(compilation.model, Robot):
                    digest = hashlib.sha256(built.read_bytes()).hexdigest()
                    status["differs"] = digest != model_hash(compilation.model)
    if status["ros"]:
        status["driver_error"] = "the base driver is a node of ROS 2: see /diagnostics"
        return status
    status["driver"], status["driver_error"] = _driver(
        str(computer.path(CONTROL.format(name=name)))
    )
    return status


def _service(unit: str) -> dict[str, str]:
    command = ["systemctl", "show", unit, *(f"--property={name}" for name in _PROPERTIES)]
    try:
        shown = subprocess.run(command, capture_output=True, text=True, timeout=10.0, check=True)
    except (OSError, subprocess.SubprocessError):
        return {}
    return dict(line.split("=", 1) for line in shown.stdout.splitlines() if "=" in line)


def _clock_is_synchronised() -> bool | None:
    """Returns whether a time server sets the clock, as the kernel or systemd-timesyncd says."""
    command = ["timedatectl", "show", "--property=NTPSynchronized", "--value"]
    try:
        shown = subprocess.run(command, capture_output=True, text=True, timeout=10.0, check=True)
    except (OSError, subprocess.SubprocessError):
        folder = Path("/run/systemd/timesync")
        return (folder / "synchronized").exists() if folder.is_dir() else None
    return {"yes": True, "no": False}.get(shown.stdout.strip())


def _driver(channel: str) -> tuple[dict[str, Any] | None, str]:
    from thorvaldc.runtime.control_channel import ControlClient
    from thorvaldc.runtime.service_table import ServiceError

    try:
        with contextlib.closing(ControlClient(channel)) as client:
            if difference := client.other_version():  # its state may have other keys
                return None, f"{difference}, then restart the service"
            return client.call("state"), ""
    except (OSError, ServiceError):
        if Path(channel).exists() and not os.access(channel, os.W_OK):
            return None, "only root and the user of the service may ask the base driver"
        return None, "the base driver does not run"


def is_well(status: dict[str, Any]) -> bool:
    """Returns whether the base driver of a robot runs without a fault, from its robot file.

    Of a robot with ROS 2, only systemd says whether its launch runs.
    """
    driver = status["driver"]
    if status["ros"]:
        return bool(status["service"].get("ActiveState") == "active")
    return bool(driver and not driver["fault"] and not status["errors"] and not status["differs"])


def status_lines(status: dict[str, Any]) -> list[str]:
    """Returns the status of a robot for people."""
    name, service, driver = status["name"], status["service"], status["driver"]
    lines = [f"{name}: version {status['version'] or 'none'}"]
    lines += [f"  edited on this computer: {file}" for file in status["edited"]]
    lines += [f"  error in the robot file: {text}" for text in status["errors"]]
    if status["differs"]:
        build = f"{STATE.format(name=name)}/model.json"
        lines.append(
            f"  it runs another robot than its file describes: restart the service; `thorvaldc diff"
            f" {build} ROBOT_FILE` shows the differences"
        )
    if service:
        since = service.get("ActiveEnterTimestamp") or "never"
        lines.append(
            f"  service {service.get('ActiveState')} ({service.get('SubState')}), last start"
            f" {since}, {service.get('NRestarts', '0')} restarts, result {service.get('Result')}"
        )
    lines += _clock_lines(status["clock"])
    if driver is None:
        return [*lines, f"  {status['driver_error']}"]
    return [*lines, *(f"  {label}: {text}" for label, text in state_rows(driver))]


def _clock_lines(clock: dict[str, Any]) -> Iterator[str]:
    """Yields whether a clock is synchronised, and how it differs from that of this computer."""
    if not clock:
        return
    states = {True: "synchronised", False: "NOT synchronised", None: "unknown synchronisation"}
    text = f"  clock: {states[clock.get('synchronised')]}"
    if "ahead" in clock:
        side = "behind" if clock["ahead"] < 0.0 else "ahead of"
        text += (
            f", {abs(clock['ahead']):.3f} s {side} the clock of this computer"
            f" (± {clock['uncertainty']:.3f} s)"
        )
    yield text
