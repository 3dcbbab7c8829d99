"""Module types by name, read once and kept.

A type's name is its folder's path under a library folder: ``drive/standard`` is
``<library>/drive/standard/module.yaml``.  The user's folders come before the
project's own, in the order given.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.suggest import did_you_mean

_PACKAGE = Path(__file__).resolve().parent.parent
FILE = "module.yaml"
PALETTE = "palette.yaml"
BUILTIN_LIBRARY = "<library>"  # how spans show the project's own library, wherever it is installed


@cache
def data_folder(name: str) -> Path:
    """Where ``modules`` or ``templates`` lie: the checkout's own, else the wheel's.

    An editable install may hold a stale copy, so the checkout comes first.
    """
    checkout = _PACKAGE.parent / name
    if (_PACKAGE.parent / "pyproject.toml").is_file() and checkout.is_dir():
        return checkout
    return _PACKAGE / "_data" / name


@dataclass(frozen=True, eq=False)
class ModuleType:
    """A module document that has passed the schema.

    ``folder`` is where its meshes lie, ``display`` the document's name in spans.
    ``elaborated`` keeps what the passes made of it, by its parameters' values.
    """

    name: str
    folder: Path
    display: str
    document: Node
    elaborated: dict[Any, Any] = field(default_factory=dict)

    @property
    def category(self) -> str:
        stated = self.document.get("category")
        return str(stated.value) if stated is not None else self.name.split("/")[0]

    def section(self, key: str) -> dict[str, Node]:
        """A mapping of the document, empty where it is left out."""
        node = self.document.get(key)
        return node.value if node is not None and isinstance(node.value, dict) else {}

    @property
    def is_assembly(self) -> bool:
        return self.document.get("modules") is not None


class _Loaded(NamedTuple):
    stamp: tuple[int, int]
    type: ModuleType | None
    report: Report


# By file and the name it is shown under; a file that changed is read again.
_loaded: dict[tuple[str, str], _Loaded] = {}
_palettes: dict[tuple[str, str], tuple[tuple[int, int], dict[str, str], Report]] = {}


def _load(name: str, path: Path, display: str, report: Report) -> ModuleType | None:
    status = path.stat()
    stamp = (status.st_mtime_ns, status.st_size)
    key = (str(path.absolute()), display)
    known = _loaded.get(key)
    if known is None or known.stamp != stamp:
        own = Report()
        document = read_file(path, display, own)
        good = document is not None and check(document, "module", own)
        module = None
        if document is not None and good and not own.has_errors:
            module = ModuleType(name, path.absolute().parent, display, document)
        known = _loaded[key] = _Loaded(stamp, module, own)
    report.extend(known.report)
    return known.type


class Library:
    """The library folders of one compilation, each with the name spans show for it."""

    def __init__(self, folders: Sequence[tuple[Path, str]] = ()) -> None:
        self.folders = [*folders, (data_folder("modules"), BUILTIN_LIBRARY)]
        self._found: dict[str, ModuleType | None] = {}
        self._files: dict[str, Path] = {}
        self._palette: dict[str, str] | None = None

    @property
    def files(self) -> dict[str, Path]:
        """The module documents read so far: name in spans to file."""
        return dict(self._files)

    def exists(self, name: str) -> bool:
        return any(os.path.isfile(folder / name / FILE) for folder, _ in self.folders)

    def load(self, name: str, asked: Node, report: Report) -> ModuleType | None:
        """The type of that name, or ``None`` with the reason in the report.

        ``asked`` is where the name stands.
        """
        if name in self._found:
            return self._found[name]
        module = None
        parts = name.split("/")
        safe = all(part and part not in (".", "..") for part in parts) and "\\" not in name
        for folder, display in self.folders if safe else ():
            path = folder / name / FILE
            if os.path.isfile(path):  # False also for what cannot be a path
                shown = f"{display}/{name}/{FILE}"
                self._files[shown] = path
                module = _load(name, path, shown, report)
                break
        else:
            report.add(
                "module-type-unknown",
                f"there is no module type `{name}`",
                asked.span,
                hint=did_you_mean(name, self.names()) or "`thorvaldc modules list` shows them",
            )
            return None
        self._found[name] = module
        return module

    def names(self) -> list[str]:
        """All type names, sorted."""
        return sorted({name for folder, _ in self.folders for name in self.names_in(folder)})

    def names_in(self, folder: Path) -> list[str]:
        """The types of one folder, sorted."""
        found = (Path(root) for root, _, files in os.walk(folder) if FILE in files)
        return sorted(root.relative_to(folder).as_posix() for root in found)

    def palette(self, report: Report | None = None) -> dict[str, str]:
        """Colour names of all library folders; the user's come before ours.

        Read at the first call, which reports what is wrong in them.
        """
        if self._palette is None:
            self._palette = {}
            found = Report() if report is None else report
            for folder, display in reversed(self.folders):
                path = folder / PALETTE
                if path.is_file():
                    shown = f"{display}/{PALETTE}"
                    self._files[shown] = path
                    self._palette.update(_read_palette(path, shown, found))
        return self._palette


def _read_palette(path: Path, display: str, report: Report) -> dict[str, str]:
    status = path.stat()
    stamp = (status.st_mtime_ns, status.st_size)
    key = (str(path.absolute()), display)
    known = _palettes.get(key)
    if known is None or known[0] != stamp:
        own = Report()
        known = _palettes[key] = (stamp, _colors(read_file(path, display, own), own), own)
    report.extend(known[2])
    return known[1]


def _colors(node: Node | None, report: Report) -> dict[str, str]:
    if node is None:
        return {}
    if not isinstance(node.value, dict):
        report.add("wrong-type", "a palette is a mapping of names to colours", node.span)
        return {}
    colors: dict[str, str] = {}
    for name, item in node.value.items():
        if isinstance(item.value, str):
            colors[name] = item.value
        else:
            report.add(
                "wrong-type", "a colour is text", item.span, hint='write it as in `"#9a9a9a"`'
            )
    return colors
