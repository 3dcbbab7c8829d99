"""Time from an edit to its diagnostics in an editor, relative to a cold `check` of the file."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import time
from collections.abc import Iterator
from typing import IO, Any

from bench.figure import ROOT, Figure, python

ROBOT = ROOT / "examples" / "9wd9ws" / "robot.yaml"
ROUNDS = 21


class Client:
    """The smallest client of the Language Server Protocol that a measurement needs."""

    def __init__(self, server: subprocess.Popen[bytes]) -> None:
        assert server.stdin is not None
        assert server.stdout is not None
        self._input: IO[bytes] = server.stdin
        self._output: IO[bytes] = server.stdout

    def send(self, method: str, params: Any, number: int | None = None) -> None:
        message = {"jsonrpc": "2.0", "method": method, "params": params}
        if number is not None:
            message["id"] = number
        body = json.dumps(message).encode()
        self._input.write(b"Content-Length: %d\r\n\r\n%s" % (len(body), body))
        self._input.flush()

    def receive(self) -> dict[str, Any]:
        length = 0
        while (line := self._output.readline().strip()) or not length:
            name, _, value = line.partition(b":")
            if name.lower() == b"content-length":
                length = int(value)
        answer: dict[str, Any] = json.loads(self._output.read(length))
        return answer

    def diagnostics(self, version: int) -> list[Any]:
        """Waits for the diagnostics of a version of the document."""
        while True:
            params = self.receive().get("params", {})
            if isinstance(params, dict) and params.get("version") == version:
                return list(params["diagnostics"])


def figures() -> Iterator[Figure]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    command = python("-m", "thorvaldc", "lsp")
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
    ) as server:
        try:
            edits, checks = _measured(Client(server), environment)
        finally:
            server.kill()
    edit, check = statistics.median(edits), statistics.median(checks)
    yield Figure.ratio(
        "diagnostics after an edit over cold check",
        1 / 3,
        zip(edits, checks, strict=True),
        f"9WD9WS, from the change to its diagnostics {edit * 1e3:.0f} ms (with the delay of 20 ms),"
        f" cold `check` {check * 1e3:.0f} ms, in turns",
    )


def _measured(client: Client, environment: dict[str, str]) -> tuple[list[float], list[float]]:
    text, uri = ROBOT.read_text(encoding="utf-8"), ROBOT.as_uri()
    client.send("initialize", {"processId": None, "rootUri": None, "capabilities": {}}, 1)
    client.receive()
    client.send("initialized", {})
    item = {"uri": uri, "languageId": "yaml", "version": 0, "text": text}
    client.send("textDocument/didOpen", {"textDocument": item})
    client.diagnostics(0)
    edits, checks = [], []
    for version in range(1, ROUNDS + 1):
        changed = text.replace("width: 2.0 m", f"width: 2.{version:02} m")
        start = time.perf_counter()
        document = {"uri": uri, "version": version}
        changes = {"textDocument": document, "contentChanges": [{"text": changed}]}
        client.send("textDocument/didChange", changes)
        client.diagnostics(version)
        edits.append(time.perf_counter() - start)
        start = time.perf_counter()
        check = python("-m", "thorvaldc", "check", str(ROBOT))
        subprocess.run(check, env=environment, check=True, capture_output=True)
        checks.append(time.perf_counter() - start)
    return edits, checks
