"""File lock that allows only one commissioning program for each bus on a computer."""

from __future__ import annotations

import fcntl
import os
import re
from types import TracebackType

from thorvaldc.can.local_socket import runtime_directory
from thorvaldc.diagnostics.error import DiagnosticError


class BusLock:
    """Context manager that locks a CAN bus for one commissioning program.

    The operating system releases the lock of the CAN bus when the process ends.
    """

    def __init__(self, spec: str) -> None:
        """``spec``: name of the CAN interface, such as ``socketcan:can0``."""
        self.spec = spec
        self._file: int | None = None

    def __enter__(self) -> BusLock:
        """Locks the bus.

        Raises ``DiagnosticError`` (``bus-locked``) if another program has locked the bus.  Raises
        ``OSError`` if the lock file cannot be opened.
        """
        name = re.sub(r"[^A-Za-z0-9.]+", "_", self.spec)[-40:]
        path = runtime_directory() / f"master-{name}.lock"
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._file)
            raise DiagnosticError(
                "bus-locked",
                f"another `thorvaldc can` uses the bus {self.spec}",
                hint="wait until it has finished, or stop it",
            ) from None
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._file is not None:
            os.close(self._file)
