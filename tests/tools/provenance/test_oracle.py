"""What `why` names is what changes: numbers of documents are changed one by one, as an oracle."""

from __future__ import annotations

import os
import random
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.examples import FOLDER, SAMPLED_ROBOTS, example_robot
from thorvaldc.backends import DEFAULT_TARGETS
from thorvaldc.compiler.pipeline import compile_file, emit_without_model, many_compilations
from thorvaldc.compiler.source.input_file import unsaved_texts
from thorvaldc.compiler.source.units import UnitError, parse_any
from thorvaldc.diagnostics import Span
from thorvaldc.model import Robot
from thorvaldc.tools.provenance.trace import Place, Trace

TARGETS = (*DEFAULT_TARGETS, "sdf")
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
TEXT_KEYS = ("description", "source", "thorvaldc", "name", "color")
Files = dict[str, list[str]]


@cache
def trace_of(name: str) -> Trace:
    return Trace(FOLDER / name / "robot.yaml")


def files_of(robot: Robot) -> Files:
    return {
        name: content.decode("utf-8", "replace").splitlines()
        for name, content in emit_without_model(robot, TARGETS).items()
        if not name.endswith((".stl", "model.json"))
    }


def changed_texts(text: str) -> Iterator[str]:
    """Yields small changes of a number or an expression, and larger ones for whole numbers."""
    if text.startswith("${"):
        yield f'"${{({text[2:-1]}) * 1.0137}}"'
        return
    match = NUMBER.match(text)
    assert match is not None
    number, unit = float(match[0]), text[match.end() :]
    for new in [repr(number * 1.0137) if number else "1e-7", *(f"{number + n:g}" for n in (1, 9))]:
        yield f'"{new}{unit}"' if unit else new


def is_number(place: Place) -> bool:
    if any(key in TEXT_KEYS for key in re.split(r"[.\[]", place.key)):
        return False
    try:
        return place.is_expression or parse_any(place.text) is not None
    except UnitError:
        return False


def changed_robot(path: Path, place: Place, span: Span, file: Path) -> Robot | None:
    """Returns the robot with another number at a place, or ``None`` if each one is an error."""
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    line = lines[span.line - 1]
    for new in changed_texts(place.text):
        lines[span.line - 1] = line[: span.column - 1] + new + line[span.end_column - 1 :]
        with unsaved_texts({os.path.realpath(file): "".join(lines).encode()}):
            model = compile_file(path).model
        if isinstance(model, Robot):
            return model
    return None


def changed_lines(before: list[str], after: list[str]) -> set[int]:
    """Returns the indices of lines with other content; a line that only moved is none of them."""
    changed = [i for i, pair in enumerate(zip(before, after, strict=True)) if pair[0] != pair[1]]
    moved = Counter(after[i] for i in changed)
    moved.subtract(before[i] for i in changed)
    return {i for i in changed if moved[before[i]] < 0}


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_an_output_without_its_marks_is_the_output(name: str) -> None:
    """Padding of tables differs, because a mark takes columns."""
    expected, trace = files_of(example_robot(name)), trace_of(name)
    assert trace.robot == example_robot(name)
    lines = {file: lines for target in TARGETS for file, lines in trace.lines(target).items()}
    assert lines.keys() == expected.keys()
    for file, content in expected.items():
        texts = [re.sub(r"[ -]+", " ", line.text) for line in lines[file]]
        assert texts == [re.sub(r"[ -]+", " ", line) for line in content], file


OTHERS = ("4wd2ws_tall", "jk_bms", "rocker_bogie")


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("lss", 10),
        pytest.param("4wd4ws_wide", 50, marks=pytest.mark.slow),
        *(pytest.param(name, 10, marks=pytest.mark.slow) for name in OTHERS),
        *(pytest.param(name, 50, marks=pytest.mark.exhaustive) for name in OTHERS),
    ],
)
def test_changed_lines_are_named(name: str, count: int) -> None:
    """At most 1 % of the lines with another number are not named.

    Changes that add or remove lines are left out: they change the structure of the robot.
    """
    path, trace = FOLDER / name / "robot.yaml", trace_of(name)
    before = files_of(example_robot(name))
    lines = {file: lines for target in TARGETS for file, lines in trace.lines(target).items()}
    places = [item for item in trace.places.items() if is_number(item[1])]
    random.Random(7).shuffle(places)
    tried = total = 0
    missed: list[str] = []
    with many_compilations():
        for span, place in places:
            robot = changed_robot(path, place, span, trace.compilation.files[span.file])
            after = files_of(robot) if robot is not None else {}
            if {f: len(x) for f, x in after.items()} != {f: len(x) for f, x in before.items()}:
                continue
            bit = trace.spans.get(span)
            for file, content in before.items():
                changed = changed_lines(content, after[file])
                total += len(changed)
                missed += [
                    f"{span} {place.key}: {file}:{i + 1} {content[i].strip()}"
                    for i in changed
                    if bit is None or not lines[file][i].origins >> bit & 1
                ]
            tried += 1
            if tried == count:
                break
    print(f"{name}: {tried} numbers, {total} lines changed, {len(missed)} not named")
    assert tried == count
    assert total > 3 * count
    assert len(missed) <= 0.01 * total, "\n".join(missed[:30])
