"""Access to a CAN bus through python-can: hardware, socketcan and UDP multicast."""

from __future__ import annotations

import contextlib
import errno
import threading
import time
from collections import Counter, deque
from typing import TYPE_CHECKING

from thorvaldc.can.frame import CanFrame, ErrorState, ReceivedFrame, elapsed, elapsed_ns, to_ns

if TYPE_CHECKING:
    import can

MAXIMUM_AGE = 1.0
"""Largest age (s) of a usable time stamp, and longest time (s) to wait for an echo."""
GRACE_TIME = 0.01
"""Time (s) for which ``receive`` drops invalid datagrams after its time-out."""

# Constants of linux/can/error.h.  The identifier of a socketcan error frame contains the bits of
# the error class.  Data byte 1 of a socketcan error frame contains the error state of the CAN
# controller.
_ERR_CONTROLLER, _ERR_BUS_OFF, _ERR_RESTARTED = 0x04, 0x40, 0x100
_ERR_CONTROLLER_PASSIVE, _ERR_CONTROLLER_ACTIVE = 0x30, 0x40

_LOST = (errno.ENODEV, errno.ENXIO, errno.ENETDOWN, errno.EIO, errno.EBADF)
"""Error numbers that mean that the interface was unplugged or switched off."""


class PythonCanInterface:
    """A CAN interface that sends and receives through a bus of python-can (``can.BusABC``).

    The clock of the CAN interface is ``elapsed``, which also counts while the computer is
    asleep.  The time stamps of python-can come from the wall clock, which jumps when the time of
    the computer is set.  The age of each CAN frame is computed from its time stamp and subtracted
    from the present time.  The time stamp of a CAN frame is ignored if it is in the future or older
    than ``MAXIMUM_AGE``.  One thread may send CAN frames while another thread receives CAN frames.

    Most interfaces of python-can do not report the error states error-passive and bus-off.  The
    socketcan interface delivers error frames, from which ``receive`` reads the error state of the
    CAN controller.  The property ``overruns`` is always 0, because python-can does not report the
    number of lost CAN frames.

    Echo removal (``datagrams``).  With UDP multicast a program also receives the CAN frames that
    the program has sent (echoes), and python-can does not mark the echoes.  To detect the echoes,
    ``send`` counts the sent CAN frames by identifier and data.  For each sent CAN frame,
    ``receive`` drops one received CAN frame with the same identifier and data.  If another node
    sends a CAN frame with the same identifier and data, ``receive`` drops one of the two CAN frames
    and returns the other.

        send     701#05
        receive           701#05    701#05    701#7f
                          echo      kept      kept
        expected    1       0          0

    The echo of a sent CAN frame is expected for at most ``MAXIMUM_AGE`` seconds.

    Datagrams of anyone (``datagrams``).  A datagram that is not a CAN frame, and a datagram with an
    error frame, which only a CAN controller can report, is dropped and counted in ``undecodable``.
    """

    overruns = 0
    receives_by_itself = False

    def __init__(
        self,
        bus: can.BusABC,
        *,
        datagrams: bool = False,
        shared: bool = False,
        write_time: float = 0.0,
    ) -> None:
        """Creates a CAN interface that uses the python-can bus ``bus``.

        - ``datagrams``: ``True`` if ``bus`` sends frames in datagrams, which also come back to the
          sender, and in which anyone can send anything;
        - ``shared``: ``True`` if several programs of this computer can use the interface, and
          ``bus`` marks the frames of the other programs as sent (``is_rx`` is ``False``).  The
          interface socketcan does so.  Frames of the other programs are frames of another node;
        - ``write_time``: shortest write time-out (s) with which ``bus`` sends whole frames.
        """
        import can

        self.bus = bus
        self._can = can
        self._expected_echoes: Counter[CanFrame] | None = Counter() if datagrams else None
        self._datagrams = datagrams
        self.undecodable = 0
        """Number of dropped datagrams."""
        self._sent: deque[tuple[float, CanFrame]] = deque()
        self._lock = threading.Lock()
        self._shared = shared
        self._write_time = write_time
        self._state = ErrorState.ACTIVE
        self._last_time = 0

    @property
    def now(self) -> float:
        return elapsed()

    @property
    def received_until(self) -> float:
        return elapsed()

    @property
    def state(self) -> ErrorState:
        bus_state = self.bus.state
        if bus_state is self._can.BusState.ERROR:
            return ErrorState.BUS_OFF
        if bus_state is self._can.BusState.PASSIVE:
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
        if self._expected_echoes is not None:
            self._expect_echo(frame)
        try:
            self.bus.send(message, max(timeout, self._write_time))
        except self._can.CanError as error:
            self._raise_if_lost(error)
            return False
        except OSError as error:
            raise ConnectionError(one_line(error)) from None
        return True

    def receive(self, timeout: float | None = None) -> ReceivedFrame | None:
        deadline = None if timeout is None else elapsed() + timeout
        while True:
            remaining = None if deadline is None else max(deadline - elapsed(), 0.0)
            try:
                message = self.bus.recv(remaining)
            except self._can.CanError as error:
                if self._datagrams and not _has_os_error(error):
                    self.undecodable += 1
                    if deadline is not None and elapsed() >= deadline + GRACE_TIME:
                        return None
                    continue
                self._raise_if_lost(error)
                raise ConnectionError(one_line(error)) from None
            except (OSError, ValueError) as error:
                raise ConnectionError(one_line(error)) from None
            if message is None:
                if deadline is not None and elapsed() >= deadline:
                    return None
                continue
            if self._datagrams and not _is_valid(message):
                self.undecodable += 1
                continue
            if message.is_error_frame:
                self._evaluate_error_frame(message)
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
            if self._expected_echoes is None or not self._is_echo(frame):
                arrival = self._elapsed_time(message.timestamp)
                return ReceivedFrame(arrival, frame, not (message.is_rx or self._shared))

    def sleep(self, seconds: float) -> None:
        if seconds > 0.0:
            time.sleep(seconds)

    def sleep_until(self, time: float) -> None:
        self.sleep(time - self.now)

    def restart(self) -> None:
        """Restarts the CAN controller after bus-off, if the CAN interface supports a restart.

        A socketcan interface can only be restarted by the operating system, with the command ``ip
        link``.  After the restart the socketcan interface sends an error frame.
        """
        with contextlib.suppress(NotImplementedError, AttributeError):
            self.bus.state = self._can.BusState.ACTIVE

    def close(self) -> None:
        # Closing the CAN interface raises an exception if the CAN adapter is unplugged.
        with contextlib.suppress(self._can.CanError, OSError):
            self.bus.shutdown()

    # -- inside --------------------------------------------------------------------------------

    def _elapsed_time(self, stamp: float) -> int:
        """Converts a wall clock time stamp (s) to the time (ns) of the CAN interface.

        The converted time is never earlier than the time of the previous CAN frame.
        """
        age = time.time() - stamp
        arrival = elapsed_ns()
        if 0.0 < age <= MAXIMUM_AGE:
            arrival -= to_ns(age)
        self._last_time = max(arrival, self._last_time)
        return self._last_time

    def _evaluate_error_frame(self, message: can.Message) -> None:
        classes, data = message.arbitration_id, bytes(message.data)
        if classes & _ERR_BUS_OFF:
            self._state = ErrorState.BUS_OFF
        elif classes & _ERR_RESTARTED:
            self._state = ErrorState.ACTIVE
        elif classes & _ERR_CONTROLLER and len(data) > 1 and data[1] & _ERR_CONTROLLER_PASSIVE:
            self._state = ErrorState.PASSIVE
        elif classes & _ERR_CONTROLLER and len(data) > 1 and data[1] & _ERR_CONTROLLER_ACTIVE:
            self._state = ErrorState.ACTIVE

    def _expect_echo(self, frame: CanFrame) -> None:
        now = elapsed()
        with self._lock:
            self._drop_old_echoes(now)
            if self._expected_echoes is not None:
                self._expected_echoes[frame] += 1
                self._sent.append((now, frame))

    def _is_echo(self, frame: CanFrame) -> bool:
        with self._lock:
            self._drop_old_echoes(elapsed())
            expected = self._expected_echoes
            if expected is None or not expected[frame]:
                return False
            expected[frame] -= 1
            return True

    def _drop_old_echoes(self, now: float) -> None:
        expected = self._expected_echoes
        while expected is not None and self._sent and now - self._sent[0][0] > MAXIMUM_AGE:
            frame = self._sent.popleft()[1]
            if expected[frame] > 0:
                expected[frame] -= 1
            if not expected[frame]:
                del expected[frame]

    def _raise_if_lost(self, error: can.CanError) -> None:
        causes: list[BaseException | None] = [error, error.__cause__, error.__context__]
        codes = [getattr(error, "error_code", None)]
        codes += [cause.errno for cause in causes if isinstance(cause, OSError)]
        timed_out = any(isinstance(cause, TimeoutError) for cause in causes)
        if not timed_out and any(code in _LOST for code in codes):
            raise ConnectionError(one_line(error)) from None


def _has_os_error(error: BaseException) -> bool:
    return isinstance(error.__cause__, OSError) or isinstance(error.__context__, OSError)


def _is_valid(message: can.Message) -> bool:
    """Returns whether a message that anyone can have sent is a CAN frame of CAN 2.0."""
    numbers = message.arbitration_id, message.dlc
    return (
        all(isinstance(number, int) for number in numbers)
        and isinstance(message.data, bytearray)
        and len(message.data) <= 8
        and not message.is_error_frame
    )


def one_line(error: BaseException) -> str:
    """Returns the text of an exception in one line, without operating system error numbers."""
    if isinstance(error, OSError) and error.strerror and type(error).__module__ == "builtins":
        return str(error.strerror)
    return " ".join(str(error).split()) or type(error).__name__
