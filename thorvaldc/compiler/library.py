"""Finds and reads module types by name.

The name of a module type is the path of its folder under a library folder: ``drive/standard`` is
``<library>/drive/standard/module.yaml``.  The folders of the user are searched first, in their
order, then the built-in library.  Documents are cached per process until the file changes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.suggest import did_you_mean

Content = TypeVar("Content")

_PACKAGE = Path(__file__).resolve().parent.parent
FILE = "module.yaml"
PALETTE = "palette.yaml"
BUILTIN_LIBRARY = "<library>"  # the built-in library in spans, wherever it is installed


@cache
def data_folder(name: str) -> Path:
    """Returns the folder ``modules`` or ``templates``: of the checkout, else of the wheel.

    The checkout comes first because an editable install may contain a stale copy.
    """
    checkout = _PACKAGE.parent / name
    if (_PACKAGE.parent / "pyproject.toml").is_file() and checkout.is_dir():
        return checkout
    return _PACKAGE / "_data" / name


@dataclass(frozen=True, eq=False)
class ModuleType:
    """A module document that is valid against the schema.

    ``folder`` contains the document and its meshes; ``display`` is the document's name in spans.
    ``elaborated`` caches the hardware of the module by the values of its parameters.
    """

    name: str
    folder: Path
    display: str
    document: Node
    elaborated: dict[Any, Any] = field(default_factory=dict)

    @property
    def category(self) -> str:
        """The stated category, by default the first part of the name."""
        category = self.document.get("category")
        return str(category.value) if category is not None else self.name.split("/")[0]

    def section(self, key: str) -> dict[str, Node]:
        """Returns the entries of a mapping of the document; empty if it is missing."""
        node = self.document.get(key)
        return node.value if node is not None and isinstance(node.value, dict) else {}

    @property
    def is_assembly(self) -> bool:
        return self.document.get("modules") is not None


class _CachedFile(NamedTuple, Generic[Content]):
    """The content of a file, its diagnostics, and the time and size of the file."""

    stamp: tuple[int, int]
    content: Content
    report: Report


# By path and name in spans.
_module_cache: dict[tuple[str, str], _CachedFile[ModuleType | None]] = {}
_palette_cache: dict[tuple[str, str], _CachedFile[dict[str, str]]] = {}


def _read_cached(
    cache: dict[tuple[str, str], _CachedFile[Content]],
    path: Path,
    display: str,
    report: Report,
    read: Callable[[Node | None, Report], Content],
) -> Content:
    """Reads a YAML file by ``read``; repeats its diagnostics at every call."""
    status = path.stat()
    stamp = (status.st_mtime_ns, status.st_size)
    key = (str(path.absolute()), display)
    cached = cache.get(key)
    if cached is None or cached.stamp != stamp:
        file_report = Report()
        content = read(read_file(path, display, file_report), file_report)
        cached = cache[key] = _CachedFile(stamp, content, file_report)
    report.extend(cached.report)
    return cached.content


def _load_module(name: str, path: Path, display: str, report: Report) -> ModuleType | None:
    def read(document: Node | None, file_report: Report) -> ModuleType | None:
        if document is None or not check(document, "module", file_report):
            return None
        if file_report.has_errors:
            return None
        return ModuleType(name, path.absolute().parent, display, document)

    return _read_cached(_module_cache, path, display, report, read)


class Library:
    """The library folders of one compilation, each with its name in spans."""

    def __init__(self, folders: Sequence[tuple[Path, str]] = ()) -> None:
        self.folders = [*folders, (data_folder("modules"), BUILTIN_LIBRARY)]
        self._types: dict[str, ModuleType | None] = {}
        self._files: dict[str, Path] = {}
        self._palette: dict[str, str] | None = None

    @property
    def files(self) -> dict[str, Path]:
        """The documents that were read, by their names in spans."""
        return dict(self._files)

    def exists(self, name: str) -> bool:
        return any(os.path.isfile(folder / name / FILE) for folder, _ in self.folders)

    def load(self, name: str, node: Node, report: Report) -> ModuleType | None:
        """Returns the module type of a name, or ``None`` if it is unknown or invalid (reported).

        ``node`` is the name in the document.
        """
        if name in self._types:
            return self._types[name]
        parts = name.split("/")
        is_inside = all(part and part not in (".", "..") for part in parts) and "\\" not in name
        for folder, folder_display in self.folders if is_inside else ():
            path = folder / name / FILE
            if os.path.isfile(path):  # False also for names that cannot be a path.
                display = f"{folder_display}/{name}/{FILE}"
                self._files[display] = path
                module = _load_module(name, path, display, report)
                self._types[name] = module
                return module
        report.add(
            "module-type-unknown",
            f"there is no module type `{name}`",
            node.span,
            hint=did_you_mean(name, self.names()) or "`thorvaldc modules list` shows them",
        )
        return None

    def names(self) -> list[str]:
        """Returns the names of all module types, sorted."""
        return sorted({name for folder, _ in self.folders for name in self.names_in(folder)})

    def names_in(self, folder: Path) -> list[str]:
        """Returns the names of the module types in one folder, sorted."""
        folders = (Path(root) for root, _, files in os.walk(folder) if FILE in files)
        return sorted(path.relative_to(folder).as_posix() for path in folders)

    def palette(self, report: Report | None = None) -> dict[str, str]:
        """Returns the colours of all library folders by name; those of the user come first.

        The first call reads them and reports their errors.
        """
        if self._palette is None:
            self._palette = {}
            palette_report = Report() if report is None else report
            for folder, folder_display in reversed(self.folders):
                path = folder / PALETTE
                if path.is_file():
                    display = f"{folder_display}/{PALETTE}"
                    self._files[display] = path
                    colors = _read_cached(
                        _palette_cache, path, display, palette_report, _read_colors
                    )
                    self._palette.update(colors)
        return self._palette


def _read_colors(node: Node | None, report: Report) -> dict[str, str]:
    if node is None:
        return {}
    if not isinstance(node.value, dict):
        report.add("wrong-type", "expected a mapping of names to colours", node.span)
        return {}
    colors: dict[str, str] = {}
    for name, item in node.value.items():
        if isinstance(item.value, str):
            colors[name] = item.value
        else:
            report.add(
                "wrong-type",
                "expected a colour as text",
                item.span,
                hint='write it as in `"#9a9a9a"`',
            )
    return colors
