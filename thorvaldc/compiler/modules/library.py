"""Finds and reads module types by name.

The name of a module type is the path of a folder inside a library folder.  For example, the module
type ``drive/standard`` is in the file ``<library>/drive/standard/module.yaml``.  The library
folders of the user are searched first, in the order of the command line or document.  The built-in
library of module types is searched last.  A process reads a module file again only if the file has
changed.
"""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from thorvaldc.compiler.source.input_file import (
    check_no_link_outside,
    report_missing,
    unsaved_text,
)
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check
from thorvaldc.diagnostics import Report, Span, did_you_mean
from thorvaldc.model.plugins import data_folder

Content = TypeVar("Content")

FILE = "module.yaml"
PALETTE = "palette.yaml"
MAX_FOLDERS = 10_000
"""Greatest number of folders that are searched for module types in a library folder."""
# Diagnostics show the name ``<library>`` instead of the path of the built-in library.
BUILTIN_LIBRARY = "<library>"


@dataclass(frozen=True, eq=False)
class ModuleType:
    """A module type with the module document, which is valid against the schema.

    Attributes
    ----------
    name : name of the module type, for example ``drive/standard``.
    folder : folder of the module file and its meshes.
    display : name of the module file in spans.
    document : YAML tree of the module file.
    elaborated : cache of the hardware of the module, by the values of the parameters.
    """

    name: str
    folder: Path
    display: str
    document: Node
    # A copy with another document (`replace`) has a cache of its own.
    elaborated: dict[Any, Any] = field(default_factory=dict, init=False)

    @property
    def category(self) -> str:
        """Category of the module type, such as ``drive`` for ``drive/standard``.

        The default category is the first part of the name of the module type.
        """
        category = self.document.get("category")
        return str(category.value) if category is not None else self.name.split("/")[0]

    @property
    def description(self) -> str:
        """Description of the module type in one line, or an empty text."""
        node = self.document.get("description")
        return " ".join(str(node.value).split()) if node is not None else ""

    @property
    def summary(self) -> str:
        """First sentence of the description."""
        return self.description.split(". ")[0].rstrip(".") + "."

    @property
    def library_folder(self) -> Path:
        """Folder to which the name of the module type is relative."""
        return self.folder.parents[self.name.count("/")]

    @property
    def library_display(self) -> str:
        """Name of the library folder in spans."""
        return self.display.removesuffix(f"/{self.name}/{FILE}")

    def section(self, key: str) -> dict[str, Node]:
        """Returns the entries of a section of the module document, or ``{}`` if the document has no
        such section.
        """
        node = self.document.get(key)
        return node.value if node is not None and isinstance(node.value, dict) else {}

    @property
    def is_assembly(self) -> bool:
        """True if the module type consists of other modules."""
        return self.document.get("modules") is not None


class _CachedFile(NamedTuple, Generic[Content]):
    """Cached content of a library file, with the diagnostics of reading the file.

    ``stamp`` contains the modification time (ns) and the size of the library file, or its unsaved
    content.
    """

    stamp: tuple[int, int] | bytes
    content: Content
    report: Report


# The key of both caches contains the path of a library file and the name of the file in
# diagnostics.
_module_cache: dict[tuple[str, str], _CachedFile[ModuleType | None]] = {}
_palette_cache: dict[tuple[str, str], _CachedFile[dict[str, str]]] = {}


def forget_modules() -> None:
    """Empties the caches: the next compilation reads all files of the library again."""
    _module_cache.clear()
    _palette_cache.clear()


def _read_cached(
    cache: dict[tuple[str, str], _CachedFile[Content]],
    path: Path,
    display: str,
    report: Report,
    read: Callable[[Node | None, Report], Content],
) -> Content:
    """Reads a YAML file with the function ``read``, or returns the cached content of the file.

    Every call adds the diagnostics of the YAML file to ``report``.
    """
    stamp: tuple[int, int] | bytes | None = unsaved_text(path)
    if stamp is None:
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
    """Reads a module file.

    Returns ``None`` and reports the errors if the module file is not valid.
    """

    def read(document: Node | None, file_report: Report) -> ModuleType | None:
        if document is None or not check(document, "module", file_report):
            return None
        if file_report.has_errors:
            return None
        return ModuleType(name, path.absolute().parent, display, document)

    return _read_cached(_module_cache, path, display, report, read)


def _is_in_library(
    path: Path, folder: Path, display: str, report: Report, span: Span | None = None
) -> bool:
    """Returns whether a file is in its library folder after its links, and reports an error if not.

    The built-in library comes with this program, and some installations of it consist of links.
    """
    is_builtin = display.startswith(BUILTIN_LIBRARY)
    return is_builtin or check_no_link_outside(path, folder, display, report, span)


class Library:
    """The library folders of one compilation.

    - ``folders``: the path of each library folder, and the name of the folder in diagnostics;
    - ``base_dir``: folder of the document, for the hint about a library that it does not name.
    """

    def __init__(
        self, folders: Sequence[tuple[Path, str]] = (), base_dir: Path | None = None
    ) -> None:
        self._base_dir = base_dir
        self.folders = [*folders, (data_folder("modules"), BUILTIN_LIBRARY)]
        self._types: dict[str, ModuleType | None] = {}
        self._names: list[str] | None = None
        self._hints: dict[str, str | None] = {}
        self._files: dict[str, Path] = {}
        self._palette: dict[str, str] | None = None

    @property
    def files(self) -> dict[str, Path]:
        """Path of each library file that was read, by the name of the file in diagnostics."""
        return dict(self._files)

    def file_beside(
        self, module: ModuleType, named: Node, suffixes: Sequence[str], report: Report
    ) -> tuple[Path, str] | None:
        """Returns the path of a file beside a module document, and its name in diagnostics.

        Reports a missing file and a link out of the library.  The file is one of ``files`` then.

        - ``named``: YAML node with the name of the file.
        - ``suffixes``: name suffixes of such files, without the dot.
        """
        path = self._files[module.display].parent / str(named.value)
        display = f"{module.display.removesuffix(FILE)}{named.value}"
        if not path.is_file():
            report_missing("file-not-found", module.folder, named, suffixes, report)
            return None
        if not _is_in_library(path, module.library_folder, display, report, named.span):
            return None
        self._files[display] = path
        return path, display

    def user_modules(self) -> list[ModuleType]:
        """Returns the module types that were loaded from the folders of the user."""
        loaded = [module for module in self._types.values() if module is not None]
        return [module for module in loaded if not module.display.startswith(BUILTIN_LIBRARY)]

    def exists(self, name: str) -> bool:
        """Returns whether a library folder contains a module type with the name ``name``."""
        return any(os.path.isfile(folder / name / FILE) for folder, _ in self.folders)

    def load(self, name: str, node: Node, report: Report) -> ModuleType | None:
        """Reads the module type with the name ``name``.

        Returns ``None`` and reports an error if the module type is unknown or not valid.  ``node``:
        YAML node that contains the name of the module type.  Errors are reported at the source span
        of ``node``.
        """
        if name in self._types:
            return self._types[name]
        parts = name.split("/")
        is_inside = all(part and part not in (".", "..") for part in parts) and "\\" not in name
        for folder, folder_display in self.folders if is_inside else ():
            path = folder / name / FILE
            # The function `isfile` returns false for a text that is not a valid path.
            if os.path.isfile(path):
                display = f"{folder_display}/{name}/{FILE}"
                module = None
                # Diagnostics show lines of the files in `files`.
                if _is_in_library(path, folder, display, report):
                    self._files[display] = path
                    module = _load_module(name, path, display, report)
                self._types[name] = module
                return module
        report.add(
            "module-type-unknown",
            f"there is no module type `{name}`",
            node.span,
            hint=(self._misnamed_file(name) or self._unnamed_library(name) if is_inside else None)
            or self._near_type(name)
            or "`thorvaldc modules list` shows them",
        )
        return None

    def _misnamed_file(self, name: str) -> str | None:
        """Returns the hint to rename a file such as ``Module.yaml`` or ``module.yml``."""
        for folder, display in self.folders:
            with contextlib.suppress(OSError, ValueError):
                for file in sorted(os.listdir(folder / name)):
                    if file.lower() in (FILE, "module.yml"):
                        return f"rename `{display}/{name}/{file}` to `{FILE}`"
        return None

    def _unnamed_library(self, name: str) -> str | None:
        """Returns the hint about a folder ``modules`` beside the document, if it has the type."""
        file = f"modules/{name}/{FILE}"
        if self._base_dir is None or not os.path.isfile(self._base_dir / file):
            return None
        return f"`library: [modules]` in this file adds {file}"

    def _near_type(self, name: str) -> str | None:
        """Returns the hint with the module types whose names are near ``name``.

        A file with thousands of wrong names would search the folders as often.
        """
        if self._names is None:
            self._names = self.names()
        if name not in self._hints:
            self._hints[name] = did_you_mean(name, self._names)
        return self._hints[name]

    def names(self) -> list[str]:
        """Returns the sorted names of the module types in all library folders."""
        return sorted({name for folder, _ in self.folders for name in self.names_in(folder)})

    def names_in(self, folder: Path) -> list[str]:
        """Returns the sorted names of the module types in one library folder.

        At most ``MAX_FOLDERS`` folders are searched: a document may name the folder ``/`` by
        mistake.
        """
        walk = itertools.islice(os.walk(folder), MAX_FOLDERS)
        folders = (Path(root) for root, _, files in walk if FILE in files)
        return sorted(path.relative_to(folder).as_posix() for path in folders)

    def palette(self, report: Report | None = None) -> dict[str, str]:
        """Returns the colours of the palette files of all library folders, by name.

        A colour in a library folder of the user replaces a built-in colour of the same name.  The
        palette files are read in the first call, which also reports the errors in the palette
        files.
        """
        if self._palette is None:
            self._palette = {}
            palette_report = Report() if report is None else report
            for folder, folder_display in reversed(self.folders):
                path = folder / PALETTE
                if path.is_file():
                    display = f"{folder_display}/{PALETTE}"
                    if not _is_in_library(path, folder, display, palette_report):
                        continue
                    self._files[display] = path
                    colors = _read_cached(
                        _palette_cache, path, display, palette_report, _read_colors
                    )
                    self._palette.update(colors)
        return self._palette


def module_library(path: Path, folders: tuple[Path, ...]) -> tuple[str, Library]:
    """Returns the name of the module type in a module file, and a library with its folder.

    The folder is the one of ``folders`` that contains the file.  Without such a folder, the name of
    the type has two parts, such as ``drive/standard``.
    """
    own = next(
        (folder for folder in folders if path.is_relative_to(folder)), path.parent.parent.parent
    )
    others = [folder for folder in folders if folder != own]
    name = path.parent.relative_to(own).as_posix()
    return name, Library([(folder, str(folder)) for folder in (own, *others)])


def _read_colors(node: Node | None, report: Report) -> dict[str, str]:
    """Reads the colours of a palette file, by name.  Colours with errors are left out."""
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
