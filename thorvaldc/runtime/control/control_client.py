"""A program's end of the control channel."""

from __future__ import annotations

import json
import socket
from typing import Any

from thorvaldc.runtime.control.control_server import control_path
from thorvaldc.runtime.control.service_table import ServiceError

ANSWER_TIME = 2.0
"""s to wait for an answer; a control cycle takes a hundredth of it."""


class ControlClient:
    """Calls the services of a driver that another process runs.

    Raises ``OSError`` where none is run by that name, and ``ConnectionError`` where it ends or
    does not answer.
    """

    def __init__(self, name: str, answer_time: float = ANSWER_TIME) -> None:
        self.name = name
        path = control_path(name)
        self._stream = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._stream.settimeout(answer_time)
        self._unread = b""
        self._calls = 0
        try:
            self._stream.connect(str(path))
        except OSError as fault:
            self._stream.close()
            raise OSError(f"no driver is run at {path} ({fault.strerror or fault})") from None

    def call(self, service: str, **arguments: Any) -> Any:
        """The service's result.  Raises ``ServiceError`` with the reason where it is refused."""
        self._calls += 1
        request = {"call": service, "arguments": arguments, "id": self._calls}
        line = json.dumps(request, ensure_ascii=False).encode("utf-8", "replace") + b"\n"
        try:
            self._stream.sendall(line)
            answer = self._answer()
        except TimeoutError:
            raise ConnectionError(f"the driver `{self.name}` does not answer") from None
        except (OSError, ValueError):
            raise ConnectionError(f"the driver `{self.name}` has ended") from None
        if not answer.get("ok"):
            raise ServiceError(str(answer.get("error", "refused")))
        return answer.get("result")

    def close(self) -> None:
        self._stream.close()

    def _answer(self) -> dict[str, Any]:
        while True:
            line, end, rest = self._unread.partition(b"\n")
            if end:
                self._unread = rest
                found = json.loads(line)
                if isinstance(found, dict) and found.get("id") == self._calls:
                    return found
                if isinstance(found, dict) and not found.get("ok") and "id" not in found:
                    return found
                continue
            data = self._stream.recv(65536)
            if not data:
                raise ConnectionResetError
            self._unread += data
