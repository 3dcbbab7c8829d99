"""The compiler and the simulated robot behind the page of the playground, in a web worker.

The worker gives each message of the page to ``Playground.receive``, and the messages of
``Playground`` to the page, both as JSON texts.  A page that sends

- ``open``: ``files`` (text, or bytes in base64 as a list of one text) by path, and ``main``
- ``edit``: ``files``, new texts by path
- ``drawn``: the robot is on the screen, so that there is time for the facts about it
- ``drive``, ``motion``: as the page of ``thorvaldc preview``
- ``complete``: ``file``, ``text`` and ``offset`` (in characters) of the cursor
- ``places``: ``type`` of a module and the ``kinds`` of ports that it fits
- ``mount``: ``text`` of the robot file, ``type`` and ``mount``
- ``build``: ``targets``;  ``file``: ``path`` of a built file;  ``archive``: all of them

receives ``model``, ``details``, ``state`` and ``drive`` as from ``thorvaldc preview``, and
``proposals``, ``places``, ``insertion``, ``files``, ``file`` and ``archive`` with the ``id`` of the
request.
"""

from __future__ import annotations

import base64
import io
import json
import os
import shutil
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from thorvaldc import __version__
from thorvaldc.comparison.robot_comparison import compare_models
from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.compiler.output.writer import MANIFEST, manifest
from thorvaldc.compiler.pipeline import emit
from thorvaldc.compiler.source.reader import read_text
from thorvaldc.compiler.validation.document_check import check, kind_of
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.diagnostics.files import read_json
from thorvaldc.model import Fleet, Robot
from thorvaldc.tools.language_server import code_completion, open_document
from thorvaldc.tools.language_server.cursor import cursor_at
from thorvaldc.tools.language_server.module_view import ModuleView
from thorvaldc.tools.preview.compiled_robot import CompiledRobot
from thorvaldc.tools.preview.page_drive import PageDrive

Message = dict[str, Any]
DATE = (1980, 1, 1, 0, 0, 0)
"""Date of the files in an archive: the outputs of a build have none."""


class Playground:
    """The robot of a page.

    - ``send``: receives the messages for the page.
    - ``folder``: folder for the files of the page, which ``open`` empties.  Diagnostics show paths
      with it.
    """

    def __init__(self, send: Callable[[str], None], folder: Path) -> None:
        self._send_text = send
        self._folder = folder
        self._compiled = CompiledRobot(folder / "robot.yaml", (), False)
        self._known: set[str] = set()
        self._drive: PageDrive | None = None
        self._driven: Robot | Fleet | None = None
        self._driven_name = ""
        self._files: dict[str, bytes] = {}
        self._manifest: dict[str, bytes] = {}
        self._is_warm = False
        self._handlers: dict[str, Callable[[Message], Message | None]] = {
            "open": self._open,
            "edit": self._edit,
            "drawn": self._describe,
            "drive": self._switch_drive,
            "motion": self._move,
            "complete": self._complete,
            "places": self._places,
            "mount": self._mount,
            "build": self._build,
            "file": self._file,
            "archive": self._archive,
        }

    def receive(self, text: str) -> None:
        """Answers a message of the page."""
        message = read_json(text)
        answer = self._handlers[message["kind"]](message)
        if answer is not None:
            self._send({**answer, "id": message["id"]})

    def advance(self) -> bool:
        """Runs the due cycles of the robot that the page drives, and returns whether it drives."""
        if self._drive is not None and not self._drive.advance():
            self._drive = None
        return self._drive is not None

    def _send(self, message: Message) -> None:
        self._send_text(json.dumps(message, separators=(",", ":")))

    # -- the robot ---------------------------------------------------------------------

    def _open(self, message: Message) -> None:
        self._end_drive()
        for path in self._folder.glob("*"):
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
        self._write(message["files"])
        version = self._compiled.version
        self._compiled = CompiledRobot(self._path(message["main"]), (), False)
        self._compiled.version = version  # the page counts on
        self._compile()

    def _edit(self, message: Message) -> None:
        self._write(message["files"])
        self._compile()

    def _write(self, files: Message) -> None:
        for name, content in files.items():
            path = self._path(name)
            path.parent.mkdir(parents=True, exist_ok=True)
            is_text = isinstance(content, str)
            path.write_bytes(content.encode() if is_text else base64.b64decode(content[0]))

    def _path(self, name: str) -> Path:
        relative = os.path.normpath(name)
        if os.path.isabs(relative) or relative.split(os.sep)[0] == "..":
            raise ValueError(f"{name} is outside of the folder of the robot")
        return self._folder / relative

    def _compile(self) -> None:
        self._compiled.compile()
        self._files, self._manifest = {}, {}
        self.advance()
        self._send(self._compiled.message(self._known))
        self.advance()
        if self._compiled.is_good and self._drive is not None:
            self._follow_change()

    def _describe(self, message: Message) -> None:
        if self._compiled.is_good:
            self._send(self._compiled.details())
        if not self._is_warm:
            # The first wrong key would wait until jsonschema is imported.
            self._is_warm = True
            tree = read_text(b"thorvaldc: 1\nx: 1\n", "robot.yaml", Report())
            if tree is not None:
                check(tree, "robot", Report())

    # -- driving -----------------------------------------------------------------------

    def _follow_change(self) -> None:
        """Drives the changed robot; the drive of an equal one goes on."""
        model = self._compiled.model
        if self._driven is not None and model is not None:
            difference = compare_models(self._driven, model)
            if difference is not None and difference.is_equal:
                return
            self._end_drive()
            self._begin_drive(self._driven_name)

    def _move(self, message: Message) -> None:
        if self._drive is not None:
            self._drive.move(*(float(message[name]) for name in ("x", "y", "yaw")))

    def _switch_drive(self, message: Message) -> None:
        if not message["on"]:
            self._end_drive()
        elif self._drive is None:
            self._begin_drive(message["robot"])

    def _begin_drive(self, name: str) -> None:
        if self._compiled.model is not None:
            self._driven, self._driven_name = self._compiled.model, name
            self._drive = PageDrive(self._driven, name, self._send)
            self.advance()

    def _end_drive(self) -> None:
        if self._drive is not None:
            self._drive.close()
            self.advance()

    # -- the editor --------------------------------------------------------------------

    def _complete(self, message: Message) -> Message:
        text, offset = message["text"], message["offset"]
        path = self._path(message["file"])
        source = open_document.SourceText(text)
        cursor = cursor_at(text, offset)
        tree = code_completion.tree_around(source, cursor, offset, str(path))
        view = ModuleView(kind_of(text, path.name) or "robot", path, tree, ())
        models = {} if self._compiled.model is None else {str(path): self._compiled.model}
        return {
            "kind": "proposals",
            "start": cursor.start,
            "proposals": [
                {
                    "label": proposal.label,
                    "text": proposal.text,
                    "start": proposal.start,
                    "detail": proposal.detail,
                    "documentation": proposal.documentation,
                    "is_snippet": proposal.is_snippet,
                }
                for proposal in code_completion.proposals_at(view, cursor, models)
            ],
        }

    # -- modules -----------------------------------------------------------------------

    def _places(self, message: Message) -> Message:
        kinds = set(message["kinds"])
        model, places = self._compiled.model, []
        compilation = self._compiled.compilation
        if isinstance(model, Robot) and compilation is not None:
            places += [
                {"text": port.name, "mount": port.name}
                for port in compilation.ports(model)
                if port.kind in kinds and not port.carries
            ]
            for carrier in _free_carriers(compilation.instances[model.span.file]):
                mount = f"{{parent: {carrier}, xyz: [0, 0, 0]}}"
                places.append({"text": f"{carrier}, at a pose", "mount": mount})
        return {"kind": "places", "places": places}

    def _mount(self, message: Message) -> Message:
        text, type_name = message["text"], message["type"]
        return {"kind": "insertion", **insertion(text, type_name, message["mount"])}

    # -- the outputs -------------------------------------------------------------------

    def _build(self, message: Message) -> Message:
        report, error = Report(), ""
        self._files, self._manifest = {}, {}
        model, compilation = self._compiled.model, self._compiled.compilation
        if model is not None:
            try:
                self._files = emit(model, message["targets"], report)
            except DiagnosticError as raised:
                error = str(raised)
        if self._files and self._compiled.is_good and model is not None and compilation is not None:
            data = manifest(
                self._files,
                name=model.name,
                source_sha256=compilation.source_sha256,
                version=__version__,
            )
            self._manifest = {MANIFEST: data}
        return {
            "kind": "files",
            "error": error,
            "warnings": [diagnostic.message for diagnostic in report.sorted()],
            "files": [
                {"path": path, "bytes": len(self._files[path])}
                for path in sorted(self._files, key=lambda path: ("meshes/" in path, path))
            ],
        }

    def _file(self, message: Message) -> Message:
        data = self._files[message["path"]]
        try:
            return {"kind": "file", "text": data.decode()}
        except UnicodeDecodeError:
            return {"kind": "file", "base64": base64.b64encode(data).decode()}

    def _archive(self, message: Message) -> Message:
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for path, data in sorted((self._files | self._manifest).items()):
                archive.writestr(zipfile.ZipInfo(path, DATE), data, zipfile.ZIP_DEFLATED)
        return {"kind": "archive", "base64": base64.b64encode(stream.getvalue()).decode()}


def _free_carriers(instance: Instance, prefix: str = "") -> Iterator[str]:
    """Yields the paths of the modules that carry others at any pose."""
    for name, child in instance.children.items():
        if child.type is not None and child.type.document.get("free_mount") is not None:
            yield f"{prefix}{name}"
        if child.children:
            yield from _free_carriers(child, f"{prefix}{name}.")


def insertion(text: str, type_name: str, mount: str) -> Message:
    """Returns the text that adds a module to a robot file, and its ``offset`` (in characters).

    - ``mount``: value of the key `mount`, or empty for a module without one.

    The name of the module is the last part of its type, with a number if it is in use.  Without a
    section `modules` that could be read, the text is empty and ``reason`` says why.
    """
    tree = read_text(text.encode(), "robot.yaml", Report())
    modules = tree.get("modules") if tree is not None else None
    if tree is None or modules is None or not entries(modules):
        return {"text": "", "offset": 0, "reason": "the file has no section `modules` to add to"}
    names = entries(modules)
    stem = name = type_name.rpartition("/")[2]
    number = 2
    while name in names:
        name, number = f"{stem}_{number}", number + 1
    line = f"{name}: {{type: {type_name}{f', mount: {mount}' if mount else ''}}}"
    source = open_document.SourceText(text)
    start = source.offset_of(modules.span.line, modules.span.column)
    if text[start : start + 1] == "{":
        return {"text": f"{line}, ", "offset": start + 1}
    spans = [node.where for node in names.values()]
    last = max(span.line for span in spans)
    indent = min(span.column for span in spans) - 1
    end = last  # number of lines up to the end of the last module
    for number, content in enumerate(source.lines[last:], last + 1):
        words = content.strip()
        if words and not words.startswith("#") and len(content) - len(content.lstrip()) <= indent:
            break
        end = number if words and not words.startswith("#") else end
    before = "".join(source.lines[:end])
    new_line = "" if before.endswith("\n") else "\n"
    return {"text": f"{new_line}{' ' * indent}{line}\n", "offset": len(before)}
