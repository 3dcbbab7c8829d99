"""Describes module types for the output of the command ``thorvaldc modules``."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from thorvaldc.compiler.modules.library import ModuleType
from thorvaldc.compiler.source.unit_table import QUANTITIES

if TYPE_CHECKING:
    from thorvaldc.compiler.catalogue.module_description import ModuleDescription

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


def description_rows(module: ModuleType, description: ModuleDescription) -> list[Row]:
    """Returns what a module type is, fits and consists of, as table rows."""
    document = module.document.plain()
    rows = [("what", description.description), ("category", description.category)]
    if description.mounts_on:
        rows.append(("mounts on", ", ".join(description.mounts_on)))
        rows.append(("carried by", ", ".join(description.carriers) or "no type of the library"))
    parts = ("links", "joints", "motors", "channels", "modules")
    rows += [(key, ", ".join(document[key])) for key in parts if document.get(key)]
    mass = description.mass
    rows.append(("mass", "depends on params without default" if mass is None else f"{mass:.4g} kg"))
    return rows


def mass_rows(description: ModuleDescription) -> list[Row]:
    """Returns the mass by source of a module type as table rows."""
    return [
        (f"{part.mass:.4g} kg", part.source or "no source stated")
        for part in description.masses or ()
    ]


def port_rows(description: ModuleDescription) -> list[Row]:
    """Returns a table row for each port: kind, position, and the types that it takes.

    Types are listed for the first port of each kind.
    """
    rows: list[Row] = []
    listed: set[str] = set()
    for port in description.ports:
        text = port.kind
        if port.position is not None:
            text += " at ({:g}, {:g}, {:g}) m".format(*port.position)
        if port.kind not in listed:
            listed.add(port.kind)
            text += f": takes {', '.join(port.takes) or 'no type of the library'}"
        rows.append((port.name, text))
    return rows


def description_document(description: ModuleDescription) -> dict[str, Any]:
    """Returns a description as JSON values: lengths in m, masses in kg."""
    return {
        "category": description.category,
        "mass": description.mass,
        "masses": None
        if description.masses is None
        else [{"mass": part.mass, "source": part.source} for part in description.masses],
        "mounts_on": list(description.mounts_on),
        "carriers": list(description.carriers),
        "ports": [
            {
                "name": port.name,
                "kind": port.kind,
                "position": port.position,
                "takes": list(port.takes),
            }
            for port in description.ports
        ],
        "units": description.units,
    }


def parameter_rows(module: ModuleType) -> Iterable[Row]:
    """Yields a table row for each parameter of a module type.

    The second column contains the kind, default, range, description and source of the parameter.
    """
    for name, declaration in module.document.plain().get("params", {}).items():
        yield name, _parameter_text(declaration)


def _parameter_text(declaration: dict[str, Any]) -> str:
    """Describes a parameter of a module type in one line of text."""
    kind = str(declaration.get("quantity") or declaration.get("type") or "number")
    unit = QUANTITIES[kind].unit if kind in QUANTITIES else "1"
    facts = [kind.replace("_", " ") + (f" in {unit}" if unit != "1" else "")]
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
