"""Follows launch files to the files that they include, and parameter files to their places."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from thorvaldc.compiler.extras.ros_packages import find_in_sources
from thorvaldc.diagnostics import Report
from thorvaldc.tools.audit.audit_facts import Evidence, Fact, LaunchedNode, LaunchFile

MAX_LAUNCH_FILES = 200


def launched_nodes(launch: LaunchFile, evidence: Evidence) -> Iterator[LaunchedNode]:
    """Yields the nodes of a launch file and of the files that it includes without condition."""
    by_path = {os.path.realpath(other.path): other for other in evidence.launches}
    open_files, known = [launch], {os.path.realpath(launch.path)}
    while open_files and len(known) < MAX_LAUNCH_FILES:
        current = open_files.pop()
        yield from current.nodes
        for include in current.includes:
            path = resolved(include, current, evidence)
            real = os.path.realpath(path) if path is not None else ""
            if include.kind == "include" and real in by_path and real not in known:
                known.add(real)
                open_files.append(by_path[real])


def resolved(fact: Fact, launch: LaunchFile, evidence: Evidence) -> Path | None:
    """Returns the path of a file that a launch file names, or ``None`` outside of the audit."""
    name = str(fact.value)
    if name.startswith("package://"):
        package, _, rest = name.removeprefix("package://").partition("/")
        folder = evidence.packages.get(package)
        if folder is None or not rest or "\0" in rest:
            return None
        return Path(find_in_sources(str(folder), rest) or folder / rest)
    if name.startswith("/") or "://" in name:
        return None
    return launch.path.parent / name


def check_launched_files(evidence: Evidence, report: Report) -> None:
    """Reports parameter files and launch files that do not exist in their package."""
    for launch in evidence.launches:
        files = [*launch.includes, *(f for node in launch.nodes for f in node.parameter_files)]
        for fact in files:
            path = resolved(fact, launch, evidence)
            is_local = str(fact.value).startswith("package://")
            try:
                is_missing = is_local and path is not None and not path.exists()
            except (OSError, ValueError):
                is_missing = True
            if is_missing:
                what = "launch file" if fact.kind.endswith("include") else fact.kind
                report.add(
                    "audit-file-missing",
                    f"the {what} `{str(fact.value).removeprefix('package://')}` does not exist",
                    fact.span,
                    hint="paths of packages begin with the folder that the package installs",
                )
