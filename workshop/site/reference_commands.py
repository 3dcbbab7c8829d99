"""The page of the command line: every command with its arguments and options."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from thorvaldc.cli.main import all_commands, click_command
from thorvaldc.tool_folders import CommandEntry


def page() -> str:
    lines = [
        "# Options of the commands",
        "",
        "Every command with its arguments and options, as `thorvaldc COMMAND --help` prints them."
        " [Commands](../commands.md) lists them by task.",
    ]
    for entry in all_commands():
        if entry.target and not entry.hidden:
            lines += section(entry.name, entry)
    return "\n".join(lines) + "\n"


def section(name: str, entry: CommandEntry) -> Iterator[str]:
    command = click_command(entry.name)
    parameters = [parameter for parameter in command.params if not parameter.hidden]
    arguments = [p for p in parameters if p.param_type_name == "argument"]
    options = [p for p in parameters if p.param_type_name == "option"]
    usage = [f"thorvaldc {name}"]
    for argument in arguments:
        metavar = argument.metavar or argument.name.upper()
        metavar += "..." if argument.nargs == -1 else ""
        usage.append(metavar if argument.required else f"[{metavar}]")
    yield from ("", f"## {name}", "", entry.help, "", "```text")
    yield from (" ".join(usage) + (" [OPTIONS]" if options else ""), "```", "")
    if parameters:
        yield from ("| argument or option | meaning | default |", "| --- | --- | --- |")
    for argument in arguments:
        metavar = argument.metavar or argument.name.upper()
        yield row(metavar, argument.help, "required" if argument.required else "")
    for option in options:
        forms = ", ".join([*option.opts, *option.secondary_opts])
        if not option.is_flag:
            forms += f" {option.metavar or 'TEXT'}"
        yield row(forms, option.help, default(option))


def default(option: Any) -> str:
    if isinstance(option.show_default, str):
        return option.show_default
    if option.is_flag or option.default in (None, "", [], ()):
        return "required" if option.required else ""
    return str(option.default)


def row(name: str, meaning: str | None, value: str) -> str:
    cells = [cell.replace("|", "\\|") for cell in (meaning or "", value)]
    return f"| `{name}` | " + " | ".join(cells) + " |"
