"""Opens a CAN interface by its name, such as ``sim:NAME``, ``slcan:PORT`` or ``socketcan:can0``.

python-can reports a wrong interface name or a missing permission late, and with an error text of
its backend.  Common user errors, such as a missing serial port, are detected before the CAN
interface is opened and are reported with a hint.

``bus_lock`` allows only one master for each bus on a computer.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import functools
import hashlib
import importlib
import logging
import os
import socket
import stat
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thorvaldc.can.frame import CanInterface
from thorvaldc.can.local_socket import runtime_directory, socket_path
from thorvaldc.can.python_can_interface import PythonCanInterface, one_line
from thorvaldc.can.simulated_bus_client import SimulatedBusClient
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.model import Bus, Robot

if TYPE_CHECKING:
    import can


UDP_GROUP = "239.74.163.2"
"""Default multicast group of the interface ``udp``."""
SERIAL_START = 2.0
"""Time (s) to wait for a serial adapter to start after its port is opened."""
SERIAL_WRITE_TIME = 0.01
"""Shortest write time-out (s): with less, pyserial may write only a part of a frame."""

_IP_MULTICAST_ALL = 49
"""Option of Linux (linux/in.h), which the module ``socket`` does not name."""
_ALIASES = {"udp": "udp_multicast"}
_EXTRAS = {"slcan": "serial", "udp_multicast": "udp"}
"""Name of our pip extra that installs the packages for a backend of python-can."""
_ARPHRD_CAN = 280
"""Type number of a CAN network interface in /sys/class/net (linux/if_arp.h)."""
_IFF_UP = 1


def open_interface(spec: str, bus: Bus, *, listen_only: bool = False) -> CanInterface:
    """Opens the CAN interface ``spec`` at the bitrate of ``bus``.

    - ``sim:NAME``: a bus that ``thorvaldc bus`` runs, by the name that it prints;
    - ``slcan:PORT``: a serial adapter, ``slcan:/dev/ttyACM0`` (``@115200`` for its baud rate);
    - ``socketcan:can0``: a Linux network interface, which is already up at the right bitrate;
    - ``udp``: frames in UDP multicast, between programs of this computer;
    - ``udp:GROUP``: the same between computers, on which everyone in the network can send;
    - ``INTERFACE:CHANNEL``: any other interface that python-can knows.

    If ``listen_only`` is ``True``, the CAN interface sends neither CAN frames nor acknowledgements.
    Only the CAN interfaces ``sim`` and ``slcan`` support ``listen_only``.

    Raises ``DiagnosticError`` (``bus-interface``) if the CAN interface does not exist or is not set
    up, or if the user has no permission to use the CAN interface.
    """
    name, _, channel = spec.partition(":")
    if name == "sim":
        return _open_simulated(spec, channel, bus, listen_only)
    backend = _ALIASES.get(name, name)
    if backend == "udp_multicast" and not channel:
        channel = UDP_GROUP
    options: dict[str, Any] = {}
    import can.interfaces

    # The log output of python-can is dropped, because this module reports the errors as
    # diagnostics.
    logging.getLogger("can").addHandler(logging.NullHandler())
    if backend not in can.interfaces.BACKENDS:
        raise _interface_error(
            spec,
            f"python-can knows no interface `{name}`",
            "use sim:NAME, slcan:PORT, socketcan:can0, udp or an interface of python-can: "
            + ", ".join(sorted(can.interfaces.BACKENDS)),
        )
    if not channel:
        raise _interface_error(spec, f"`{name}` needs a channel", f"write {name}:CHANNEL")
    if backend == "socketcan":
        _check_network_interface(spec, channel, bus)
    else:
        options["bitrate"] = bus.bitrate
    if listen_only and backend == "slcan":
        options["listen_only"] = True
    if backend == "slcan":
        path = channel.partition("@")[0]
        _check_serial_port(spec, path)
        is_pseudo_terminal = os.path.realpath(path).startswith("/dev/pts/")
        options["sleep_after_open"] = 0.0 if is_pseudo_terminal else SERIAL_START
    elif backend == "udp_multicast":
        options["fd"] = False
        del options["bitrate"]
    python_can_bus = _open_python_can(spec, backend, channel, options)
    if backend == "udp_multicast":
        _restrict_to_its_group(python_can_bus)
    if spec in ("udp", "udp_multicast"):
        _restrict_to_this_computer(python_can_bus)
    return PythonCanInterface(
        python_can_bus,
        datagrams=backend == "udp_multicast",
        shared=backend == "socketcan",
        write_time=SERIAL_WRITE_TIME if backend == "slcan" else 0.0,
    )


def open_interfaces(spec: str, robot: Robot) -> dict[str, CanInterface]:
    """Opens a CAN interface for each CAN bus of the robot.

    Returns a dictionary of the CAN interfaces by bus name.

    If the robot has several CAN buses, ``spec`` contains a CAN interface for each bus, such as
    ``left=socketcan:can0,right=socketcan:can1``.  With ``sim:NAME`` a robot with the buses ``left``
    and ``right`` uses the simulated buses ``NAME.left`` and ``NAME.right``.
    """
    robot.require_bus()
    names = [bus.name for bus in robot.buses]
    if spec == "virtual:delivered":
        reason = "a delivered robot has no node ids yet; it is for the `can` commands"
        raise _interface_error(spec, reason, "use `virtual`, whose nodes are configured")
    specs = _split_spec(spec, names)
    interfaces: dict[str, CanInterface] = {}
    try:
        for bus in robot.buses:
            interfaces[bus.name] = open_interface(specs[bus.name], bus)
    except DiagnosticError:
        for interface in interfaces.values():
            interface.close()
        raise
    return interfaces


def lock_buses(spec: str, robot: Robot, locks: contextlib.ExitStack) -> None:
    """Locks all CAN buses of the robot until ``locks`` is closed.

    Raises ``DiagnosticError`` (``bus-locked``) if another master of this computer uses a bus.
    """
    for name in _split_spec(spec, [bus.name for bus in robot.buses]).values():
        locks.enter_context(bus_lock(name))


@contextlib.contextmanager
def bus_lock(spec: str) -> Iterator[None]:
    """Locks the CAN bus at the interface ``spec``, such as ``socketcan:can0``, for one master.

    The operating system releases the lock when the process ends.  On Linux the lock is a socket in
    the abstract name space, which depends neither on the user nor on the environment
    (``XDG_RUNTIME_DIR``, ``TMPDIR``).  Like a CAN network interface, it belongs to a network name
    space.  On other systems the lock is a file of the user.

    Raises ``DiagnosticError`` (``bus-locked``) if another program has locked the bus.  Raises
    ``OSError`` if the lock cannot be created.
    """
    digest = hashlib.sha256(_identity(spec).encode()).hexdigest()[:32]
    with contextlib.ExitStack() as lock:
        try:
            if sys.platform == "linux":
                address = lock.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
                address.bind(f"\0thorvaldc-master-{digest}")
            else:
                path = runtime_directory() / f"master-{digest}.lock"
                file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
                lock.callback(os.close, file)
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EWOULDBLOCK):
                raise
            raise DiagnosticError(
                "bus-locked",
                f"another `thorvaldc can` or `thorvaldc run` uses the bus {spec}",
                hint="wait until it has finished, or stop it",
            ) from None
        yield


def _identity(spec: str) -> str:
    """Returns a name that is the same for all spellings of a CAN interface."""
    interface, _, channel = spec.partition(":")
    if interface == "sim":
        with contextlib.suppress(OSError):  # an invalid name is reported when the bus is opened
            channel = os.path.realpath(socket_path(channel))
    elif interface == "slcan":
        channel = os.path.realpath(channel.partition("@")[0])
    return f"{interface}:{channel}"


def _split_spec(spec: str, names: list[str]) -> Mapping[str, str]:
    """Returns the name of the CAN interface for each CAN bus in ``names``."""
    if len(names) == 1:
        return {names[0]: spec.removeprefix(f"{names[0]}=")}
    if spec.startswith("sim:") and "=" not in spec:
        return {name: f"{spec}.{name}" for name in names}
    specs = dict(part.strip().partition("=")[::2] for part in spec.split(","))
    if sorted(specs) != sorted(names) or not all(specs.values()):
        example = ",".join(f"{name}=socketcan:can{i}" for i, name in enumerate(names))
        raise _interface_error(
            spec,
            f"the robot has the buses {', '.join(names)}",
            f"name an interface for each: {example}",
        )
    return specs


# -- opening ---------------------------------------------------------------------------------


def _open_simulated(spec: str, channel: str, bus: Bus, listen_only: bool) -> CanInterface:
    if not channel:
        hint = "`thorvaldc bus FILE` prints the name"
        raise _interface_error(spec, "`sim` needs the name of a bus", hint)
    try:
        # The send queue must send CAN frames in the order in which they were queued (first in,
        # first out).  The SYNC frame has a higher bus priority than the motor commands, but must be
        # sent after the motor commands.
        return SimulatedBusClient(
            channel, "master", bus.bitrate, listen_only=listen_only, fifo=True
        )
    except OSError as error:
        # A robot with several buses has the channel `NAME.left` for its bus `left`.
        name = channel.removesuffix(f".{bus.name}")
        hint = f"start it in another terminal: thorvaldc bus FILE --channel {name}"
        with contextlib.suppress(OSError):  # the path is too long
            if socket_path(f"{channel}.{bus.name}").exists():
                hint = f"the bus `{bus.name}` of this robot is sim:{channel}.{bus.name}"
        raise _interface_error(spec, one_line(error), hint) from None


def _open_python_can(spec: str, backend: str, channel: str, options: dict[str, Any]) -> can.BusABC:
    import can.interfaces

    module, class_name = can.interfaces.BACKENDS[backend]
    try:
        bus_class = getattr(importlib.import_module(module), class_name)
    except ImportError as error:
        raise _package_error(spec, backend, one_line(error)) from None
    # The python-can bus object is created with separate calls of `__new__` and `__init__`.  The
    # destructor of a python-can bus calls `shutdown`, and `shutdown` prints errors if `__init__`
    # has failed.  The destructor of a python-can bus does not call `shutdown` if the attribute
    # `_is_shutdown` is `True`.
    bus: can.BusABC = bus_class.__new__(bus_class, channel, **options)
    try:
        type(bus).__init__(bus, channel, **options)
    except can.CanInterfaceNotImplementedError as error:
        bus._is_shutdown = True
        raise _package_error(spec, backend, one_line(error)) from None
    except (can.CanError, OSError, ValueError, TypeError, ImportError) as error:
        bus._is_shutdown = True
        raise _open_error(spec, error, channel) from None
    return bus


def _restrict_to_its_group(bus: can.BusABC) -> None:
    """Keeps frames of other groups out of a bus of UDP multicast.

    Linux otherwise delivers the datagrams of every group that a program of this computer has
    joined to each socket of the same port, so that two robots would receive each other's commands.
    """
    with socket.socket(fileno=os.dup(bus.fileno())) as multicast:
        if sys.platform == "linux" and multicast.family == socket.AF_INET:
            multicast.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)


def _restrict_to_this_computer(bus: can.BusABC) -> None:
    """Makes a bus of UDP multicast reach only programs of this computer."""
    group = socket.inet_aton(UDP_GROUP)
    loopback, any_interface = socket.inet_aton("127.0.0.1"), socket.inet_aton("0.0.0.0")
    with socket.socket(fileno=os.dup(bus.fileno())) as multicast:
        option = functools.partial(multicast.setsockopt, socket.IPPROTO_IP)
        option(socket.IP_DROP_MEMBERSHIP, group + any_interface)
        option(socket.IP_ADD_MEMBERSHIP, group + loopback)
        option(socket.IP_MULTICAST_IF, loopback)
        if hasattr(socket, "SO_BINDTODEVICE"):  # Linux: no datagrams to the port either
            multicast.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo")


def _check_serial_port(spec: str, path: str) -> None:
    """Checks that ``path`` is a serial port that this user may read and write.

    A serial port name without leading slash, such as ``COM3``, is not checked.
    """
    if not path.startswith("/"):
        return
    try:
        mode = os.stat(path).st_mode
    except OSError as error:
        hint = "is the adapter plugged in? `ls /dev/serial/by-id` lists serial adapters"
        raise _interface_error(spec, f"{path}: {error.strerror}", hint) from None
    if not stat.S_ISCHR(mode):
        raise _interface_error(spec, f"{path} is not a serial port", None)
    if not os.access(path, os.R_OK | os.W_OK):
        raise _open_error(spec, PermissionError(errno.EACCES, "no permission", path), path)


def _check_network_interface(spec: str, channel: str, bus: Bus) -> None:
    """Checks that the Linux network interface ``channel`` exists, is a CAN interface and is up."""
    if not hasattr(socket, "AF_CAN"):
        hint = "socketcan needs Linux; try slcan:PORT"
        raise _interface_error(spec, "this system has no socketcan", hint)
    folder = Path("/sys/class/net") / channel
    if "/" in channel or not folder.is_dir():
        hint = "`ip link` lists the network interfaces; is the adapter plugged in?"
        raise _interface_error(spec, f"there is no network interface {channel}", hint)
    try:
        kind = int((folder / "type").read_text())
        flags = int((folder / "flags").read_text(), 16)
    except (OSError, ValueError):
        return  # without these files the error appears when the interface is opened
    if kind != _ARPHRD_CAN:
        hint = "`ip link show type can` lists the CAN interfaces"
        raise _interface_error(spec, f"{channel} is not a CAN interface", hint)
    if not flags & _IFF_UP:
        hint = f"sudo ip link set {channel} up type can bitrate {bus.bitrate}"
        raise _interface_error(spec, f"{channel} is down", hint)


# -- errors ----------------------------------------------------------------------------------


def _package_error(spec: str, backend: str, text: str) -> DiagnosticError:
    """Returns the error for a backend of python-can whose Python packages are not installed."""
    extra = _EXTRAS.get(backend)
    hint = install_command(extra) if extra else f"see python-can's documentation of {backend}"
    return _interface_error(spec, text, hint)


def _open_error(spec: str, error: BaseException, channel: str) -> DiagnosticError:
    """Returns the error for a CAN interface that python-can or the operating system cannot open."""
    causes = (error, error.__cause__, error.__context__)
    codes = [cause.errno for cause in causes if isinstance(cause, OSError)]
    codes.append(getattr(error, "error_code", None))
    if errno.EACCES in codes or errno.EPERM in codes:
        hint = "add yourself to the group that owns the port (dialout, on most systems)"
        return _interface_error(spec, f"no permission to use {channel}", hint)
    if errno.EAFNOSUPPORT in codes:
        hint = "load its module: modprobe can_raw"
        return _interface_error(spec, "this system's kernel has no CAN", hint)
    if errno.EBUSY in codes:
        return _interface_error(spec, f"{channel} is in use by another program", None)
    return _interface_error(spec, one_line(error), None)


def _interface_error(spec: str, reason: str, hint: str | None) -> DiagnosticError:
    return DiagnosticError("bus-interface", f"cannot use the bus `{spec}`: {reason}", hint=hint)
