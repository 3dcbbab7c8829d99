"""Compiles one robot many times, each time with some values of its documents changed."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

from thorvaldc.compiler.elaborate import elaborate
from thorvaldc.compiler.extras.xacro_expand import remembered_expansions
from thorvaldc.compiler.modules.library import Library, ModuleType
from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.pipeline import library_folders_of, read_robot_lock
from thorvaldc.compiler.result import Compilation, SourceFile
from thorvaldc.compiler.robot_settings.robot_sections import read_design
from thorvaldc.compiler.shapes.meshes import shared_mesh_workers
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.diagnostics import Diagnostic, Report
from thorvaldc.model import Robot
from thorvaldc.tools.provenance.source_values import Key, SourceValue, source_values, with_values

Changes = Mapping[SourceValue, Any]
"""New values of nodes."""


class _ChangedLibrary(Library):
    """A library in which documents of module types have changed values."""

    def __init__(
        self,
        folders: Sequence[tuple[Path, str]],
        changes: Mapping[str, list[tuple[tuple[Key, ...], Any]]],
    ) -> None:
        super().__init__(folders)
        self._changes = changes
        self._changed: dict[str, ModuleType] = {}

    def load(self, name: str, node: Node, report: Report) -> ModuleType | None:
        if name in self._changed:
            return self._changed[name]
        module = super().load(name, node, report)
        if module is None or module.display not in self._changes:
            return module
        document = with_values(module.document, self._changes[module.display])
        # The cache of the module type belongs to the values of the file.
        self._changed[name] = replace(module, document=document, elaborated={})
        return self._changed[name]


class RobotProbe:
    """One robot file, compiled with changed values.

    The stages after the reading of the files are those of ``compile_robot``; the checks of the
    finished model are left out, because they change nothing in it.

    Parameters
    ----------
    path : path of the robot file, which has no errors.
    library : additional folders with modules.
    trust : whether xacro files are expanded without restrictions.
    on_compilation : called with the number of compilations, for a display of the progress.
    stack : temporary files and worker processes end when the stack is closed.
    """

    def __init__(self, path: Path, library: Sequence[Path], trust: bool, stack: ExitStack) -> None:
        stack.enter_context(shared_mesh_workers())
        stack.enter_context(remembered_expansions())
        self.path = path
        self.trust = trust
        self.count = 0
        self.on_compilation: Callable[[int], None] = lambda count: None
        self.source = SourceFile(path, path.name, path.parent)
        document = self.source.document
        assert document is not None, "the file was compiled before"
        self.document = self.source.check_shape(document)
        report = Report()
        self.folders = library_folders_of(self.document, path.parent, library, report)
        self._lock = read_robot_lock(self.source, Compilation.of(self.source), report)
        self._temporary = stack.enter_context(tempfile.TemporaryDirectory(prefix="thorvaldc-why-"))

    @cached_property
    def instances(self) -> Instance:
        """The tree of module instances without changes."""
        return Resolver(Library(self.folders), Report()).resolve(self.document)

    @cached_property
    def documents(self) -> dict[str, Node]:
        """The documents of the robot by their name in spans: robot file, calibration, modules."""
        library = Library(self.folders)
        used: dict[str, Node] = {self.source.name: self.document}
        calibration = self._calibration()
        if calibration is not None:
            used[str(self._calibration_name())] = calibration
        Resolver(library, Report()).resolve(self.document)
        for name in library.names():
            module = library._types.get(name)
            if module is not None:
                used[module.display] = module.document
        return used

    def values(self) -> list[SourceValue]:
        """Returns the numbers and expressions of all documents, in the order of the documents."""
        return [value for document in self.documents.values() for value in source_values(document)]

    def compile(self, changes: Changes) -> tuple[Robot | None, list[Diagnostic]]:
        """Compiles the robot with changed values.

        Returns the model, or ``None`` and the errors.
        """
        self.count += 1
        self.on_compilation(self.count)
        by_file: dict[str, list[tuple[tuple[Key, ...], Any]]] = {}
        for value, new in changes.items():
            by_file.setdefault(value.span.file, []).append((value.keys, new))
        document = with_values(self.document, by_file.get(self.source.name, ()))
        calibration = self._calibration_name()
        if calibration in by_file:
            document = self._with_calibration(document, by_file[str(calibration)])
        report = Report()
        resolver = Resolver(_ChangedLibrary(self.folders, by_file), report)
        robot = elaborate(
            document,
            resolver.resolve(document),
            resolver,
            self.path.parent,
            report,
            {},
            lock=self._lock,
            trust=self.trust,
        )
        design = read_design(document, report)
        if report.has_errors or robot is None:
            return None, report.errors
        return replace(robot, design_slope=design.slope), []

    def _calibration_name(self) -> str | None:
        node = self.document.get("calibration")
        return str(node.value) if node is not None else None

    def _calibration(self) -> Node | None:
        name = self._calibration_name()
        return read_file(self.path.parent / name, name, Report()) if name is not None else None

    def _with_calibration(
        self, document: Node, values: Iterable[tuple[tuple[Key, ...], Any]]
    ) -> Node:
        """Writes the calibration with changed values, and returns the robot document with it."""
        root = self._calibration()
        assert root is not None
        import yaml

        path = Path(self._temporary) / "calibration.yaml"
        text = yaml.safe_dump(with_values(root, values).plain(), sort_keys=False)
        path.write_text(text, encoding="utf-8")
        return with_values(document, [(("calibration",), str(path))])
