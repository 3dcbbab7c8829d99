"""Expansion of xacro files through the worker process, as elements that know their place."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from thorvaldc.compiler.extras import xacro_worker
from thorvaldc.diagnostics import Span

WALL_SECONDS = 20.0
MAX_ANSWER_BYTES = 64 << 20


@dataclass(frozen=True, slots=True)
class Element:
    """An XML element of the expanded file.

    ``calls`` are the macro calls it came through, the innermost first.  ``xml`` is
    its own text where it is not read further (``<gazebo>`` and the like).
    """

    tag: str
    attributes: dict[str, str]
    children: tuple[Element, ...]
    text: str
    span: Span
    calls: tuple[Span, ...]
    file: Path
    xml: str = ""

    def find(self, tag: str) -> Element | None:
        """The first child of that tag."""
        return next((child for child in self.children if child.tag == tag), None)


@dataclass(frozen=True, slots=True)
class Macro:
    """A macro that a file defines; ``needed`` are its parameters without a default."""

    name: str
    needed: tuple[str, ...]
    span: Span | None
    called: bool


@dataclass(frozen=True, slots=True)
class Fault:
    """Why a file could not be expanded.  ``kind``: see ``xacro_worker``."""

    kind: str
    text: str
    span: Span | None
    trail: tuple[tuple[Span, str], ...]


@dataclass(frozen=True, slots=True)
class Expanded:
    """What came out of one file.

    ``packages`` are the ROS packages that it asked for, ``files`` all files that were
    read, by the names that spans have for them.
    """

    fault: Fault | None
    elements: tuple[Element, ...]
    macros: tuple[Macro, ...]
    warnings: tuple[tuple[str, Span | None], ...]
    unused_arguments: tuple[str, ...]
    known_arguments: tuple[str, ...]
    packages: dict[str, str]
    shown: Shown
    files: dict[str, Path]


@dataclass(frozen=True, slots=True)
class Request:
    """A file to expand, all paths absolute; ``packages`` maps a ROS package to its folder."""

    file: Path
    args: dict[str, str]
    packages: dict[str, str]


@dataclass(frozen=True, slots=True)
class Shown:
    """How messages and outputs call files, whatever folder the whole lies in.

    Relative to ``folder``, that of the robot's file, which spans call ``display``;
    a file of an installed package (``installed``: name to folder) by its package.
    """

    folder: Path
    display: str
    installed: dict[str, str]

    def name(self, file: str) -> str:
        for package, folder in self.installed.items():
            if file.startswith(os.path.join(folder, "")):
                return f"package://{package}/{os.path.relpath(file, folder)}".replace(os.sep, "/")
        relative = os.path.relpath(file, self.folder)
        return os.path.normpath(os.path.join(self.display, relative)).replace(os.sep, "/")

    def text(self, message: str) -> str:
        """A message, or any text, with absolute paths named as ``name`` does."""
        for package, folder in self.installed.items():
            message = message.replace(os.path.join(folder, ""), f"package://{package}/")
        prefix = os.path.join(self.display, "") if self.display else ""
        return message.replace(os.path.join(str(self.folder), ""), prefix)


def search_paths() -> dict[str, Sequence[str]]:
    """Where ROS packages lie by the environment."""
    return {
        "ament": _split(os.environ.get("AMENT_PREFIX_PATH", "")),
        "ros": _split(os.environ.get("ROS_PACKAGE_PATH", "")),
    }


def _split(paths: str) -> list[str]:
    return [path for path in paths.split(os.pathsep) if path]


def expand(requests: Sequence[Request], shown: Shown) -> list[Expanded]:
    """Expand each file, in order, in one worker process (another after a failure)."""
    search = search_paths()
    entries = [
        {"file": str(r.file), "args": r.args, "packages": r.packages, "search": search}
        for r in requests
    ]
    answers: list[dict[str, Any]] = []
    while len(answers) < len(entries):
        answers += _work(entries[len(answers) :])
    roots = [*search["ament"], *search["ros"]]
    done: list[Expanded] = []
    for answer, request in zip(answers, requests, strict=True):
        installed = {
            name: folder
            for name, folder in answer.get("packages", {}).items()
            if name not in request.packages and folder.startswith(tuple(roots))
        }
        done.append(_expanded(answer, replace(shown, installed=installed)))
    return done


def _work(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The answers of one worker; the last one is a fault where it did not live to the end."""
    if find_spec("xacro") is None:
        text = "the package xacro is not installed"
        return [{"fault": {"kind": "expression", "text": text}} for _ in entries]
    path = [
        str(Path(spec.origin).parent.parent)
        for spec in (find_spec("xacro"), find_spec("yaml"))
        if spec is not None and spec.origin is not None
    ]
    request = json.dumps({"path": path, "entries": entries}).encode()
    answers: list[dict[str, Any]] = []
    environment = {"LC_ALL": "C.UTF-8", "PYTHONHASHSEED": "0"}
    if "SYSTEMROOT" in os.environ:  # Windows starts nothing without it
        environment["SYSTEMROOT"] = os.environ["SYSTEMROOT"]
    process = subprocess.Popen(
        # no site, no user folder, no path of the caller's, no .pyc files
        [sys.executable, "-s", "-S", "-P", "-B", xacro_worker.__file__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
        start_new_session=True,  # Ctrl-C reaches us, and we end it
    )
    stdin, stdout = process.stdin, process.stdout
    if stdin is None or stdout is None:
        raise OSError("the xacro worker has no pipes")
    late = threading.Event()

    def stop() -> None:
        late.set()
        _kill(process)

    try:
        with contextlib.suppress(BrokenPipeError):
            stdin.write(request)
            stdin.close()
        for _ in entries:
            timer = threading.Timer(WALL_SECONDS, stop)
            timer.daemon = True
            timer.start()
            try:
                line = stdout.readline(MAX_ANSWER_BYTES)
            finally:
                timer.cancel()
            if not line.endswith(b"\n"):
                _kill(process)
                answers.append(_died(len(line), late.is_set(), process.wait()))
                break
            answers.append(json.loads(line))
    finally:
        _kill(process)
        process.wait()
        stdout.close()
        with contextlib.suppress(BrokenPipeError):
            stdin.close()
    return answers


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End the worker and whatever it started."""
    if process.poll() is not None:
        return
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()


def _died(received: int, late: bool, status: int) -> dict[str, Any]:
    if late:
        text = f"its expansion took longer than {WALL_SECONDS:g} s"
    elif received >= MAX_ANSWER_BYTES:
        text = f"it expands to more than {MAX_ANSWER_BYTES >> 20} MB"
    elif status == -getattr(signal, "SIGXCPU", 24):
        text = f"its expansion took longer than {xacro_worker.CPU_SECONDS} s of processor time"
    else:
        text = f"its expansion ended the process (status {status})"
    return {"fault": {"kind": "limit", "text": text}}


def _expanded(answer: dict[str, Any], shown: Shown) -> Expanded:
    files: list[str] = answer.get("files", [])

    def span(place: list[int] | None, length: int = 1) -> Span | None:
        if place is None:
            return None
        number, line, column = place
        return Span(shown.name(files[number]), line, column, line, column + length)

    def spans(places: list[list[int]]) -> tuple[Span, ...]:
        return tuple(s for s in map(span, places) if s is not None)

    def element(raw: dict[str, Any]) -> Element:
        place = raw["place"] or [0, 1, 1]
        return Element(
            raw["tag"],
            raw["attributes"],
            tuple(element(child) for child in raw.get("children", ())),
            raw.get("text", ""),
            span(place, len(raw["tag"]) + 1) or Span(""),
            spans(raw["calls"]),
            Path(files[place[0]]),
            raw.get("xml", ""),
        )

    fault = None
    if "fault" in answer:
        raw = answer["fault"]
        trail = ((span(place), text) for place, text in answer.get("trail", ()))
        fault = Fault(
            raw["kind"],
            shown.text(raw["text"]),
            span(raw.get("place")),
            tuple((s, text) for s, text in trail if s is not None),
        )
    called = answer.get("called", [])
    return Expanded(
        fault,
        tuple(element(raw) for raw in answer.get("elements", ())),
        tuple(
            Macro(name, tuple(needed), span(place), name in called)
            for name, needed, place in answer.get("macros", ())
        ),
        tuple((shown.text(text), span(place)) for text, place in answer.get("warnings", ())),
        tuple(answer.get("unused", ())),
        tuple(answer.get("asked", ())),
        answer.get("packages", {}),
        shown,
        {shown.name(file): Path(file) for file in files},
    )
