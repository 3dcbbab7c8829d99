"""The computer on a robot: its CAN adapters and serial ports, and the services that start there."""

from __future__ import annotations

import re
from dataclasses import dataclass

from thorvaldc.model import quantities as si

LONGEST_INTERFACE = 15
"""Longest name of a network interface of Linux (IFNAMSIZ - 1)."""
POWER_OFF = "power-off"
"""File in the runtime directory of the service, which asks to switch the computer off."""


def interface_name(bus: str) -> str:
    """Return the name of the CAN interface of a bus, if the robot file states none."""
    return f"can_{re.sub('[^a-z0-9_]', '_', bus)}"[:LONGEST_INTERFACE]


@dataclass(frozen=True, slots=True)
class UsbDevice:
    """What distinguishes a USB device from other devices of the same kind.

    - ``serial``: serial number of the device (udev's `ID_SERIAL_SHORT`), or empty.
    - ``path``: connector of the computer (udev's `ID_PATH`), or empty.
    """

    serial: str = ""
    path: str = ""


@dataclass(frozen=True, slots=True)
class CanAdapter:
    """The CAN adapter of a bus.

    - ``bus``: name of the bus.
    - ``interface``: name that the CAN interface gets.
    - ``device``: the adapter; the only one of the computer if the device states nothing.
    """

    bus: str
    interface: str
    device: UsbDevice = UsbDevice()

    @property
    def spec(self) -> str:
        """The interface as the option ``--bus`` names it."""
        return f"socketcan:{self.interface}"


@dataclass(frozen=True, slots=True)
class RosStart:
    """How the ROS 2 package of a robot is started.

    - ``workspace``: path of the colcon workspace with the package.
    - ``domain``: domain id.
    - ``middleware``: RMW implementation, or empty for the one of the distribution.
    - ``discovery``: where nodes find others: ``subnet`` or ``localhost``.
    - ``peers``: other computers with nodes.
    """

    workspace: str
    domain: int = 0
    middleware: str = ""
    discovery: str = "subnet"
    peers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Computer:
    """The computer on a robot.

    - ``user``: user of the services.
    - ``program``: path of the program `thorvaldc` on the computer.
    - ``adapters``: the CAN adapter of each bus, in the order of the buses.
    - ``ports``: serial ports by the names that they get in `/dev`.
    - ``joystick``: the joystick that becomes `/dev/joystick`, or ``None``.
    - ``ros``: how ROS 2 is started, or ``None`` if the runtime is started without ROS 2.
    - ``time_servers``: NTP servers, or empty for those of the operating system.
    - ``status_port``: port of the page with the state of the base driver, or ``None`` for no page.
    - ``power_off``: state of charge (0 to 1) below which the computer is switched off; 0: never.
    """

    user: str
    program: str
    adapters: tuple[CanAdapter, ...] = ()
    ports: tuple[tuple[str, UsbDevice], ...] = ()
    joystick: UsbDevice | None = None
    ros: RosStart | None = None
    time_servers: tuple[str, ...] = ()
    status_port: int | None = None
    power_off: si.Share = 0.0
