"""Client of the control channel, which calls the services of a base driver in another process."""

from __future__ import annotations

import json
import socket
from typing import Any

from thorvaldc.diagnostics.foreign_json import read_json
from thorvaldc.runtime.control.control_server import control_path
from thorvaldc.runtime.service_table import ServiceError

ANSWER_TIME = 2.0
"""Longest time (s) to wait for an answer, equal to 100 control cycles."""


class ControlClient:
    """Connection to the control channel of a running base driver.

    The constructor raises ``OSError`` if no base driver with the given name runs.  The method
    ``call`` raises ``ConnectionError`` if the base driver ends or does not answer.
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
        except OSError as error:
            self._stream.close()
            raise OSError(f"no driver runs at {path} ({error.strerror or error})") from None

    def call(self, service: str, **arguments: Any) -> Any:
        """Calls a service of the base driver and returns the result.

        Raises ``ServiceError`` if the base driver refuses the service call.
        """
        self._calls += 1
        request = {"call": service, "arguments": arguments, "id": self._calls}
        line = json.dumps(request, ensure_ascii=False).encode("utf-8", "replace") + b"\n"
        try:
            self._stream.sendall(line)
            answer = self._read_answer()
        except TimeoutError:
            raise ConnectionError(f"the driver `{self.name}` does not answer") from None
        except (OSError, ValueError):
            raise ConnectionError(f"the driver `{self.name}` has ended") from None
        if not answer.get("ok"):
            raise ServiceError(str(answer.get("error", "refused")))
        return answer.get("result")

    def close(self) -> None:
        self._stream.close()

    def _read_answer(self) -> dict[str, Any]:
        """Returns the answer to the last service call, and skips late answers to earlier service
        calls."""
        while True:
            line, end, rest = self._unread.partition(b"\n")
            if end:
                self._unread = rest
                answer = read_json(line)
                if isinstance(answer, dict) and answer.get("id") == self._calls:
                    return answer
                # The answer of the server has no ``id`` if the server could not read the request.
                if isinstance(answer, dict) and not answer.get("ok") and "id" not in answer:
                    return answer
                continue
            data = self._stream.recv(65536)
            if not data:
                raise ConnectionResetError
            self._unread += data
