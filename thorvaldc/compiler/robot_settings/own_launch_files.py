"""Reads the launch files that a robot file adds to the ROS 2 package of the robot."""

from __future__ import annotations

import posixpath
from pathlib import Path

from thorvaldc.compiler.source.input_file import (
    check_no_link_outside,
    folder_of,
    read_bytes,
    report_missing,
)
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import items
from thorvaldc.diagnostics import FIRST_USE, Label, Report, Span
from thorvaldc.model.settings import OwnLaunch

MAX_BYTES = 1_000_000


def read_launch_files(
    document: Node, base_dir: Path, report: Report, files: dict[str, Path]
) -> tuple[OwnLaunch, ...]:
    """Returns the launch files that the entry ``ros.launch`` of a robot document names.

    Reports a file that does not exist or is not text, and a name that two files or a launch file of
    every package have.

    - ``base_dir``: folder of the robot file.
    - ``files``: the function adds each launch file, by its name in spans.
    """
    section = document.get("ros")
    launches: list[OwnLaunch] = []
    places: dict[str, Span] = {}
    for node in items(section.get("launch") if section is not None else None):
        if not isinstance(node.value, str):
            continue  # already reported
        name = posixpath.basename(node.value)
        first = places.setdefault(name, node.span)
        if _is_free(name, node, first, report):
            text = _text_of(node, folder_of(node, files, base_dir), report, files)
            if text is not None:
                launches.append(OwnLaunch(name, text))
    return tuple(launches)


def _is_free(name: str, node: Node, first: Span, report: Report) -> bool:
    from thorvaldc.backends.ros2_package_files import LAUNCHES  # for the few robots with own files

    generated = [f"{launch}.launch.py" for launch in LAUNCHES]
    if name not in generated and first is node.span:
        return True
    report.add(
        "conflicting-keys",
        f"two launch files of the package have the name `{name}`"
        + ("; one is generated" if name in generated else ""),
        node.span,
        hint="give the file another name",
        labels=[] if first is node.span else [Label(first, FIRST_USE)],
    )
    return False


def _text_of(node: Node, folder: Path, report: Report, files: dict[str, Path]) -> str | None:
    path = folder / str(node.value)
    if not path.is_file():
        report_missing("file-not-found", folder, node, ("py", "xml", "yaml"), report)
        return None
    display = posixpath.join(posixpath.dirname(node.span.file), str(node.value))
    if not check_no_link_outside(path, path.parent, display, report, node.span):
        return None
    files[display] = path
    data = read_bytes(path, display, report, limit=MAX_BYTES)
    try:
        return data.decode() if data is not None else None
    except UnicodeDecodeError:
        report.add("yaml-encoding", f"`{display}` is not encoded in UTF-8", node.span)
        return None
