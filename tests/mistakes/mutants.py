"""Changes valid documents by one human mistake each, and measures how the compiler reports it.

``python -m tests.mistakes.mutants COUNT SEED`` prints a table; ``--show KIND`` prints the first
diagnostics of the mutants of one kind that are not reported well.
"""

from __future__ import annotations

import random
import re
import shutil
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from tests.diagnostics.test_hints import apply
from tests.example_packages import PACKAGES
from tests.mistakes.test_mistakes import FILES, write
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.diagnostics import Severity
from thorvaldc.model.model_json import to_json

EXAMPLES = Path(__file__).parent.parent.parent / "examples"
KEY = re.compile(r"([a-z_]{3,})(?=: |:$)")
UNIT = re.compile(r"(?<=\d) (mm|m|deg|kg|rad/s|m/s|rad|s|ms|Hz|kbit/s|V|A|N m|rpm)\b")
REFERENCE = re.compile(r"(?<=[:,\[] )[a-z_]+[./][a-z_/.]+")


Edit = Callable[[random.Random, list[str], int], list[str] | None]
"""A mistake in the line of the given index; ``None`` if the line does not allow it."""


class Mutant(NamedTuple):
    """A document with a mistake in line ``line``, and the file that is checked."""

    kind: str
    file: str
    entry: str
    text: str
    line: int


def _in_line(pattern: re.Pattern[str], change: Callable[[random.Random, str], str]) -> Edit:
    """Returns a mistake that changes a match of a pattern."""

    def edit(rng: random.Random, lines: list[str], number: int) -> list[str] | None:
        matches = list(pattern.finditer(lines[number].partition(" #")[0]))
        if not matches:
            return None
        match = rng.choice(matches)
        line = lines[number]
        new = line[: match.start()] + change(rng, match[0]) + line[match.end() :]
        return None if new == line else [*lines[:number], new, *lines[number + 1 :]]

    return edit


def _swap(rng: random.Random, word: str) -> str:
    i = rng.randrange(len(word) - 1)
    return word[:i] + word[i + 1] + word[i] + word[i + 2 :]


def _drop(rng: random.Random, word: str) -> str:
    i = rng.randrange(len(word))
    return word[:i] + word[i + 1 :]


def _indent(spaces: int) -> Edit:
    def edit(rng: random.Random, lines: list[str], number: int) -> list[str] | None:
        line = lines[number]
        depth = len(line) - len(line.lstrip())
        if depth + spaces < 0 or not line.strip() or line.lstrip().startswith("#"):
            return None
        return [*lines[:number], " " * (depth + spaces) + line.lstrip(), *lines[number + 1 :]]

    return edit


def _tab(rng: random.Random, lines: list[str], number: int) -> list[str] | None:
    if not lines[number].startswith("  "):
        return None
    return [*lines[:number], "\t" + lines[number].lstrip(), *lines[number + 1 :]]


def _delete(rng: random.Random, lines: list[str], number: int) -> list[str] | None:
    return None if not KEY.search(lines[number]) else [*lines[:number], *lines[number + 1 :]]


def _repeat(rng: random.Random, lines: list[str], number: int) -> list[str] | None:
    is_entry = re.match(r" *[a-z_]+: \S", lines[number])
    return [*lines[: number + 1], *lines[number:]] if is_entry else None


KINDS: dict[str, Edit] = {
    "letter of a key dropped": _in_line(KEY, _drop),
    "letters of a key swapped": _in_line(KEY, _swap),
    "key in capitals": _in_line(KEY, lambda _, k: k.upper()),
    "key with a capital": _in_line(KEY, lambda _, k: k.capitalize()),
    "- for _": _in_line(re.compile(r"[a-z]+_[a-z]+(?=:)"), lambda _, k: k.replace("_", "-")),
    "plural or singular": _in_line(KEY, lambda _, k: k[:-1] if k[-1] == "s" else k + "s"),
    "wrong unit": _in_line(UNIT, lambda r, u: r.choice([" K", " kg", " V", " bar"])),
    "unknown unit": _in_line(UNIT, lambda r, u: u + "x"),
    "unit dropped": _in_line(UNIT, lambda _, u: ""),
    "decimal comma": _in_line(re.compile(r"\d\.\d"), lambda _, n: n.replace(".", ",")),
    "letter o for 0": _in_line(re.compile(r"(?<=\d)0"), lambda _, n: "O"),
    "missing colon": _in_line(re.compile(r"(?<=[a-z]): "), lambda _, c: " "),
    "no space after colon": _in_line(re.compile(r"(?<=[a-z]): (?=\S)"), lambda _, c: ":"),
    "= for :": _in_line(re.compile(r"(?<=[a-z]): "), lambda _, c: " = "),
    "missing comma": _in_line(re.compile(r", "), lambda _, c: " "),
    "; for ,": _in_line(re.compile(r", "), lambda _, c: "; "),
    "closing bracket missing": _in_line(re.compile(r"[}\]]"), lambda _, c: ""),
    "opening bracket missing": _in_line(re.compile(r"[{\[]"), lambda _, c: ""),
    "round brackets": _in_line(re.compile(r"\[[^\[\]{}]*\]"), lambda _, c: f"({c[1:-1]})"),
    "quote not closed": _in_line(re.compile(r'(?<=\w)"'), lambda _, c: ""),
    "one space more": _indent(1),
    "two spaces more": _indent(2),
    "two spaces less": _indent(-2),
    "tab": _tab,
    "line deleted": _delete,
    "line repeated": _repeat,
    "reference misspelt": _in_line(REFERENCE, _swap),
    "reference cut": _in_line(REFERENCE, _drop),
    "sign flipped": _in_line(re.compile(r"(?<=[:\[,] )\d"), lambda _, n: "-" + n),
    "number as text": _in_line(re.compile(r"(?<=: )\d+(?=[,}]|$)"), lambda _, n: f'"{n}"'),
    "list for a value": _in_line(re.compile(r"(?<=: )[\w.]+(?=[,}]|$)"), lambda _, v: f"[{v}]"),
    "wrong extension": _in_line(re.compile(r"(?<=\.)(yaml|xacro|stl)"), lambda _, e: e[:-1]),
    "xacro in YAML": _in_line(re.compile(r"(?<=: )\d[\w.]*(?=[,}]|$)"), lambda _, v: "$(arg x)"),
}  # fmt: skip


def documents(folder: Path) -> list[tuple[str, str]]:
    """Writes the valid documents; returns the name of each, and of the file to check for it."""
    write(folder, {})
    shutil.copytree(EXAMPLES, folder / "examples")
    own = [(name, name) for name in FILES if name.endswith(".yaml") and "/" not in name]
    own = [(n, "robot.yaml" if n == "calibration.yaml" else n) for n, _ in own]
    own.append(("parts/tools/box/module.yaml", "robot.yaml"))
    found = sorted(p.relative_to(folder).as_posix() for p in folder.glob("examples/*/*.yaml"))
    return own + [
        (n, n) for n in found if not set(n.split("/")) & {"bus_faults", *PACKAGES, "9wd9ws"}
    ]


def mutants(folder: Path, names: list[tuple[str, str]], count: int, seed: int) -> Iterator[Mutant]:
    """Yields mutants of the documents: the kinds in turn, documents and lines at random."""
    rng = random.Random(seed)
    kinds = list(KINDS)
    texts = {file: (folder / file).read_text(encoding="utf-8").splitlines() for file, _ in names}
    for index in range(count):
        kind = kinds[index % len(kinds)]
        for _ in range(200):
            file, entry = rng.choice(names)
            lines = texts[file]
            number = rng.randrange(len(lines))
            is_text = re.match(r"\s*(#|description:|source:)", lines[number])
            changed = None if is_text else KINDS[kind](rng, lines, number)
            if changed is not None and changed != lines:
                yield Mutant(kind, file, entry, "\n".join(changed) + "\n", number + 1)
                break


class Tally(NamedTuple):
    """Counts of the mutants of a kind."""

    total: int = 0
    harmless: int = 0
    silent: int = 0
    near: int = 0  # the first error is at most one line from the mistake
    single: int = 0  # exactly one error or, without errors, one warning
    restored: int = 0  # a proposal removes all errors


def state(compilation: Compilation) -> str:
    """Returns the model without lines and columns, which a mistake can move."""
    text = to_json(compilation.model) if compilation.model is not None else ""
    return re.sub(r'"(end_)?(line|column)": \d+', "", text)


def measure(count: int, seed: int, show: str = "") -> dict[str, Tally]:  # in a temporary folder
    tallies: dict[str, Tally] = defaultdict(Tally)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        names = documents(folder)
        clean = {}
        for _, entry in names:
            compilation = compile_file(folder / entry)
            clean[entry] = state(compilation), {d.message for d in compilation.report}
        for mutant in mutants(folder, names, count, seed):
            path = folder / mutant.file
            original = path.read_text(encoding="utf-8")
            path.write_text(mutant.text, encoding="utf-8")
            compilation = compile_file(folder / mutant.entry)
            model, known = clean[mutant.entry]
            new = [d for d in compilation.report.sorted() if d.message not in known]
            serious = [d for d in new if d.severity is Severity.ERROR] or [
                d for d in new if d.severity is Severity.WARNING
            ]
            old = tallies[mutant.kind]
            harmless = not serious and state(compilation) == model
            near = single = restored = False
            if serious:
                span = serious[0].span
                near = (
                    span is not None
                    and abs(span.line - mutant.line) <= 1
                    and Path(span.file).resolve() == path.resolve()
                )
                single = len(serious) == 1
                for fix in [f for d in serious for f in d.fixes][:6]:
                    if Path(fix.span.file).is_file():
                        apply(fix)
                        restored = restored or not compile_file(folder / mutant.entry).report.errors
                        path.write_text(mutant.text, encoding="utf-8")
                    if restored:
                        break
            if show == mutant.kind and not harmless and not (near and single):
                print("---", mutant.file, mutant.line, mutant.text.splitlines()[mutant.line - 1])
                for d in serious[:3]:
                    print("   ", d.code.number, d.span and d.span.line, d.message, "|", d.hint)
            path.write_text(original, encoding="utf-8")
            tallies[mutant.kind] = Tally(
                old.total + 1,
                old.harmless + harmless,
                old.silent + (not serious and not harmless),
                old.near + near,
                old.single + single,
                old.restored + restored,
            )
    return dict(tallies)


def shares(tally: Tally) -> tuple[float, float, float, float]:
    """Returns the shares reported or harmless; and of the reported: near, single, restored."""
    reported = max(tally.total - tally.harmless - tally.silent, 1)
    return (
        1 - tally.silent / tally.total,
        tally.near / reported,
        tally.single / reported,
        tally.restored / reported,
    )


def total(tallies: dict[str, Tally]) -> Tally:
    return Tally(*map(sum, zip(*tallies.values(), strict=True)))


def main() -> None:
    count, seed = int(sys.argv[1]), int(sys.argv[2])
    tallies = measure(count, seed, sys.argv[4] if len(sys.argv) > 4 else "")
    print(f"{'kind':28} {'n':>5} {'harmless':>8} {'seen':>6} {'line':>6} {'one':>6} {'fixed':>6}")
    for kind, tally in [*tallies.items(), ("all", total(tallies))]:
        row = " ".join(f"{share:6.1%}" for share in shares(tally))
        print(f"{kind:28} {tally.total:5} {tally.harmless:8} {row}")


if __name__ == "__main__":
    main()
