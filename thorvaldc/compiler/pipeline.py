"""The stages, on one screen: source, schema, resolve, elaborate, checks; then backends."""

from __future__ import annotations

import hashlib
import os
import posixpath
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from thorvaldc import backends
from thorvaldc.compiler.bus.lock_file import Lock, has_pins, lock_path, lock_text, read_lock
from thorvaldc.compiler.geometry.robot_checks import check_robot
from thorvaldc.compiler.library import OWN, Library
from thorvaldc.compiler.modules.design_requirements import read_design
from thorvaldc.compiler.modules.elaborate import elaborate
from thorvaldc.compiler.modules.library_check import check_module
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.compiler.validation.document_kinds import is_fleet, is_scenario, report_wrong_kind
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model import CalculatorChoice, Fleet, Placement, Pose, Robot
from thorvaldc.model.serialize import to_json

if TYPE_CHECKING:  # few files need them, and to make their classes takes milliseconds
    from thorvaldc.compiler.scenario.variations import Change
    from thorvaldc.model.bus_faults import BusFaults
    from thorvaldc.model.scenario import Scenario

MODEL_FILE = "model.json"
SETTING = "--set "
"""Begins the name of a value on the command line, in place of a file's."""


@dataclass
class Compilation:
    """What became of a file.  ``model`` is ``None`` where there were errors.

    Spans in ``model`` are relative to the file's own folder, so that outputs do
    not depend on where that lies; spans in ``report`` are paths as the user gave
    them.  ``sources`` maps the latter to files, for excerpts.  ``folder`` is that of
    the file, and ``files`` has what was read by its names in the model's spans.
    ``locks`` maps lock files that a build has to write to their text.  Of a scenario,
    ``model`` is the fleet in its world and ``scenario`` the whole.
    """

    model: Robot | Fleet | None = None
    scenario: Scenario | None = None
    report: Report = field(default_factory=Report)
    source_sha256: str = ""
    sources: dict[str, Path] = field(default_factory=dict)
    folder: Path = field(default_factory=Path)
    files: dict[str, Path] = field(default_factory=dict)
    locks: dict[Path, str] = field(default_factory=dict)

    def located(self, report: Report) -> Report:
        """What was said of ``model`` later on, with paths as the user would write them."""
        return _with_paths(report, self.folder, self.files)


def compile_file(
    path: Path | str,
    *,
    library: Sequence[Path] = (),
    robot: Path | str | None = None,
    changes: Sequence[Change] = (),
) -> Compilation:
    """Compile a robot, a fleet or a scenario file.  ``library`` are further module folders.

    ``robot`` is a robot or fleet file in place of a scenario's own robots, ``changes`` are
    other values in a scenario's document.  Every fault that the file holds is in the
    report; nothing is raised for bad input.
    """
    path = Path(path)
    return _compile(path, path.name or str(path), path.parent, library, robot, changes)


def _compile(
    path: Path,
    name: str,
    folder: Path,
    library: Sequence[Path],
    robot: Path | str | None = None,
    changes: Sequence[Change] = (),
) -> Compilation:
    """Compile a file that spans are to call ``name``, which is relative to ``folder``."""
    shape, report = Report(), Report()
    files = {name: path}
    done = Compilation(folder=folder, files=files)
    robots: dict[str, Compilation] = {}
    pins = ""
    document = read_file(path, name, shape)
    if document is not None and report_wrong_kind(document, shape):
        document = None
    if document is not None:
        scenario = is_scenario(document)
        if scenario and changes:
            from thorvaldc.compiler.scenario.variations import (  # few runs need it
                changed,
                without_variations,
            )

            document = without_variations(changed(document, changes, shape))
        fleet = not scenario and is_fleet(document)
        check(document, "scenario" if scenario else "fleet" if fleet else "robot", shape)
        modules = document.get("modules")
        whole = modules is None or not shape.has_error_in(modules.span)
        # Later stages continue with the valid values: one run reports the diagnostics of all.
        sound_part = without_invalid_values(document, shape)
        if fleet or scenario:
            if fleet:
                done.model = _fleet(sound_part, path, library, report, robots)
            else:
                done.scenario = _scenario(sound_part, path, library, report, robots, robot)
                if done.scenario is not None:
                    done.scenario = _with_log(sound_part, done.scenario, path, files, report)
                done.model = done.scenario.fleet if done.scenario is not None else None
            for one in robots.values():
                done.report.extend(one.report)
                done.sources.update(one.sources)
                done.locks.update(one.locks)
        elif (modules := sound_part.get("modules")) is not None and modules.value:
            lost = sorted(_module_names(document) - _module_names(sound_part))
            lock = _lock(path, name, report, done)
            model = _robot(sound_part, path, library, report, files, lost, whole, lock)
            pins = _pins(model, path, done) if model is not None else ""
            done.model = model
        done.source_sha256 = _sha256(files, robots, pins)
    for said in (shape, report.excluding_spans_of(shape)):
        done.report.extend(done.located(said))
    for shown, file in files.items():
        done.sources[shown if shown.startswith(OWN) else os.path.normpath(file)] = file
    for one in robots.values():
        files.update(one.files)
    if done.report.has_errors:
        done.model = done.scenario = None
        done.locks.clear()
    return done


def _lock(robot: Path, name: str, report: Report, done: Compilation) -> Lock | None:
    """The ids that are pinned in the robot's lock file; ``None`` where it has none."""
    path = lock_path(robot)
    if not os.path.lexists(path):
        return None
    done.sources[os.path.normpath(path)] = path
    document = read_file(path, lock_path(Path(name)).as_posix(), report)
    return read_lock(document, report) if document is not None else {}


def _pins(model: Robot, robot: Path, done: Compilation) -> str:
    """What the robot's lock file must say, empty where none is needed."""
    path = lock_path(robot)
    before = path.read_bytes() if os.path.normpath(path) in done.sources else None
    if before is None and not has_pins(model):
        return ""
    text = lock_text(model, robot.name)
    if before != text.encode():
        done.locks[path] = text
    return text


@dataclass
class LibraryCheck:
    """What was found in a library folder: the types' names and their faults."""

    names: list[str] = field(default_factory=list)
    report: Report = field(default_factory=Report)
    sources: dict[str, Path] = field(default_factory=dict)


def check_library(folder: Path | None) -> LibraryCheck:
    """Check every module type of a folder, of the project's own library for ``None``."""
    library = Library([(folder, str(folder))] if folder is not None else [])
    done = LibraryCheck(library.names_in(folder) if folder is not None else library.names())
    for name in done.names:
        check_module(name, library, done.report)
    done.sources = library.files
    return done


def read_faults(path: Path | str, robot: Robot, report: Report) -> BusFaults | None:
    """The faults of a document for the robot's simulated bus; ``None`` where it is at fault."""
    from thorvaldc.compiler.bus.injected_faults import read_bus_faults  # which few runs need

    shape, said = Report(), Report()
    document = read_file(Path(path), str(path), shape)
    if document is None:
        report.extend(shape)
        return None
    check(document, "bus_faults", shape)
    script = read_bus_faults(without_invalid_values(document, shape), robot, said)
    for found in (shape, said.excluding_spans_of(shape)):
        report.extend(found)
    return None if shape.has_errors or said.has_errors else script


def emit(
    model: Robot | Fleet, targets: Sequence[str], report: Report | None = None
) -> dict[str, bytes]:
    """The files of the targets by relative path, and ``model.json``.

    Raises ``KeyError`` for an unknown target.  What a format cannot say of the
    model is added to the report, with spans as in the model.
    """
    files = {MODEL_FILE: to_json(model).encode()}
    robots = [p.robot for p in model.placements] if isinstance(model, Fleet) else [model]
    for target in dict.fromkeys(targets):
        backend = backends.load(target)
        if report is not None:
            for robot in robots:
                for diagnostic in backend.unsupported(robot):
                    report.put(diagnostic)
        made = backend.emit_fleet(model) if isinstance(model, Fleet) else backend.emit(model)
        files.update(made)
    return files


def _robot(
    document: Node,
    path: Path,
    library: Sequence[Path],
    report: Report,
    files: dict[str, Path],
    lost: Sequence[str],
    whole: bool,
    lock: Lock | None,
) -> Robot | None:
    """The robot of a document; of a faulty one, its further faults are found as well."""
    base = path.parent
    above = posixpath.dirname(document.span.file)
    folders: list[tuple[Path, str]] = []
    own = document.get("library")
    for node in own.value if own is not None and isinstance(own.value, tuple) else ():
        folder = base / str(node.value)
        if os.path.isdir(folder):
            folders.append((folder, posixpath.normpath(posixpath.join(above, str(node.value)))))
        else:
            report.add("library-missing", f"there is no folder `{node.value}`", node.span)
    folders.extend((folder, folder.name) for folder in library)
    modules = Library(folders)
    resolver = Resolver(modules, report)
    robot = elaborate(document, resolver, base, report, files, lost, whole=whole, lock=lock)
    files.update(modules.files)
    design = read_design(document, modules, report)
    if robot is not None:
        check_robot(robot, design, report)
        if robot.calculator != CalculatorChoice():
            _check_calculator(robot, document, report)
    return robot


def _module_names(document: Node) -> set[str]:
    modules = document.get("modules")
    return set(modules.value) if modules is not None and isinstance(modules.value, dict) else set()


def _check_calculator(robot: Robot, document: Node, report: Report) -> None:
    """That there is such a calculator, that its options are right and that it suits the robot."""
    from thorvaldc.runtime import calculators

    node = document.get("base_calculator")
    named = node.get("name") if node is not None else None
    options = node.get("options") if node is not None else None
    for error in calculators.calculator_errors(robot):
        option = options.get(error.option) if options is not None and error.option else None
        report.put(replace(error.diagnostic, span=(option or named or node or document).span))


def _fleet(
    document: Node,
    path: Path,
    library: Sequence[Path],
    report: Report,
    compiled: dict[str, Compilation],
) -> Fleet:
    """The fleet; ``compiled`` gathers what became of each robot file that it names."""
    from thorvaldc.compiler.scenario.fleet_placement import Placements  # which few files need

    scope = Scope(None, {}, Library(), report, None)
    placements = Placements(report)
    robots = document.get("robots")
    for name, node in (robots.value if robots and isinstance(robots.value, dict) else {}).items():
        file_node = node.get("robot")
        if file_node is None:
            continue
        named = str(file_node.value)
        file = path.parent / named
        if not os.path.isfile(file):
            report.add("fleet-robot-missing", f"there is no file `{named}`", file_node.span)
            continue
        if named not in compiled and is_fleet(read_file(file, file.name, Report())):
            # Before it is compiled: a fleet might name itself.
            report.add(
                "fleet-in-fleet",
                f"`{named}` is a fleet; a robot is wanted",
                file_node.span,
            )
            continue
        if named not in compiled:
            compiled[named] = _compile(file, named, path.parent, library)
        robot = compiled[named].model
        if isinstance(robot, Robot):
            placements.add(name, node, robot)
    title, text = (scope.text(document.get(key)) for key in ("name", "description"))
    return Fleet(title, text, tuple(placements.placed))


def _scenario(
    document: Node,
    path: Path,
    library: Sequence[Path],
    report: Report,
    compiled: dict[str, Compilation],
    robot: Path | str | None,
) -> Scenario | None:
    """The scenario with its robots, or with ``robot`` in their place; ``None`` without any."""
    from thorvaldc.compiler.scenario.fleet_placement import robots_of  # which few files need
    from thorvaldc.compiler.scenario.scenario_reader import read_scenario

    named = document.get("fleet")
    own = document.get("robots")
    if robot is not None:
        file, shown, span = Path(robot), os.path.relpath(robot, path.parent), document.span
    elif named is not None:
        file, shown, span = path.parent / str(named.value), str(named.value), named.span
    elif own is not None:
        placed = _fleet(document, path, library, report, compiled)
        entries = own.value.values() if isinstance(own.value, dict) else ()
        whole = len(placed.placements) == sum(map(robots_of, entries))
        # Without one of them, all that is said of it would be at fault too.
        return read_scenario(document, placed, report) if whole else None
    else:
        report.add(
            "scenario-robots-missing",
            "the scenario has neither `robots` nor a `fleet`",
            document.span,
            hint="add one of them, or name a robot: thorvaldc sim robot.yaml --scenario FILE",
        )
        return None
    if robot is None and not os.path.isfile(file):
        report.add("fleet-robot-missing", f"there is no file `{shown}`", span)
        return None
    if is_scenario(read_file(file, shown, Report())):
        report.add("fleet-in-fleet", f"`{shown}` is a scenario; a robot or a fleet is wanted", span)
        return None
    done = compiled[shown] = _compile(file, shown, path.parent, library)
    fleet = done.model
    if isinstance(fleet, Robot):
        fleet = Fleet(fleet.name, "", _stand_in(fleet, own, report))
    return read_scenario(document, fleet, report) if fleet is not None else None


def _with_log(
    document: Node, scenario: Scenario, path: Path, files: dict[str, Path], report: Report
) -> Scenario:
    """The scenario with the velocities of the log that its script names, if it does."""
    script = document.get("script")
    log = script.get("log") if script is not None else None
    if script is None or log is None:
        return scenario
    from thorvaldc.compiler.scenario.twist_log import read_twists  # which few files need

    shown = posixpath.normpath(posixpath.join(posixpath.dirname(log.span.file), str(log.value)))
    robot, topic = script.get("robot"), script.get("topic")
    wanted = [
        (placed.name, placed.robot)
        for placed in scenario.fleet.placements
        if robot is None or placed.name == robot.value
    ]
    read: dict[str, Path] = {}
    named = str(topic.value) if topic is not None else ""
    plans = read_twists(path.parent / str(log.value), shown, log.span, wanted, named, read, report)
    files.update(read)
    commands = ((name, plans.get(name, own)) for name, own in scenario.commands)
    return replace(scenario, commands=tuple(commands))


def _stand_in(robot: Robot, robots: Node | None, report: Report) -> tuple[Placement, ...]:
    """The robot under the name and in the place of the one entry that the scenario has."""
    from thorvaldc.compiler.scenario.fleet_placement import Placements

    entries = robots.value if robots is not None else None
    if not isinstance(entries, dict) or len(entries) != 1:
        return (Placement(robot.name, Pose(), replace(robot, namespace=robot.name)),)
    placements = Placements(report)
    for name, node in entries.items():
        placements.add(name, node, robot)
    return tuple(placements.placed)


def _sha256(files: dict[str, Path], robots: dict[str, Compilation], pins: str) -> str:
    """Of all documents that were read, by their names in spans; of a fleet's robots too.

    The lock file counts as what it will be, so that the first build and the next,
    which finds what the first wrote, are the same.
    """
    digest = hashlib.sha256(pins.encode())
    for name in sorted(robots):
        digest.update(f"{name}\0{robots[name].source_sha256}\0".encode())
    for name in sorted(files):
        digest.update(name.encode() + b"\0" + files[name].read_bytes() + b"\0")
    return digest.hexdigest()


def _with_paths(report: Report, folder: Path, files: dict[str, Path]) -> Report:
    """The report with paths as the user would write them in place of names relative to the file."""

    def moved(span: Span) -> Span:
        if span.file.startswith((OWN, SETTING)):
            return span
        # Without detours: annotations of changes go by the path in the repository.
        shown = os.path.normpath(files.get(span.file) or folder / span.file)
        return Span(shown, *span[1:])

    out = Report()
    for d in report:
        labels = tuple(Label(moved(label.span), label.text) for label in d.labels)
        out.put(replace(d, span=moved(d.span) if d.span is not None else None, labels=labels))
    return out
