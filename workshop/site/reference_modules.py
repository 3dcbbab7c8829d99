"""The pages of the hardware library: one page for each category, with a picture of each module."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

from thorvaldc.compiler.modules.library import Library, ModuleType
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, Span

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "docs" / "assets" / "modules"


def pages() -> dict[str, str]:
    library, report = Library(), Report()
    names = sorted(library.names_in(ROOT / "modules"))
    found = [library.load(name, Node(name, Span("site")), report) for name in names]
    modules = [module for module in found if module is not None]
    texts = {"reference/modules/README.md": index(modules)}
    for category, group in groupby(modules, key=lambda module: module.name.split("/")[0]):
        texts[f"reference/modules/{category}.md"] = page(category, list(group))
    return texts


def index(modules: list[ModuleType]) -> str:
    lines = ["# The hardware library", ""]
    lines += ["[How modules connect, and where the numbers come from](../../modules/README.md)."]
    lines += ["", "| module | what it is | picture |", "| --- | --- | --- |"]
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
    file = PICTURES / f"{module.name.replace('/', '_')}.png"
    if not file.is_file():
        return ""
    return f"![The module {module.name}](../../assets/modules/{file.name}){{ width={width} }}"


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
