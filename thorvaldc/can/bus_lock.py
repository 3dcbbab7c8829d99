"""Lock that allows only one master for each CAN bus on a computer.

On Linux the lock is a socket in the abstract name space, which depends neither on the user nor on
the environment (``XDG_RUNTIME_DIR``, ``TMPDIR``).  Like a CAN network interface, it belongs to a
network name space.  On other systems the lock is a file of the user.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import socket
import sys
from types import TracebackType

from thorvaldc.can.local_socket import runtime_directory, socket_path
from thorvaldc.diagnostics.error import DiagnosticError


class BusLock:
    """Context manager that locks a CAN bus for one master.

    The operating system releases the lock of the CAN bus when the process ends.
    """

    def __init__(self, spec: str) -> None:
        """``spec``: name of the CAN interface, such as ``socketcan:can0``."""
        self.spec = spec
        self._socket: socket.socket | None = None
        self._file: int | None = None

    def __enter__(self) -> BusLock:
        """Locks the bus.

        Raises ``DiagnosticError`` (``bus-locked``) if another program has locked the bus.  Raises
        ``OSError`` if the lock cannot be created.
        """
        digest = hashlib.sha256(_identity(self.spec).encode()).hexdigest()[:32]
        try:
            if sys.platform == "linux":
                self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
                self._socket.bind(f"\0thorvaldc-master-{digest}")
            else:
                path = runtime_directory() / f"master-{digest}.lock"
                self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._release()
            if error.errno not in (errno.EADDRINUSE, errno.EWOULDBLOCK):
                raise
            raise DiagnosticError(
                "bus-locked",
                f"another `thorvaldc can` or `thorvaldc run` uses the bus {self.spec}",
                hint="wait until it has finished, or stop it",
            ) from None
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._release()

    def _release(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._file is not None:
            os.close(self._file)
            self._file = None


def _identity(spec: str) -> str:
    """Returns a name that is the same for all spellings of a CAN interface."""
    interface, _, channel = spec.partition(":")
    if interface == "sim":
        with contextlib.suppress(OSError):  # an invalid name is reported when the bus is opened
            channel = os.path.realpath(socket_path(channel))
    elif interface == "slcan":
        channel = os.path.realpath(channel.partition("@")[0])
    return f"{interface}:{channel}"
