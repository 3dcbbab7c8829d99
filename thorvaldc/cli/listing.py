"""``targets``, ``schema``, ``explain``, ``modules list`` and ``modules show``."""

from __future__ import annotations

import difflib
import json as json_format
import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import typer

from thorvaldc.cli.compiling import library_folders
from thorvaldc.cli.exits import DONE
from thorvaldc.cli.faults import Faults, width_of

if TYPE_CHECKING:
    from thorvaldc.compiler.library import ModuleType

KINDS = ("robot", "module", "fleet", "calibration", "scenario", "bus_faults", "model")


def list_targets(json: bool) -> int:
    from thorvaldc import backends

    summaries: dict[str, str] = {}
    for name in backends.names():
        try:
            summaries[name] = backends.load(name).summary
        except backends.TargetError as error:
            summaries[name] = str(error)
    if json:
        print(json_format.dumps(summaries, indent=1, ensure_ascii=False))
    else:
        print_table(
            (name, summary if name in backends.DEFAULT_TARGETS else f"{summary} (not by default)")
            for name, summary in summaries.items()
        )
    return DONE


def show_schema(kind: str) -> int:
    if kind not in KINDS:
        raise typer.BadParameter(f"{kind!r} is none of {', '.join(KINDS)}", param_hint="KIND")
    if kind == "model":
        from thorvaldc.model.json_schema import model_schema_text

        print(model_schema_text(), end="")
        return DONE
    from thorvaldc.schema.documents import schema_text

    print(schema_text(kind), end="")
    return DONE


def explain(code: str) -> int:
    from thorvaldc.diagnostics import explain as pages

    try:
        print(pages.explain(code), end="")
    except pages.UnknownCode as fault:
        hint = f"; {fault.hint}" if fault.hint else ""
        raise typer.BadParameter(f"{fault}{hint}", param_hint="CODE") from None
    return DONE


def list_modules(library: Sequence[str], json: bool) -> int:
    types, status = _module_types(library, None)
    if json:
        found = [
            {"type": t.name, "category": t.category} | _about(t.document.plain()) for t in types
        ]
        print(json_format.dumps(found, indent=1, ensure_ascii=False))
    else:
        print_table((t.name, _sentence(t.document.plain())) for t in types)
    return status


def show_module(name: str, library: Sequence[str], json: bool) -> int:
    types, status = _module_types(library, name)
    for module in types:
        document = module.document.plain()
        if json:
            print(json_format.dumps({"type": name} | document, indent=1, ensure_ascii=False))
        else:
            _print_module(name, document)
    return status


def _module_types(library: Sequence[str], name: str | None) -> tuple[list[ModuleType], int]:
    """That type, or all; faults in the documents go to stderr and into the exit status."""
    from thorvaldc.compiler.library import Library
    from thorvaldc.compiler.source.node import Node
    from thorvaldc.diagnostics import Report, Span

    folders = library_folders(library)
    modules = Library([(folder, str(folder)) for folder in folders])
    names = modules.names()
    if name is not None and name not in names:
        raise typer.BadParameter(
            f"there is no module type {name!r}{_near(name, names)}", param_hint="TYPE"
        )
    report = Report()
    wanted = names if name is None else [name]
    types = [modules.load(n, Node(n, Span("command line")), report) for n in wanted]
    faults = Faults("text", sys.stderr)
    faults.add(report, modules.files)
    return [t for t in types if t is not None], faults.finish()


def _sentence(document: dict[str, Any]) -> str:
    """The description's first sentence."""
    text = " ".join(str(document.get("description", "")).split())
    return text.split(". ")[0].rstrip(".") + "."


def _about(document: dict[str, Any]) -> dict[str, Any]:
    """What a user of the module needs to know of its document."""
    return {
        "description": document.get("description", ""),
        "params": document.get("params", {}),
        "ports": document.get("ports", {}),
        "fits": (document.get("mount") or {}).get("kinds", []),
    }


def _print_module(name: str, document: dict[str, Any]) -> None:
    print(name)
    facts = [("what", str(document.get("description", "")))]
    kinds = (document.get("mount") or {}).get("kinds", [])
    if kinds:
        facts.append(("mounts on", ", ".join(kinds)))
    ports = document.get("ports", {})
    shown = [
        f"{p} ({v['kind']})" if isinstance(v, dict) else f"{p} = {v}" for p, v in ports.items()
    ]
    if shown:
        facts.append(("ports", ", ".join(shown)))
    rest = ("links", "joints", "motors", "channels", "modules")
    facts += [(key, ", ".join(document[key])) for key in rest if document.get(key)]
    print_table(facts)
    params = document.get("params", {})
    if params:
        print("\nparams:")
        print_table((f"  {key}", _param(value)) for key, value in params.items())


def _param(declared: dict[str, Any]) -> str:
    words = [str(declared.get("quantity") or declared.get("type") or "number").replace("_", " ")]
    words.append(f"default {_word(declared['default'])}" if "default" in declared else "required")
    for key, says in (("minimum", "from"), ("maximum", "to"), ("choices", "one of")):
        if key in declared:
            words.append(f"{says} {_word(declared[key])}")
    text = f"{', '.join(words)}. {declared.get('description', '')}"
    return text + (f" [{declared['source']}]" if "source" in declared else "")


def _word(value: Any) -> str:
    """A value as it stands in a YAML file."""
    return value if isinstance(value, str) else json_format.dumps(value, ensure_ascii=False)


def _near(word: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return f"; did you mean {near[0]!r}?" if near else ""


def print_table(rows: Iterable[tuple[str, str]]) -> None:
    """Names and what they are, wrapped to the terminal with the second column aligned."""
    import textwrap

    rows = list(rows)
    indent = max((len(name) for name, _ in rows), default=0) + 2
    width = max(width_of(sys.stdout), indent + 30)
    for name, text in rows:
        lines = textwrap.wrap(text, width - indent, break_on_hyphens=False) or [""]
        print(f"{name:<{indent}}{lines[0]}".rstrip())
        for line in lines[1:]:
            print(" " * indent + line)
