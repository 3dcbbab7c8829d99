"""Describes module types for the output of the command ``thorvaldc modules``."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from thorvaldc.compiler.library import ModuleType

Row = tuple[str, str]


def module_summary(module: ModuleType) -> dict[str, Any]:
    """Returns the description, parameters, ports and mount kinds of a module type as JSON values.

    ``fits`` lists the kinds of ports that the module can be mounted on.
    """
    document = module.document.plain()
    return {
        "type": module.name,
        "category": module.category,
        "description": document.get("description", ""),
        "params": document.get("params", {}),
        "ports": document.get("ports", {}),
        "fits": (document.get("mount") or {}).get("kinds", []),
    }


def first_sentence(module: ModuleType) -> str:
    """Returns the first sentence of the description of a module type."""
    text = " ".join(str(module.document.plain().get("description", "")).split())
    return text.split(". ")[0].rstrip(".") + "."


def module_facts(module: ModuleType) -> list[Row]:
    """Returns the description, mount kinds, ports and parts of a module type as table rows."""
    document = module.document.plain()
    rows = [("what", str(document.get("description", "")))]
    kinds = (document.get("mount") or {}).get("kinds", [])
    if kinds:
        rows.append(("mounts on", ", ".join(kinds)))
    ports = [
        f"{name} ({port['kind']})" if isinstance(port, dict) else f"{name} = {port}"
        for name, port in document.get("ports", {}).items()
    ]
    if ports:
        rows.append(("ports", ", ".join(ports)))
    parts = ("links", "joints", "motors", "channels", "modules")
    rows += [(key, ", ".join(document[key])) for key in parts if document.get(key)]
    return rows


def parameter_rows(module: ModuleType) -> Iterable[Row]:
    """Yields a table row for each parameter of a module type.

    The second column contains the kind, default, range, description and source of the parameter.
    """
    for name, declaration in module.document.plain().get("params", {}).items():
        yield name, _parameter_text(declaration)


def _parameter_text(declaration: dict[str, Any]) -> str:
    """Describes a parameter of a module type in one line of text."""
    kind = str(declaration.get("quantity") or declaration.get("type") or "number")
    facts = [kind.replace("_", " ")]
    if "default" in declaration:
        facts.append(f"default {_yaml_text(declaration['default'])}")
    else:
        facts.append("required")
    for key, label in (("minimum", "from"), ("maximum", "to"), ("choices", "one of")):
        if key in declaration:
            facts.append(f"{label} {_yaml_text(declaration[key])}")
    text = f"{', '.join(facts)}. {declaration.get('description', '')}"
    return text + (f" [{declaration['source']}]" if "source" in declaration else "")


def _yaml_text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
