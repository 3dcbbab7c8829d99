"""The pages of libraries of modules: one page for each category, with a picture of each module.

The site has the library of this project, those of the examples, and the folders in the variable
``LIBRARIES``.  In these, the picture of a module is the file ``picture.png`` in its folder.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

from thorvaldc.compiler.modules.library import Library, ModuleType
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, Span

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "docs" / "assets" / "modules"
ADDRESS = "reference/modules"


def pages() -> dict[str, str | Path]:
    """Returns the texts and the pictures by their addresses."""
    folders = [*sorted(ROOT.glob("examples/**/modules")), *map(Path, LIBRARIES.split())]
    galleries = {name_of(folder): gallery(folder, name_of(folder)) for folder in folders}
    head = "[How modules connect, and where the numbers come from](../../modules/README.md)."
    links = [f"[{name}]({name}/README.md)" for name in galleries]
    head += f" Other libraries: {', '.join(links)}."
    texts = gallery(ROOT / "modules", "", f"# The hardware library\n\n{head}")
    for others in galleries.values():
        texts |= others
    return texts


LIBRARIES = os.environ.get("LIBRARIES", "")


def name_of(folder: Path) -> str:
    """Returns the name of a library: that of the folder around ``modules``."""
    folder = folder.resolve()
    return (folder.parent if folder.name == "modules" else folder).name


def gallery(folder: Path, name: str, head: str = "") -> dict[str, str | Path]:
    """Returns the pages of a library, and the pictures beside its modules."""
    library, report = Library([(folder, folder.name)]), Report()
    names = sorted(library.names_in(folder))
    found = [library.load(each, Node(each, Span("site")), report) for each in names]
    if report.has_errors:
        raise SystemExit("\n".join(f"{d.span}: {d.message}" for d in report))
    modules = [module for module in found if module is not None]
    place = f"{ADDRESS}/{name}".rstrip("/")
    texts: dict[str, str | Path] = {}
    texts[f"{place}/README.md"] = index(modules, head or f"# Modules of {name}")
    for category, group in groupby(modules, key=lambda module: module.name.split("/")[0]):
        texts[f"{place}/{category}.md"] = page(category, list(group))
    for module in modules if name else ():
        if (file := beside(module)).is_file():
            texts[f"{place}/{file_name(module)}"] = file
    return texts


def beside(module: ModuleType) -> Path:
    return module.folder / "picture.png"


def file_name(module: ModuleType) -> str:
    return f"{module.name.replace('/', '_')}.png"


def index(modules: list[ModuleType], head: str) -> str:
    lines = [head, "", "| module | what it is | picture |", "| --- | --- | --- |"]
    for module in modules:
        category, name = module.name.split("/")
        link = f"[{module.name}]({category}.md#{name})"
        lines.append(f"| {link} | {description(module)} | {picture(module, 120)} |")
    return "\n".join(lines) + "\n"


def page(category: str, modules: list[ModuleType]) -> str:
    lines = [f"# Modules: {category}"]
    for module in modules:
        lines += section(module)
    return "\n".join(lines) + "\n"


def section(module: ModuleType) -> Iterator[str]:
    document: dict[str, Any] = module.document.plain()
    yield from ("", f"## {module.name.split('/')[1]}", "", description(module), "")
    yield from (picture(module, 360), "")
    yield f"- Type: `{module.name}`"
    if kinds := (document.get("mount") or {}).get("kinds"):
        yield "- Mounts on: " + ", ".join(f"`{kind}`" for kind in kinds)
    if ports := document.get("ports"):
        yield "- Ports: " + "; ".join(port(name, value) for name, value in ports.items())
    for key in ("modules", "motors", "channels"):
        if document.get(key):
            yield f"- {key.capitalize()}: " + ", ".join(f"`{name}`" for name in document[key])
    yield from table(
        ("parameter", "value", "default", "meaning", "source"),
        [parameter(name, value) for name, value in document.get("params", {}).items()],
    )
    yield from table(("part of the mass", "mass", "source"), list(masses(document)))
    yield from table(("motor", "numbers", "source"), list(motors(document)))
    yield from table(
        ("frame on the bus", "identifier", "direction", "what it is"), frames(document)
    )


def description(module: ModuleType) -> str:
    return " ".join(str(module.document.plain().get("description", "")).split())


def picture(module: ModuleType, width: int) -> str:
    link = file_name(module)
    if module.folder.is_relative_to(ROOT / "modules"):
        link = f"../../assets/modules/{link}"
        if not (PICTURES / file_name(module)).is_file():
            return ""
    elif not beside(module).is_file():
        return ""
    return f"![The module {module.name}]({link}){{ width={width} }}"


def port(name: str, value: Any) -> str:
    if not isinstance(value, dict):  # the port of a part of an assembly
        return f"`{name}` (that of `{value}`)"
    position = ", ".join(map(str, value.get("xyz", [0, 0, 0])))
    return f"`{name}` ({value['kind']}, on `{value['link']}` at `{position}`)"


def as_yaml(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def parameter(name: str, value: dict[str, Any]) -> tuple[str, ...]:
    kind = str(value.get("quantity") or value.get("type") or "number").replace("_", " ")
    limits = [f"from {value['minimum']}"] if "minimum" in value else []
    limits += [f"to {value['maximum']}"] if "maximum" in value else []
    limits += [", ".join(map(str, value["choices"]))] if "choices" in value else []
    default = f"`{as_yaml(value['default'])}`" if "default" in value else "required"
    text = str(value.get("description", ""))
    return f"`{name}`", ", ".join([kind, *limits]), default, text, str(value.get("source", ""))


def masses(document: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    for link, value in (document.get("links") or {}).items():
        for part in (value or {}).get("parts", []):
            if "mass" in part:
                shape = next(iter(part.get("shape", {})), "point")
                yield f"`{link}`, {shape}", f"`{part['mass']}`", str(part.get("source", ""))


def motors(document: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    for name, motor in (document.get("motors") or {}).items():
        if isinstance(motor, dict):
            skipped = ("source", "joint")
            numbers = [f"{k} `{v}`" for k, v in motor.items() if k not in skipped]
            yield f"`{name}`", ", ".join(numbers), str(motor.get("source", ""))


def frames(document: dict[str, Any]) -> list[tuple[str, ...]]:
    can = document.get("can")
    if not isinstance(can, dict):
        return []
    return [
        (f"`{name}`", f"`{frame['cob_id']}`", frame["direction"], frame.get("description", ""))
        for name, frame in can.get("frames", {}).items()
    ]


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> Iterator[str]:
    if rows:
        yield from ("", f"| {' | '.join(head)} |", "| --- " * len(head) + "|")
        for row in rows:
            cells = (" ".join(str(cell).split()).replace("|", "\\|") for cell in row)
            yield f"| {' | '.join(cells)} |"
