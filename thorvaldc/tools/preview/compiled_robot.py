"""Compiles a file again after each change, and describes the result for the page.

The page has two hosts: the server of ``thorvaldc preview``, and the web worker of the playground.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from thorvaldc.comparison.difference_text import difference_text
from thorvaldc.comparison.robot_comparison import compare_models
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.renderers import render_text
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.facts.fact_tables import fact_tables, overview
from thorvaldc.model.facts.robot_facts import robot_facts
from thorvaldc.model.plugins import data_folder
from thorvaldc.simulation.web_viewer import VIEWER, MeshCache, MeshData, page_data, viewer_script

MESHES = "meshes"
"""Folder of the meshes of a module, beside its file."""
INPUT_SUFFIXES = frozenset(
    (".yaml", ".yml", ".csv", ".xacro", ".urdf", ".stl", ".obj", ".dae", ".lock")
)
"""Suffixes of the files that a compilation can read."""
DIAGNOSTIC_WIDTH = 46
MAX_DIAGNOSTICS = 50

Signature = dict[str, tuple[int, int]]

SECTIONS = {
    "overview": "overview",
    **dict.fromkeys(("wheels", "stability", "slopes", "standing"), "checks"),
    **dict.fromkeys(("buses", "addresses", "wiring"), "wiring"),
}
"""Sections of the page for tables of facts; the section of the others is the last one."""
HOST = "/*HOST*/"
"""Placeholder in the template for the script that connects the page with its host."""
WORKBENCH = "<!--WORKBENCH-->"
"""Placeholder in the template for more of the page, before the picture."""


def robot_page(host: str, workbench: str = "") -> str:
    """Returns the HTML document of the page with the script and the workbench of its host."""
    template = data_folder("templates") / "preview" / "page.html"
    page = template.read_text(encoding="utf-8").replace(WORKBENCH, workbench, 1)
    return page.replace(HOST, host, 1).replace(VIEWER, viewer_script(), 1)


class CompiledRobot:
    """The newest compilation of a file, and the last one without errors.

    - ``version``: number of compilations.
    - ``model``: model of the last compilation without errors, or ``None``.
    - ``compilation``: the newest compilation, or ``None`` before the first one.
    - ``folders``: folders of the files that the newest compilation has read.
    """

    def __init__(self, path: Path, library: Sequence[Path], trust: bool) -> None:
        self.path = path
        self.version = 0
        self.model: Robot | Fleet | None = None
        self.compilation: Compilation | None = None
        self.folders: frozenset[str] = frozenset()
        self.is_good = False
        self._library, self._trust = library, trust
        self._before: Robot | Fleet | None = None
        self._data: dict[str, Any] | None = None
        self._keys: list[str] = []
        self._diagnostics: list[dict[str, Any]] = []
        self._hides_checks = False
        self._stages: dict[str, float] = {}
        self._meshes: MeshCache = {}
        self._signature: Signature = {}

    def has_changed(self) -> bool:
        """Returns whether a file in the watched folders has changed since the last compilation."""
        return _signature(self.folders) != self._signature

    def compile(self) -> None:
        """Compiles the file."""
        start = time.perf_counter()
        before = _signature(self.folders)
        compilation = compile_file(self.path, library=self._library, trust=self._trust)
        self.compilation = compilation
        folders = {os.path.dirname(os.path.realpath(self.path))}
        for path in compilation.sources.values():
            folder = os.path.dirname(os.path.realpath(path))
            folders |= {folder, os.path.join(folder, MESHES)}
        folders |= {os.path.realpath(folder) for folder in self._library}
        watched = frozenset(folder for folder in folders if os.path.isdir(folder))
        # A change during the compilation must be seen as a change after it.
        self._signature = before if watched == self.folders else _signature(watched)
        self.folders = watched
        compiled = time.perf_counter()
        self._diagnostics = _diagnostics(compilation, self.path.parent)
        self._hides_checks = compilation.report.hides_checks
        self.is_good = compilation.model is not None
        if compilation.model is not None:
            self._before, self.model = self.model, compilation.model
            self._data = page_data(self.model, self._meshes, compilation.ports)
            self._keys = [_key(mesh) for mesh in self._data["shapes"]]
        self.version += 1
        now = time.perf_counter()
        self._stages = {
            "compile": 1e3 * (compiled - start),
            "describe": 1e3 * (now - compiled),
        }

    def message(self, known: set[str]) -> dict[str, Any]:
        """Returns the message about the newest compilation for a page.

        - ``known``: keys of the meshes that the page has; the function adds the keys of the others.
        """
        model = None
        if self._data is not None:
            shapes: list[dict[str, Any]] = []
            for key, mesh in zip(self._keys, self._data["shapes"], strict=True):
                shapes.append({"key": key} if key in known else {"key": key, **mesh})
                known.add(key)
            model = {**self._data, "shapes": shapes}
        return {
            "kind": "model",
            "version": self.version,
            "good": self.is_good,
            "model": model,
            "diagnostics": self._diagnostics,
            "hides_checks": self._hides_checks,
            "can_drive": self.model is not None,
            "stages": self._stages,
        }

    def details(self) -> dict[str, Any]:
        """Returns the facts about the last model without errors, and what changed in it."""
        if isinstance(self.model, Fleet):
            robots = [(place.name, place.robot) for place in self.model.placements]
        else:
            robots = [] if self.model is None else [("", self.model)]
        tables = []
        for name, robot in robots:
            facts = robot_facts(robot)
            for table in (overview(facts), *fact_tables(facts)):
                section = SECTIONS.get(table.key, "more")
                title = ": ".join(filter(None, (name, table.title)))
                tables.append({**asdict(table), "section": section, "title": title})
        difference = None
        if self._before is not None and self.model is not None:
            difference = compare_models(self._before, self.model)
        text = ""
        if difference is not None and not difference.is_equal:
            text = difference_text(difference, DIAGNOSTIC_WIDTH)
        return {"kind": "details", "tables": tables, "difference": text}


def _key(mesh: MeshData) -> str:
    return hashlib.sha256(f"{mesh['points']} {mesh['faces']}".encode()).hexdigest()[:20]


def _diagnostics(compilation: Compilation, folder: Path) -> list[dict[str, Any]]:
    items = []
    for diagnostic in compilation.report.sorted()[:MAX_DIAGNOSTICS]:
        single = Report()
        single.put(replace(diagnostic, hint=None))
        text = render_text(single, compilation.sources, width=DIAGNOSTIC_WIDTH)
        span = diagnostic.span
        items.append(
            {
                "severity": diagnostic.severity.name.lower(),
                "code": diagnostic.code.number,
                "message": diagnostic.message,
                "place": "" if span is None else f"{os.path.basename(span.file)}:{span.line}",
                "span": None if span is None else _span(span, compilation, folder),
                "text": text.partition("\n")[2].strip("\n"),  # the excerpt
                "hint": diagnostic.hint or "",
                "fixes": [
                    {"span": _span(fix.span, compilation, folder), "text": fix.text}
                    for fix in diagnostic.fixes
                ],
            }
        )
    return items


def _span(span: Span, compilation: Compilation, folder: Path) -> dict[str, Any]:
    """Returns a source span with the path of its file relative to the folder of the robot."""
    path = os.path.relpath(compilation.sources.get(span.file, folder / span.file), folder)
    return {
        "file": path.replace(os.sep, "/"),
        "start": [span.line, span.column],
        "end": [span.end_line, span.end_column],
    }


def _signature(folders: frozenset[str]) -> Signature:
    """Returns the time of change (ns) and the size of each input file in the folders."""
    signature: Signature = {}
    for folder in folders:
        try:
            entries = list(os.scandir(folder))
        except OSError:
            continue
        for entry in entries:
            if os.path.splitext(entry.name)[1].lower() in INPUT_SUFFIXES:
                try:
                    status = entry.stat()
                except OSError:
                    continue
                signature[entry.path] = (status.st_mtime_ns, status.st_size)
    return signature
