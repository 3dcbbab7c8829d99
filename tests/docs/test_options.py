"""Commands and options that pages name exist."""

from __future__ import annotations

import re
from pathlib import Path

from thorvaldc.cli.main import all_commands, click_command
from thorvaldc.tool_folders import CommandEntry

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "examples/**/*.md", "templates/**/*.md")
    for path in ROOT.glob(pattern)
)


def options_of(entry: CommandEntry) -> set[str]:
    parameters = click_command(entry.name).params
    return {option for p in parameters for option in (*p.opts, *p.secondary_opts)} | {
        "-h",
        "--help",
    }


OPTIONS: dict[str, set[str]] = {"--help": set(), "--install-completion": set()}
OPTIONS["links"] = set()  # of the package that contributing.md builds
for entry in all_commands():
    OPTIONS[entry.name] = options_of(entry) if entry.target else {"-h", "--help"}


def unknown_options(page: str) -> list[str]:
    """Returns the commands of a page that do not exist, or that have an unknown option."""
    commands = re.findall(r"`thorvaldc (-?[a-z][^`#;|>\n]*)`", page)
    for block in re.findall(r"```.*?```", page, re.S):
        commands += re.findall(r"^\s*(?:\$ |- run: )?thorvaldc ([a-z][^`#;|>\n]*)", block, re.M)
    names = "|".join(OPTIONS)
    commands += re.findall(rf"`((?:{names}) -[^`]*)`", page)  # `check --strict`
    return [command for command in commands if not is_known(command.split())]


def is_known(words: list[str]) -> bool:
    name = " ".join(words[:2]) if " ".join(words[:2]) in OPTIONS else words[0]
    named = {
        word.split("=")[0].rstrip(".,:)]") for word in words[1:] if re.match(r"--?[a-z]", word)
    }
    return name in OPTIONS and named <= OPTIONS[name]


def test_options_in_pages_exist() -> None:
    unknown = {page: unknown_options(page.read_text(encoding="utf-8")) for page in PAGES}
    assert {page: commands for page, commands in unknown.items() if commands} == {}


def test_an_unknown_option_is_noticed() -> None:
    page = (
        "`thorvaldc check F`, `check --strict`\n$ thorvaldc biuld F\n`thorvaldc sim F --tvist 1`\n"
    )
    page += "```\n$ thorvaldc biuld F\n```\nthorvaldc is a compiler\n"
    assert unknown_options(page) == ["sim F --tvist 1", "biuld F"]
    assert unknown_options("`can scan --activ`") == ["can scan --activ"]
