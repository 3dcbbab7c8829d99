"""Applies the change that each hint proposes, and checks the files again.

The documents are the examples of the codes.  A diagnostic with fixes proposes a concrete change; a
diagnostic without fixes gives advice only.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from tests.diagnostics.test_cases import bytes_of, cases, diagnostics_of, write
from thorvaldc.diagnostics import Diagnostic, Fix, Severity

# Commands that need seconds.  Their diagnostics are about runs, and propose no change of a file.
SLOW = ("sim", "drive", "calibrate", "demo", "can")
CONCRETE = re.compile(r"did you mean `|^as in `|, as in `|write `[^`]*`|^add it")
# Hints about files that are not YAML, about the command line, or about another place than that of
# the diagnostic.
ADVICE = {
    "audit-description-broken",
    "audit-frame-unknown",
    "audit-joint-unknown",
    "audit-section-unused",
    "can-signal-floating-point",
    "control-joint-unknown",
    "extra-argument",
    "extra-environment",
    "extra-left-out",
    "extra-link-unknown",
    "git-file-missing",
    "git-revision-unknown",
    "expression-syntax",
    "expression-value",
    "import-missing",
    "joint-log-joint",
    "why-path-unknown",
}


# Codes whose examples are computed from the numbers of the user.
COMPUTED = {"start-in-obstacle"}


def replaced(fix: Fix, files: dict[str, Any]) -> str:
    """Returns the text at the source span of a fix."""
    lines = bytes_of(files[fix.span.file]).decode().splitlines(keepends=True)
    lines = lines[fix.span.line - 1 : fix.span.end_line]
    if not lines:
        return ""
    lines[-1] = lines[-1][: fix.span.end_column - 1]
    lines[0] = lines[0][fix.span.column - 1 :]
    return "".join(lines)


def numbers(text: str) -> set[str]:
    return set(re.findall(r"\d+", text))


def with_fix(files: dict[str, Any], fix: Fix) -> dict[str, Any]:
    """Returns the files after a fix."""
    lines = [*bytes_of(files[fix.span.file]).decode().splitlines(keepends=True), ""]

    def offset(line: int, column: int) -> int:
        return sum(map(len, lines[: line - 1])) + column - 1

    text = "".join(lines)
    start = offset(fix.span.line, fix.span.column)
    end = offset(fix.span.end_line, fix.span.end_column)
    return {**files, fix.span.file: text[:start] + fix.text + text[end:]}


def apply(fix: Fix) -> None:
    """Applies a fix to the file in the working folder."""
    name = fix.span.file
    write(with_fix({name: Path(name).read_bytes()}, fix), Path())


def shown(diagnostic: Diagnostic) -> tuple[str, str]:
    return diagnostic.code.name, diagnostic.message


@cases(left_out=SLOW)
def test_fixes(case: dict[str, Any]) -> None:
    """A concrete hint has fixes, which remove the diagnostic and cause no new error."""
    files = case["files"]
    for diagnostic in diagnostics_of(files, case):
        check_the_hint(diagnostic, files)
    check_the_fixes(files, lambda changed: diagnostics_of(changed, case))


def check_the_fixes(
    files: dict[str, Any],
    check: Callable[[dict[str, Any]], list[Diagnostic]],
    uncovered: Collection[str] = (),
) -> None:
    """Each fix removes its diagnostic and causes no new error.

    ``uncovered``: codes of errors that the mistake hides, and a fix uncovers.
    """
    before = check(files)
    known = {shown(d) for d in before}
    for diagnostic in before:
        clean = []
        for fix in diagnostic.fixes:
            after = check(with_fix(files, fix))
            left = [d for d in after if d.code == diagnostic.code]
            number = sum(d.code == diagnostic.code for d in before)
            assert len(left) < number, f"{diagnostic.hint} does not remove: {diagnostic.message}"
            new = [
                d
                for d in after
                if d.severity is Severity.ERROR
                and shown(d) not in known
                and d.code.number not in uncovered
            ]
            if fix.is_example:
                # An example has the right shape; the user adapts its value to the robot.
                new = [d for d in new if d.code.number < "TV3"]
            clean.append(new)
        # A hint can have alternatives, such as a truth value or a text.  At least one of them
        # causes no new error.
        assert not clean or [] in clean, f"{diagnostic.hint}: {list(map(shown, clean[0]))}"


def check_the_hint(diagnostic: Diagnostic, files: dict[str, Any]) -> None:
    """An example replaces no number of the user, and a concrete hint has fixes."""
    for fix in diagnostic.fixes:
        if fix.is_example and diagnostic.code.name not in COMPUTED:
            lost = numbers(replaced(fix, files)) - numbers(fix.text)
            assert not lost, f"{diagnostic.code.name}: {diagnostic.hint}"
    hint, span = diagnostic.hint or "", diagnostic.span
    if "as in `" in hint and span is not None and numbers(replaced(Fix(span, ""), files)):
        return  # an example would replace a number of the user
    if CONCRETE.search(hint) and diagnostic.code.name not in ADVICE:
        assert diagnostic.fixes, f"{diagnostic.code.name}: {diagnostic.hint}"
