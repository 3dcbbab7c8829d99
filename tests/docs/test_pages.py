"""The pages are correct: links exist, and commands print the output that a page shows."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.cli.conftest import GOOD
from thorvaldc.runtime.calculators import base_calculator

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*/README.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        if "://" not in target:
            assert (page.parent / target).exists(), target


MEASUREMENT = re.compile(
    r"times (?:real time|as (?:fast|long)|faster|slower)|as fast as real time|steps/s|Monte Carlo"
    r"|steps per second of|robot-seconds|processor time (?:of|per)|wall time|in the median"
    r"|[Mm]easured (?:on|once|over)\b|Measured in|about \d+ (?:us|µs|ns)\b|\(MuJoCo\)"
)
"""Words of a statement that somebody measured or simulated."""
COMMAND = re.compile(
    r"python -m bench ([\w ]+)`|\b(bench/\w+\.py|tests/[\w/]+\.py|examples/[\w/]+\.py)"
    r"|`make bench`[^.]{0,3}`(\w+)`"
)
DATE = re.compile(r"easured in [A-Z][a-z]+ 20\d\d on\s")
"""The source of a statement that no command repeats: when and on which machine."""


# Changes are events of their time, decisions have a date, and diagnostics state causes.
STATING = [p for p in PAGES if not {"CHANGELOG.md", "diagnostics", "adr"} & {*p.parts, p.name}]


@pytest.mark.parametrize("page", STATING, ids=lambda page: str(page.relative_to(ROOT)))
def test_measured_figures_state_where_they_come_from(page: Path) -> None:
    """The section names a command that exists, or the date and the machine."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for section in re.split(r"^(?=#+ )", text, flags=re.M):
        figures = MEASUREMENT.search(section)
        commands = COMMAND.findall(section)
        title = section.partition("\n")[0]
        assert figures is None or commands or DATE.search(section), (title, figures)
        for modules, path, module in commands:
            for name in [*modules.split(), module]:
                assert not name or (ROOT / f"bench/{name}.py").is_file(), (title, name)
            assert not path or (ROOT / path).is_file(), (title, path)


def test_the_index_leads_to_every_page() -> None:
    docs = ROOT / "docs"
    links = set(re.findall(r"\]\(([^)#]+)", (docs / "index.md").read_text(encoding="utf-8")))
    pages = [*docs.glob("*.md"), *docs.glob("how-to/*.md"), *docs.glob("explanation/*.md")]
    assert {str(page.relative_to(docs)) for page in pages} - links == {"index.md"}


def test_no_page_installs_from_an_index_that_does_not_have_the_package() -> None:
    """A release on an index changes `docs/install.md` and this test."""
    assert "on no package index yet" in (ROOT / "docs/install.md").read_text(encoding="utf-8")
    texts = [*PAGES, *(ROOT / "templates").rglob("*"), *(ROOT / "editors").rglob("*.md")]
    texts += [ROOT / "action.yml", *(ROOT / "thorvaldc").rglob("*.py")]
    by_name = re.compile(
        r"pip (install|download)[^\n`]*?[ '\"](thorvaldc(-runtime)?)(\[|'| |`|$|=)"
    )
    for file in filter(Path.is_file, texts):
        if file.parent.name == "__pycache__":
            continue
        for line in file.read_bytes().decode("utf-8", "replace").splitlines():
            assert "--find-links" in line or not by_name.search(line), (file, line)
            assert "pypi.org/project/thorvaldc" not in line, file


def test_commands_that_move_a_robot_begin_with_zero() -> None:
    """A source of twists commands zero first, unless the robot file says otherwise."""
    found = 0
    for page in (*PAGES, ROOT / "templates" / "ros2" / "README.md"):
        text = page.read_text(encoding="utf-8")
        first = re.search(r"^ *ros2 topic pub .*cmd_vel.*$", text, re.MULTILINE)
        if first is not None:
            assert "linear" not in first[0], page
            found += 1
    assert found == 3


def test_the_page_of_examples_has_every_example() -> None:
    page = (ROOT / "docs/examples.md").read_text(encoding="utf-8")
    for readme in ROOT.glob("examples/*/README.md"):
        assert f"(../examples/{readme.parent.name})" in page, readme.parent.name


def same_numbers(printed: str, shown: str) -> bool:
    """Returns whether a page shows what a program prints.

    The speed of a simulation depends on the machine, and so does the last digit of its numbers.
    """
    texts = [re.sub(r"\d+x", "~", text).split() for text in (printed, shown)]
    return len(texts[0]) == len(texts[1]) and all(map(_same, *texts))


def _same(printed: str, shown: str) -> bool:
    numbers = [re.fullmatch(r"\d+(\.\d+)", text) for text in (printed, shown)]
    if None in numbers:
        return printed == shown
    digits = max(len(number[1]) - 1 for number in numbers if number)
    return abs(float(printed) - float(shown)) < 1.5 * 10.0**-digits


def sample(page: str, first_line: str) -> list[str]:
    """Returns the lines of the block of a page that begins with a line, without elisions."""
    text = (ROOT / page).read_text(encoding="utf-8")
    block = text.partition(f"```\n{first_line}")[2].partition("```\n")[0]
    assert block
    return [line for line in [first_line, *block.splitlines()] if line.strip("." + " ")]


def printed_by(folder: Path, *command: str) -> list[str]:
    output = subprocess.run(
        [sys.executable, "-m", "thorvaldc", *command],
        cwd=folder,
        env={"PYTHONPATH": ":".join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    return output.splitlines()


def check_sample(shown: list[str], printed: list[str]) -> None:
    """Checks that a program prints the lines of a sample in their order."""
    rest = iter(printed)
    for line in shown:
        assert any(same_numbers(other, line) for other in rest), line


def test_the_robot_of_the_readme_has_no_warning(tmp_path: Path) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    robot = re.findall(r"^```yaml\n(.*?)^```$", text, re.M | re.S)[0]
    (tmp_path / "robot.yaml").write_text(robot, encoding="utf-8")
    assert printed_by(tmp_path, "check", "--strict", "robot.yaml")[:1] == [
        "robot.yaml: scout, 4 wheels (4 driven, 4 steered), 142.2 kg"
    ]


def test_the_page_on_comparisons_shows_what_diff_prints(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(GOOD, encoding="utf-8")
    other = GOOD.replace("width: 0.9 m", "width: 1 m")
    (tmp_path / "other.yaml").write_text(other, encoding="utf-8")
    printed = printed_by(tmp_path, "diff", "robot.yaml", "other.yaml")
    check_sample(sample("docs/compare.md", "good"), printed)


@pytest.mark.slow
def test_the_page_on_origins_shows_what_why_prints() -> None:
    printed = printed_by(ROOT / "examples/4wd4ws_wide", "why", "robot.yaml", "wheels.fl.radius")
    check_sample(sample("docs/why.md", "wheels.fl_wheel.radius = 0.2 m"), printed)


@pytest.mark.slow
def test_the_table_of_the_first_look_is_that_of_the_demo(tmp_path: Path) -> None:
    names = ("1wd1ws_front/robot", "car/robot", "fleet_of_four/fleet")
    files = [f"examples/{name}.yaml" for name in names]
    printed = printed_by(ROOT, "demo", *files, "-o", str(tmp_path / "build"))
    heading = next(line for line in printed if line.startswith("robot "))
    page = (ROOT / "docs/first-look.md").read_text(encoding="utf-8")
    shown_heading = next(line for line in page.splitlines() if line.startswith("robot "))
    assert heading.split() == shown_heading.split()
    check_sample(sample("docs/first-look.md", shown_heading), printed)


def test_the_first_look_shows_what_the_commands_print(tmp_path: Path) -> None:
    page = (ROOT / "docs/first-look.md").read_text(encoding="utf-8")
    document = re.search(r"```yaml\n(.*?)```", page, re.S)
    assert document is not None
    (tmp_path / "first.yaml").write_text(document[1], encoding="utf-8")
    session = re.search(r"```\n(\$ thorvaldc check first\.yaml\n.*?)```", page, re.S)
    assert session is not None
    shown = re.split(r"^\$ thorvaldc (.*)\n", session[1], flags=re.M)[1:]
    assert len(shown) == 6
    for command, output in zip(shown[::2], shown[1::2], strict=True):
        done = subprocess.run(
            [sys.executable, "-m", "thorvaldc", *command.split()],
            cwd=tmp_path,
            env={"PYTHONPATH": ":".join(sys.path)},
            capture_output=True,
            text=True,
            check=True,
        )
        assert same_numbers(done.stdout, output), command


def test_the_page_of_commands_names_every_command() -> None:
    from thorvaldc.cli.main import all_commands

    page = (ROOT / "docs/commands.md").read_text(encoding="utf-8")
    for entry in all_commands():
        assert entry.hidden or entry.group or re.search(rf"`(thorvaldc )?{entry.name}\b", page), (
            entry.name
        )


@pytest.mark.parametrize(
    ("page", "kind"),
    [
        ("language", "robot"),
        ("language", "fleet"),
        ("language", "module"),
        ("scenarios", "scenario"),
    ],
)
def test_the_page_of_a_document_names_its_keys(page: str, kind: str) -> None:
    text = (ROOT / f"docs/{page}.md").read_text(encoding="utf-8")
    schema = json.loads((ROOT / f"thorvaldc/schema/{kind}.schema.json").read_text(encoding="utf-8"))
    # Every kind of document has these two.
    keys = schema["properties"].keys() - {"description", "accept"}
    assert [key for key in keys if not re.search(rf"\b{key}\b", text)] == []


def test_the_page_of_base_calculators_has_a_row_for_each() -> None:
    page = (ROOT / "docs/base-calculators.md").read_text(encoding="utf-8")
    names = base_calculator.PLUGINS.names()
    assert len(names) >= 3
    assert [name for name in names if f"\n| `{name}` |" not in page] == []


def test_the_architecture_page_has_the_layers_that_are_checked() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    layers = settings["tool"]["importlinter"]["contracts"][0]["layers"]
    checked = [sorted(re.findall(r"\w+", layer)) for layer in layers if "__main__" not in layer]
    page = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`[^|]*`) \|", page, re.M)
    shown = [sorted(re.findall(r"\w+", row)) for row in rows]
    assert shown == checked
    for name in [name for layer in checked for name in layer]:
        assert (ROOT / "thorvaldc" / name).is_dir() or (ROOT / f"thorvaldc/{name}.py").is_file()


def script(page: str, first_line: str) -> str:
    text = (ROOT / page).read_text(encoding="utf-8")
    block = re.search(rf"```python\n({first_line}.*?)```", text, re.S)
    assert block is not None
    return block[1]


def test_the_environment_of_the_page_runs() -> None:
    """In a new process, with warnings as errors."""
    example = script("docs/batches.md", "import gymnasium")
    last = "print(info['true_pose'], sorted(info))\n"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", example + last],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": ":".join(p for p in sys.path if p)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == ""
    assert done.stdout.startswith("[")
    assert "cause" in done.stdout  # the episode ends after its duration
