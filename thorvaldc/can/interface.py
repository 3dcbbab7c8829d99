"""A program's place on a CAN bus: what is the same of a simulated bus and of a real one.

``Client`` (a simulated wire in the same process, virtual time) and ``RemoteClient`` (one that
another process runs) are such places too.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import logging
import os
import stat
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import CanFrame, ReceivedFrame
from thorvaldc.can.nanoseconds import to_ns
from thorvaldc.can.simulated_bus_client import RemoteClient
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.bus import Bus
from thorvaldc.model.buses import require_bus
from thorvaldc.model.robot import Robot

if TYPE_CHECKING:
    import can

UDP_GROUP = "239.74.163.2"
"""The multicast group of ``udp`` where none is given."""
OLDEST = 1.0
"""s: a time stamp of the interface that lies further back, or ahead, is not believed."""
SERIAL_START = 2.0
"""s that a serial adapter may take to start when its port is opened."""

_SHORT = {"udp": "udp_multicast"}
_EXTRAS = {"slcan": "serial", "udp_multicast": "udp"}
_ARPHRD_CAN = 280
# linux/can/error.h: classes of error frames, and what byte 1 says of the controller.
_ERR_CONTROLLER, _ERR_BUS_OFF, _ERR_RESTARTED = 0x04, 0x40, 0x100
_PASSIVE, _ACTIVE_AGAIN = 0x30, 0x40
_GONE = (errno.ENODEV, errno.ENXIO, errno.ENETDOWN, errno.EIO, errno.EBADF)


class CanInterface(Protocol):
    """Sends and receives frames.  Times are s of its own monotonic clock, ``now``.

    Where the interface itself is lost (unplugged, its process ended) ``send`` and
    ``receive`` raise ``ConnectionError``.
    """

    @property
    def now(self) -> float:
        """s; what ``Received.time`` (ns) and ``sleep_until`` count by."""

    @property
    def state(self) -> ErrorState:
        """Of its CAN controller, as far as the interface tells."""

    @property
    def overruns(self) -> int:
        """Frames lost because nobody took those before."""

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        """Queue a frame, waiting at most ``timeout`` s for room.  ``False``: it is not sent."""

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        """The oldest frame received, ``None`` after ``timeout`` s without one."""

    def sleep(self, seconds: float) -> None: ...

    def sleep_until(self, time: float) -> None:
        """Until ``now`` is ``time``; a time that is past is now."""

    def restart(self) -> None:
        """Come back from bus-off."""

    def close(self) -> None: ...


class PythonCanInterface:
    """A bus of python-can.  Times are those of ``time.monotonic``.

    The interface's time stamps are of the wall clock: they are turned into ages, and
    believed up to ``OLDEST``.  ``now`` never jumps with the wall clock.  One thread may send
    while another receives.

    What python-can cannot tell: of most interfaces whether the controller is error-passive
    or off the bus (socketcan tells by error frames, which are looked at while receiving), and
    how many frames a driver has lost (``overruns`` stays 0).
    """

    overruns = 0

    def __init__(self, bus: can.BusABC, *, echoes: bool = False, write_time: float = 0.0) -> None:
        """``echoes``: the interface gives back what is sent, and it is left out.

        ``write_time`` (s): the least time-out that the interface needs to send a whole frame.
        """
        import can

        self.bus = bus
        self._can = can
        self._echoes: Counter[tuple[int, bytes]] | None = Counter() if echoes else None
        self._sent: deque[tuple[float, tuple[int, bytes]]] = deque()
        self._lock = threading.Lock()
        self._write_time = write_time
        self._state = ErrorState.ACTIVE
        self._last = 0

    @property
    def now(self) -> float:
        return time.monotonic()

    @property
    def state(self) -> ErrorState:
        found = self.bus.state
        if found is self._can.BusState.ERROR:
            return ErrorState.BUS_OFF
        if found is self._can.BusState.PASSIVE:
            return ErrorState.PASSIVE
        return self._state

    def send(self, frame: CanFrame, timeout: float = 0.0) -> bool:
        message = self._can.Message(
            arbitration_id=frame.id,
            is_extended_id=frame.extended,
            is_remote_frame=frame.remote,
            dlc=frame.length,
            data=None if frame.remote else frame.data,
            check=True,
        )
        if self._echoes is not None:
            self._expect_echo(frame)
        try:
            self.bus.send(message, max(timeout, self._write_time))
        except self._can.CanError as fault:
            self._raise_if_gone(fault)
            return False
        except OSError as fault:
            raise ConnectionError(_plain(fault)) from None
        return True

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        limit = None if timeout is None else time.monotonic() + timeout
        while True:
            left = None if limit is None else max(limit - time.monotonic(), 0.0)
            try:
                message = self.bus.recv(left)
            except self._can.CanError as fault:
                self._raise_if_gone(fault)
                raise ConnectionError(_plain(fault)) from None
            except (OSError, ValueError) as fault:
                raise ConnectionError(_plain(fault)) from None
            if message is None:
                if limit is not None and time.monotonic() >= limit:
                    return None
                continue
            if message.is_error_frame:
                self._take_error(message)
                continue
            if message.is_fd:
                continue
            frame = CanFrame(
                message.arbitration_id,
                b"" if message.is_remote_frame else bytes(message.data),
                message.is_extended_id,
                message.is_remote_frame,
                message.dlc if message.is_remote_frame else 0,
            )
            if self._echoes is None or not self._is_echo(frame):
                return ReceivedFrame(self._moment(message.timestamp), frame, not message.is_rx)

    def sleep(self, seconds: float) -> None:
        if seconds > 0.0:
            time.sleep(seconds)

    def sleep_until(self, time: float) -> None:
        self.sleep(time - self.now)

    def restart(self) -> None:
        """Ask the interface; socketcan's does it by ``ip link``, and says when it has."""
        with contextlib.suppress(NotImplementedError, AttributeError):
            self.bus.state = self._can.BusState.ACTIVE

    def close(self) -> None:
        # What is gone already cannot say goodbye.
        with contextlib.suppress(self._can.CanError, OSError):
            self.bus.shutdown()

    # -- inside --------------------------------------------------------------------------------

    def _moment(self, stamp: float) -> int:
        """The monotonic time (ns) of a wall clock's time stamp (s); never before the last."""
        age = time.time() - stamp
        now = time.monotonic_ns()
        if 0.0 < age <= OLDEST:
            now -= to_ns(age)
        self._last = max(now, self._last)
        return self._last

    def _take_error(self, message: can.Message) -> None:
        what, data = message.arbitration_id, bytes(message.data)
        if what & _ERR_BUS_OFF:
            self._state = ErrorState.BUS_OFF
        elif what & _ERR_RESTARTED:
            self._state = ErrorState.ACTIVE
        elif what & _ERR_CONTROLLER and len(data) > 1 and data[1] & _PASSIVE:
            self._state = ErrorState.PASSIVE
        elif what & _ERR_CONTROLLER and len(data) > 1 and data[1] & _ACTIVE_AGAIN:
            self._state = ErrorState.ACTIVE

    def _expect_echo(self, frame: CanFrame) -> None:
        now = time.monotonic()
        entry = (frame.id, frame.data)
        with self._lock:
            self._forget(now)
            if self._echoes is not None:
                self._echoes[entry] += 1
                self._sent.append((now, entry))

    def _is_echo(self, frame: CanFrame) -> bool:
        entry = (frame.id, frame.data)
        with self._lock:
            self._forget(time.monotonic())
            echoes = self._echoes
            if echoes is None or not echoes[entry]:
                return False
            echoes[entry] -= 1
            return True

    def _forget(self, now: float) -> None:
        """An echo that has not come within a second is lost."""
        echoes = self._echoes
        while echoes is not None and self._sent and now - self._sent[0][0] > OLDEST:
            entry = self._sent.popleft()[1]
            if echoes[entry] > 0:
                echoes[entry] -= 1
            if not echoes[entry]:
                del echoes[entry]

    def _raise_if_gone(self, fault: can.CanError) -> None:
        causes: list[BaseException | None] = [fault, fault.__cause__, fault.__context__]
        codes = [getattr(fault, "error_code", None)]
        codes += [cause.errno for cause in causes if isinstance(cause, OSError)]
        timed_out = any(isinstance(cause, TimeoutError) for cause in causes)
        if not timed_out and any(code in _GONE for code in codes):
            raise ConnectionError(_plain(fault)) from None


def open_interface(spec: str, bus: Bus, *, listen_only: bool = False) -> CanInterface:
    """The port that ``spec`` names, at the bitrate of ``bus``.

    - ``sim:NAME``: a bus that ``thorvaldc bus`` runs, by the name that it prints;
    - ``slcan:PORT``: a serial adapter, ``slcan:/dev/ttyACM0`` (``@115200`` for its baud rate);
    - ``socketcan:can0``: a network interface of Linux, which was set up with its bitrate;
    - ``udp`` or ``udp:GROUP``: frames in UDP multicast, between programs without hardware;
    - ``INTERFACE:CHANNEL``: any other that python-can knows.

    ``listen_only``: nothing is sent, not even acknowledgements, where the interface can do that.

    Raises ``DiagnosticError`` (``bus-interface``) where there is no such interface, it is not
    set up, or may not be used.
    """
    name, _, channel = spec.partition(":")
    if name == "sim":
        return _open_simulated(spec, channel, bus, listen_only)
    interface = _SHORT.get(name, name)
    if interface == "udp_multicast" and not channel:
        channel = UDP_GROUP
    options: dict[str, Any] = {}
    import can.interfaces

    # What python-can logs is said by our own diagnostics.
    logging.getLogger("can").addHandler(logging.NullHandler())
    if interface not in can.interfaces.BACKENDS:
        raise _fault(
            spec,
            f"python-can knows no interface `{name}`",
            "there are sim:NAME, slcan:PORT, socketcan:can0, udp and python-can's own, "
            + ", ".join(sorted(can.interfaces.BACKENDS)),
        )
    if not channel:
        raise _fault(spec, f"`{name}` needs a channel", f"write {name}:CHANNEL")
    if interface == "socketcan":
        _check_network(spec, channel, bus)
    else:
        options["bitrate"] = bus.bitrate
    if listen_only and interface == "slcan":
        options["listen_only"] = True
    if interface == "slcan":
        path = channel.partition("@")[0]
        _check_serial(spec, path)
        is_terminal = os.path.realpath(path).startswith("/dev/pts/")
        options["sleep_after_open"] = 0.0 if is_terminal else SERIAL_START
    elif interface == "udp_multicast":
        options["fd"] = False
        del options["bitrate"]
    return PythonCanInterface(
        _open(spec, interface, channel, options),
        echoes=interface == "udp_multicast",
        # pyserial sends part of a frame where it must not wait at all.
        write_time=0.01 if interface == "slcan" else 0.0,
    )


def open_interfaces(spec: str, robot: Robot) -> dict[str, CanInterface]:
    """A port for each bus of the robot, by the bus's name.

    Of a robot with several buses ``spec`` names one for each, ``left=socketcan:can0,
    right=socketcan:can1``; or it is ``sim:NAME``, whose channels are ``NAME.left``, ``NAME.right``.
    """
    require_bus(robot)
    names = [bus.name for bus in robot.buses]
    specs = _specs(spec, names)
    ports: dict[str, CanInterface] = {}
    try:
        for bus in robot.buses:
            ports[bus.name] = open_interface(specs[bus.name], bus)
    except DiagnosticError:
        for port in ports.values():
            port.close()
        raise
    return ports


def _specs(spec: str, names: list[str]) -> Mapping[str, str]:
    if len(names) == 1:
        own = f"{names[0]}="
        return {names[0]: spec.removeprefix(own)}
    if spec.startswith("sim:") and "=" not in spec:
        return {name: f"{spec}.{name}" for name in names}
    given = dict(part.strip().partition("=")[::2] for part in spec.split(","))
    if sorted(given) != sorted(names) or not all(given.values()):
        example = ",".join(f"{name}=socketcan:can{i}" for i, name in enumerate(names))
        raise _fault(
            spec, f"the robot has the buses {', '.join(names)}", f"name one for each: {example}"
        )
    return given


# -- opening ---------------------------------------------------------------------------------


def _open_simulated(spec: str, channel: str, bus: Bus, listen_only: bool) -> CanInterface:
    if not channel:
        raise _fault(spec, "`sim` needs the name of a bus", "`thorvaldc bus FILE` prints it")
    try:
        # In the order in which frames are sent, as interfaces do: SYNC after the commands.
        return RemoteClient(channel, "master", bus.bitrate, listen_only=listen_only, fifo=True)
    except OSError as fault:
        hint = f"start it in another terminal: thorvaldc bus FILE --channel {channel}"
        raise _fault(spec, _plain(fault), hint) from None


def _open(spec: str, interface: str, channel: str, options: dict[str, Any]) -> can.BusABC:
    import can.interfaces

    module, kind = can.interfaces.BACKENDS[interface]
    try:
        backend = getattr(importlib.import_module(module), kind)
    except ImportError as fault:
        raise _missing(spec, interface, _plain(fault)) from None
    # Made in two steps: one that fails in the second must not try to shut down what it never
    # was when it is thrown away.
    bus: can.BusABC = backend.__new__(backend, channel, **options)
    try:
        type(bus).__init__(bus, channel, **options)
    except can.CanInterfaceNotImplementedError as fault:
        bus._is_shutdown = True
        raise _missing(spec, interface, _plain(fault)) from None
    except (can.CanError, OSError, ValueError, TypeError, ImportError) as fault:
        bus._is_shutdown = True
        raise _refused(spec, fault, channel) from None
    return bus


def _check_serial(spec: str, path: str) -> None:
    """A device that is named by its path, before anything is written to it."""
    if not path.startswith("/"):
        return
    try:
        mode = os.stat(path).st_mode
    except OSError as fault:
        hint = "is the adapter plugged in? `ls /dev/serial/by-id` lists serial adapters"
        raise _fault(spec, f"{path}: {fault.strerror}", hint) from None
    if not stat.S_ISCHR(mode):
        raise _fault(spec, f"{path} is no serial port", None)
    if not os.access(path, os.R_OK | os.W_OK):
        raise _refused(spec, PermissionError(errno.EACCES, "no permission", path), path)


def _check_network(spec: str, channel: str, bus: Bus) -> None:
    """A network interface of Linux: it is there, is CAN's and is up."""
    import socket

    if not hasattr(socket, "AF_CAN"):
        raise _fault(spec, "this system has no socketcan", "it is Linux's; try slcan:PORT")
    folder = Path("/sys/class/net") / channel
    up = f"sudo ip link set {channel} up type can bitrate {bus.bitrate}"
    if "/" in channel or not folder.is_dir():
        hint = "`ip link` lists those there are; is the adapter plugged in?"
        raise _fault(spec, f"there is no network interface {channel}", hint)
    try:
        kind = int((folder / "type").read_text())
        flags = int((folder / "flags").read_text(), 16)
    except (OSError, ValueError):
        return  # a kernel that does not say: the interface will
    if kind != _ARPHRD_CAN:
        raise _fault(spec, f"{channel} is no CAN interface", "`ip link show type can` lists them")
    if not flags & 1:
        raise _fault(spec, f"{channel} is down", up)


def _missing(spec: str, interface: str, what: str) -> DiagnosticError:
    extra = _EXTRAS.get(interface)
    hint = f"pip install 'thorvaldc[{extra}]'" if extra else f"see python-can on {interface}"
    return _fault(spec, what, hint)


def _refused(spec: str, fault: BaseException, channel: str) -> DiagnosticError:
    causes = (fault, fault.__cause__, fault.__context__)
    codes = [cause.errno for cause in causes if isinstance(cause, OSError)]
    codes.append(getattr(fault, "error_code", None))
    if errno.EACCES in codes or errno.EPERM in codes:
        hint = "add yourself to the group that owns the port (dialout, on most systems)"
        return _fault(spec, f"no permission to use {channel}", hint)
    if errno.EAFNOSUPPORT in codes:
        return _fault(spec, "this system's kernel has no CAN", "load its module: modprobe can_raw")
    if errno.EBUSY in codes:
        return _fault(spec, f"{channel} is in use by another program", None)
    return _fault(spec, _plain(fault), None)


def _fault(spec: str, what: str, hint: str | None) -> DiagnosticError:
    return DiagnosticError("bus-interface", f"cannot use the bus `{spec}`: {what}", hint=hint)


def _plain(fault: BaseException) -> str:
    """One line."""
    if isinstance(fault, OSError) and fault.strerror and type(fault).__module__ == "builtins":
        return str(fault.strerror)
    return " ".join(str(fault).split()) or type(fault).__name__
