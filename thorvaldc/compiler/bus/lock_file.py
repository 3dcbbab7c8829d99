"""The lock file beside a robot: ids that were chosen once stay, whatever is added.

`robot.lock.yaml` belongs to `robot.yaml`.  It is read by every command and
written by `build`; `docs/language.md` describes it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model.robot import Robot

VERSION_KEY, VERSION = "thorvaldc_lock", 1
ADDRESSES = "addresses"
HEAD = """\
# Ids that thorvaldc chose for the devices of {robot} (`can: auto`). `thorvaldc build` keeps this
# file up to date. Keep it with the robot: with it a new module never takes another's id.
"""


class Pin(NamedTuple):
    id: int
    span: Span


Lock = dict[tuple[str, str, str], Pin]  # by bus, id space and module


def lock_path(robot: Path) -> Path:
    """The lock file of a robot's file: `robot.lock.yaml` for `robot.yaml`."""
    return robot.with_name(f"{robot.stem}.lock.yaml")


def read_lock(document: Node, report: Report) -> Lock:
    """The ids in a lock file; what is wrong with it is reported."""

    def fault(message: str, node: Node) -> None:
        report.add(
            "can-lock-invalid",
            message,
            node.span,
            hint="take the file from version control, or delete it to have all ids chosen anew",
        )

    version = document.get(VERSION_KEY)
    if version is None or type(version.value) is not int or version.value != VERSION:
        fault(f"this is no lock file with `{VERSION_KEY}: {VERSION}`", version or document)
        return {}

    def entries(node: Node | None) -> Iterator[tuple[str, Node]]:
        if node is not None and isinstance(node.value, dict):
            yield from node.value.items()
        elif node is not None:
            fault("a mapping is wanted here", node)

    lock: Lock = {}
    for bus, spaces in entries(document.get(ADDRESSES)):
        for id_space, modules in entries(spaces):
            for module, node in entries(modules):
                if type(node.value) is int:
                    lock[bus, id_space, module] = Pin(node.value, node.where)
                else:
                    fault(f"the id of `{module}` must be a whole number", node)
    return lock


def lock_text(robot: Robot, file: str) -> str:
    """The lock file of a robot whose file is named ``file``."""
    lines = [HEAD.format(robot=file), f"{VERSION_KEY}: {VERSION}\n"]
    lines.append(f"{ADDRESSES}:\n" if has_pins(robot) else f"{ADDRESSES}: {{}}\n")
    for bus in robot.buses:
        pinned = [node for node in bus.nodes if node.automatic]
        if pinned:
            lines.append(f"  {_key(bus.name)}:\n")
        for id_space in dict.fromkeys(node.id_space for node in pinned):
            lines.append(f"    {_key(id_space)}:\n")
            lines += [f"      {_key(n.module)}: {n.id}\n" for n in pinned if n.id_space == id_space]
    return "".join(lines)


def _key(name: str) -> str:
    """A name as a key; names are lower-case, and three of those words are no text in YAML."""
    return f'"{name}"' if name in ("true", "false", "null") else name


def has_pins(robot: Robot) -> bool:
    """Whether any id of the robot was chosen by the compiler."""
    return any(node.automatic for bus in robot.buses for node in bus.nodes)
