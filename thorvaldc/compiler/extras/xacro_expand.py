"""Expands xacro files in a worker process, and returns XML elements with source spans.

The worker process runs ``xacro_worker``.  If it exceeds a limit with a file, another worker process
expands the remaining xacro files.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from dataclasses import asdict, dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from thorvaldc.compiler.extras import xacro_worker
from thorvaldc.compiler.sandbox.worker_process import WorkerLimitError, WorkerLimits, limited_worker
from thorvaldc.compiler.source.readable_folders import real_folders
from thorvaldc.diagnostics import Span

LIMITS = WorkerLimits(
    wall_seconds=20.0, processor_seconds=10, memory_bytes=xacro_worker.MEMORY_BYTES
)


@dataclass(frozen=True, slots=True)
class Element:
    """An XML element of an expanded xacro file.

    - ``tag``: name of the element.
    - ``span``: source span at which a xacro file defines the element.
    - ``calls``: source spans of the macro calls that created the element, the innermost first.
    - ``file``: xacro file that defines the element.
    - ``xml``: XML text of a URDF extension such as ``<gazebo>``.  The XML text is empty for
      elements that are not URDF extensions.
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
        """Returns the first XML child element with the name ``tag``, or ``None``."""
        return next((child for child in self.children if child.tag == tag), None)


@dataclass(frozen=True, slots=True)
class Macro:
    """A xacro macro.

    - ``required``: names of the parameters without a default.
    - ``span``: source span of the macro definition.
    - ``called``: whether the file calls the macro.
    """

    name: str
    required: tuple[str, ...]
    span: Span | None
    called: bool


@dataclass(frozen=True, slots=True)
class ExpansionFailure:
    """The reason why a xacro file cannot be expanded.

    - ``kind``: kind of the failure, as in ``xacro_worker.ExpansionError``.
    - ``text``: description of the failure.
    - ``span``: source span of the failure, or ``None`` if it is unknown.
    - ``trail``: tuples (source span, text) of the includes, macro calls and property definitions
      that led to the failure.
    """

    kind: str
    text: str
    span: Span | None
    trail: tuple[tuple[Span, str], ...]


@dataclass(frozen=True, slots=True)
class ExpandedFile:
    """The result of expanding one xacro file: XML elements and warnings, or a failure.

    - ``failure``: reason why the file cannot be expanded, or ``None``.
    - ``elements``: child elements of ``<robot>``.
    - ``macros``: macros that the file defines.
    - ``warnings``: tuples (text, source span) of the warnings of xacro.
    - ``unused_arguments``: names of the arguments that the robot file sets but xacro does not read.
    - ``known_arguments``: names of the arguments that xacro reads.
    - ``unused_environment``, ``known_environment``: the same for environment variables.
    - ``packages``: folder of each ROS package that the file refers to.
    - ``paths``: converter of absolute paths to file names in messages.
    - ``files``: path of each file that xacro read, by the name of the file in source spans.
    """

    failure: ExpansionFailure | None
    elements: tuple[Element, ...]
    macros: tuple[Macro, ...]
    warnings: tuple[tuple[str, Span | None], ...]
    unused_arguments: tuple[str, ...]
    known_arguments: tuple[str, ...]
    unused_environment: tuple[str, ...]
    known_environment: tuple[str, ...]
    packages: dict[str, str]
    paths: DisplayPaths
    files: dict[str, Path]


@dataclass(frozen=True, slots=True)
class ExpansionRequest:
    """A request to the worker process to expand one xacro file.

    - ``file``: absolute path of the xacro file.
    - ``args``: xacro arguments by name.
    - ``env``: environment variables by name; the file reads no others.
    - ``packages``: absolute path of the folder of each ROS package that the robot file names.
    - ``source_layout``: whether files that a package installs to another folder are found in the
      source folder of the package.
    - ``macro``: name of a macro that is called at the end of the file, or empty text.
    """

    file: Path
    args: dict[str, str]
    packages: dict[str, str]
    env: dict[str, str] = field(default_factory=dict)
    source_layout: bool = False
    macro: str = ""


@dataclass(frozen=True, slots=True)
class DisplayPaths:
    """Converts absolute paths to file names for messages and outputs.

    - ``folder``: absolute path of the folder of the robot file.
    - ``display``: name of this folder in source spans.
    - ``installed``: folder of each installed ROS package, by the name of the package.

    The name of a file in an installed ROS package has the form ``package://...``.  The name of any
    other file is its path relative to ``folder``, after the prefix ``display``.  With relative
    paths, messages and outputs do not depend on the location of the project folder.
    """

    folder: Path
    display: str
    installed: dict[str, str]

    def name(self, file: str) -> str:
        """Returns the file name that messages and outputs show instead of an absolute path.

        - ``file``: absolute path of the file.
        """
        for package, folder in self.installed.items():
            if file.startswith(os.path.join(folder, "")):
                return f"package://{package}/{os.path.relpath(file, folder)}".replace(os.sep, "/")
        relative = os.path.relpath(file, self.folder)
        return os.path.normpath(os.path.join(self.display, relative)).replace(os.sep, "/")

    def text(self, message: str) -> str:
        """Replaces each absolute path in a message by a relative path."""
        for package, folder in self.installed.items():
            message = message.replace(os.path.join(folder, ""), f"package://{package}/")
        prefix = os.path.join(self.display, "") if self.display else ""
        return message.replace(os.path.join(str(self.folder), ""), prefix)


def search_paths() -> dict[str, Sequence[str]]:
    """Returns the search paths of ROS packages from the environment variables.

    - ``ament``: folders in ``AMENT_PREFIX_PATH`` (ROS 2).
    - ``ros``: folders in ``ROS_PACKAGE_PATH`` (ROS 1).
    """
    return {
        "ament": _split(os.environ.get("AMENT_PREFIX_PATH", "")),
        "ros": _split(os.environ.get("ROS_PACKAGE_PATH", "")),
    }


def _split(paths: str) -> list[str]:
    return [path for path in paths.split(os.pathsep) if path]


def readable_folders(
    requests: Sequence[ExpansionRequest], folder: Path, search: dict[str, Sequence[str]]
) -> list[str]:
    """Returns the folders (absolute, without links) that the expansion of xacro files may read.

    These are the folder of the robot file, the folders of the xacro files, the search paths of ROS
    packages, and ROS packages beside and above these files.  The robot file alone cannot open other
    folders: a folder outside of the folder of the robot file must have a file ``package.xml``.
    """
    folders = [folder]
    for request in requests:
        if request.file.suffix.lower() in (".xacro", ".urdf"):
            folders.append(request.file.parent)
        packages = [Path(package) for package in request.packages.values()]
        folders += [package for package in packages if (package / "package.xml").is_file()]
    for prefix in map(Path, search["ament"]):
        # `colcon build --symlink-install` installs links to the sources.
        folders += [prefix / "share", prefix.parent / "src", prefix.parent.parent / "src"]
    folders += map(Path, search["ros"])
    for above in {above for r in requests for above in r.file.absolute().parents}:
        with contextlib.suppress(OSError):
            # Thousands of folders can lie beside a file in /tmp: paths as text take half the time.
            near = [str(above), *(os.path.join(above, name) for name in os.listdir(above))]
            folders += [Path(p) for p in near if os.path.isfile(os.path.join(p, "package.xml"))]
    return real_folders(folders)


_remembered: ContextVar[dict[str, Any] | None] = ContextVar("xacro expansions", default=None)


@contextlib.contextmanager
def remembered_expansions() -> Iterator[None]:
    """Within this context, equal requests are expanded once.

    The context is for many compilations of one robot, during which its xacro files do not change.
    """
    token = _remembered.set({})
    try:
        yield
    finally:
        _remembered.reset(token)


def expand(
    requests: Sequence[ExpansionRequest], paths: DisplayPaths, *, trust: bool = False
) -> list[ExpandedFile]:
    """Expands several xacro files, and returns one result per xacro file in the same order.

    One worker process expands all xacro files, unless the process ends early.

    - ``trust``: whether the user trusts the files as he trusts a program.  Their expressions and
      file access are then not restricted.
    """
    search = search_paths()
    folders = None if trust else readable_folders(requests, paths.folder, search)
    entries = [{**asdict(r), "file": str(r.file), "search": search} for r in requests]
    remembered = _remembered.get()
    if remembered is None:
        answers = _answers(entries, folders)
    else:
        key = json.dumps([entries, folders])
        if key not in remembered:
            remembered[key] = _answers(entries, folders)
        answers = remembered[key]
    roots = [*search["ament"], *search["ros"]]
    expanded_files: list[ExpandedFile] = []
    for answer, request in zip(answers, requests, strict=True):
        installed = {
            name: folder
            for name, folder in answer.get("packages", {}).items()
            if name not in request.packages and folder.startswith(tuple(roots))
        }
        expanded_files.append(_decode(answer, replace(paths, installed=installed)))
    return expanded_files


def _answers(entries: list[dict[str, Any]], folders: list[str] | None) -> list[dict[str, Any]]:
    """Returns the answers of the worker process, one per xacro file."""
    if find_spec("xacro") is None:
        text = "the package xacro is not installed"
        return [{"failure": {"kind": "expression", "text": text}} for _ in entries]
    path = [
        str(Path(spec.origin).parent.parent)
        for spec in (find_spec("xacro"), find_spec("yaml"))
        if spec is not None and spec.origin is not None
    ]
    answers: list[dict[str, Any]] = []
    service, imports = xacro_worker.__name__, ["xacro.substitution_args", "yaml"]
    with limited_worker(service, LIMITS, path=path, imports=imports) as worker:
        for entry in entries:
            try:
                answers.append(worker.ask(entry | {"folders": folders})[0])
            except WorkerLimitError as error:
                failure = {"kind": "limit", "text": f"its expansion {error}"}
                answers.append({"failure": failure})
    return answers


def _decode(answer: dict[str, Any], paths: DisplayPaths) -> ExpandedFile:
    """Converts the JSON answer of the worker process for one xacro file."""
    files: list[str] = answer.get("files", [])

    def span(position: list[int] | None, length: int = 1) -> Span | None:
        if position is None:
            return None
        file_index, line, column = position
        return Span(paths.name(files[file_index]), line, column, line, column + length)

    def spans(positions: list[list[int]]) -> tuple[Span, ...]:
        return tuple(s for s in map(span, positions) if s is not None)

    def element(raw: dict[str, Any]) -> Element:
        position = raw["position"] or [0, 1, 1]
        return Element(
            raw["tag"],
            raw["attributes"],
            tuple(element(child) for child in raw.get("children", ())),
            raw.get("text", ""),
            span(position, len(raw["tag"]) + 1) or Span(""),
            spans(raw["calls"]),
            Path(files[position[0]]),
            raw.get("xml", ""),
        )

    failure = None
    if "failure" in answer:
        raw = answer["failure"]
        trail = ((span(position), text) for position, text in answer.get("trail", ()))
        failure = ExpansionFailure(
            raw["kind"],
            paths.text(raw["text"]),
            span(raw.get("position")),
            tuple((s, text) for s, text in trail if s is not None),
        )
    called = answer.get("called", [])
    return ExpandedFile(
        failure,
        tuple(element(raw) for raw in answer.get("elements", ())),
        tuple(
            Macro(name, tuple(required), span(position), name in called)
            for name, required, position in answer.get("macros", ())
        ),
        tuple((paths.text(text), span(position)) for text, position in answer.get("warnings", ())),
        tuple(answer.get("unused", ())),
        tuple(answer.get("known", ())),
        tuple(answer.get("unused_env", ())),
        tuple(answer.get("known_env", ())),
        answer.get("packages", {}),
        paths,
        {paths.name(file): Path(file) for file in files},
    )
