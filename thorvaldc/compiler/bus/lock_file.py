"""Reads and writes the lock file of a robot, which stores automatically assigned node ids.

The lock file `robot.lock.yaml` contains the node ids that the compiler chose for CAN devices.  With
the lock file, a CAN device keeps its node id when other devices are added.  The lock file for the
robot file `robot.yaml` is `robot.lock.yaml`.  Every command of the compiler reads the lock file,
and the command `build` writes the lock file.  The page `docs/language.md` describes the format of
the lock file for node ids.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Robot

VERSION_KEY, VERSION = "thorvaldc_lock", 1
ADDRESSES = "addresses"
HEAD = """\
# Ids that thorvaldc chose for the devices of {robot} (`can: auto`). `thorvaldc build` keeps this
# file up to date. Keep it with the robot: with it a new module never takes another's id.
"""


class Pin(NamedTuple):
    id: int
    span: Span


Lock = dict[tuple[str, str, str], Pin]  # (bus, id space, module) -> node id


def lock_path(robot: Path) -> Path:
    """Returns the path of the lock file of a robot, such as `robot.lock.yaml` for `robot.yaml`."""
    return robot.with_name(f"{robot.stem}.lock.yaml")


def without_lock_files(files: Sequence[str]) -> list[str]:
    """Returns the paths without those of the lock files of robots among them.

    The pattern `robots/*.yaml` also names lock files; the compiler reads them with their robots.
    """
    locks = {lock_path(Path(file)) for file in files if Path(file).name}
    return [file for file in files if Path(file) not in locks]


def read_lock(document: Node, report: Report) -> Lock:
    """Returns the node ids in a lock file, and reports an error for each invalid node id."""

    def report_error(message: str, node: Node) -> None:
        report.add(
            "can-lock-invalid",
            message,
            node.span,
            hint="restore the file from version control, or delete it to choose all ids again",
        )

    version = document.get(VERSION_KEY)
    if version is None or type(version.value) is not int or version.value != VERSION:
        report_error(
            f"this is not a lock file with `{VERSION_KEY}: {VERSION}`", version or document
        )
        return {}

    def entries(node: Node | None) -> Iterator[tuple[str, Node]]:
        if node is not None and isinstance(node.value, dict):
            yield from node.value.items()
        elif node is not None:
            report_error("expected a mapping", node)

    lock: Lock = {}
    for bus, spaces in entries(document.get(ADDRESSES)):
        for id_space, modules in entries(spaces):
            for module, node in entries(modules):
                if type(node.value) is int:
                    lock[bus, id_space, module] = Pin(node.value, node.where)
                else:
                    report_error(f"the id of `{module}` must be a whole number", node)
    return lock


def lock_text(robot: Robot, file: str) -> str:
    """Returns the YAML text of the lock file of a robot.

    - ``file``: name of the robot file, for the comment at the start of the lock file.
    """
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
    """Returns the name of a device as a YAML key.

    The words `true`, `false` and `null` need quotes, because YAML does not read them as text.
    Device names have only lower-case letters, so no other YAML key needs quotes.
    """
    return f'"{name}"' if name in ("true", "false", "null") else name


def has_pins(robot: Robot) -> bool:
    """Returns whether the compiler chose the node id of at least one CAN device."""
    return any(node.automatic for bus in robot.buses for node in bus.nodes)
