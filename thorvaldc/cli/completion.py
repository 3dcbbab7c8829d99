"""Completion of commands, options and values in the shells bash, zsh and fish.

typer generates the shell scripts (``thorvaldc --install-completion``).  A script starts the program
with ``_THORVALDC_COMPLETE`` in its environment at each press of the Tab key, so the answer must
come at once: the file of a command imports only what its options need, and a completer of values
imports what it needs when it is called.
"""

from __future__ import annotations

import contextlib
import functools
import io
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import typer

COMPLETE_VARIABLE = "_THORVALDC_COMPLETE"


def is_completion() -> bool:
    """Returns whether a shell asks for the completion of a command line."""
    return os.environ.get(COMPLETE_VARIABLE, "").startswith("complete_")


@contextlib.contextmanager
def shell_completion() -> Iterator[list[str]]:
    """Adapts the answer of typer to the shell that asks for a completion, and yields the words of
    the command line.

    bash splits words at ``=`` and ``:``, and replaces only the part after them.
    """
    # typer formats help texts with rich if rich is installed. Its import takes 100 ms.
    sys.modules.setdefault("rich", None)  # type: ignore[arg-type]
    prefix = ""
    if os.environ[COMPLETE_VARIABLE] == "complete_bash":
        words, number, prefix = joined_words(
            os.environ.get("COMP_WORDS", "").split(), int(os.environ.get("COMP_CWORD", "0"))
        )
        os.environ["COMP_WORDS"], os.environ["COMP_CWORD"] = "\n".join(words), str(number)
    answer = io.StringIO()
    try:
        with contextlib.redirect_stdout(answer):
            yield (os.environ.get("COMP_WORDS") or os.environ["_TYPER_COMPLETE_ARGS"]).split()[1:]
    finally:
        for line in answer.getvalue().splitlines():
            print(line.removeprefix(prefix))


def joined_words(words: Sequence[str], number: int) -> tuple[list[str], int, str]:
    """Joins the words of a command line that bash has split at ``=`` and ``:``.

    Returns the words, the index of the incomplete word, and the part of the incomplete word that
    bash does not replace.  An option and its value, as in ``--bus=sim:a``, remain two words.
    """
    words = list(words[: number + 1])
    if number >= len(words):  # the incomplete word is empty
        words.append("")
    joined: list[str] = []
    prefix = ""
    glued = False
    for word in words:
        if word in ("=", ":") and joined:
            if word == "=" and joined[-1].startswith("--"):
                joined.append("")
            else:
                joined[-1] += word
            prefix, glued = joined[-1], True
        elif glued:
            joined[-1] += word
            glued = False
        else:
            joined.append(word)
            prefix = ""
    return joined, len(joined) - 1, prefix


# -- values of options and arguments ----------------------------------------------------

Values = Callable[[typer.Context, str], list[str]]


def completer(propose: Callable[[typer.Context, str], Iterator[str]]) -> Values:
    """Returns a completer with the proposed values that begin with the incomplete word.

    A completer that fails proposes nothing.
    """

    @functools.wraps(propose)
    def values(ctx: typer.Context, incomplete: str) -> list[str]:
        try:
            return [value for value in propose(ctx, incomplete) if value.startswith(incomplete)]
        except Exception:
            # A shell would print a traceback into the command line that the user types.
            return []

    return values


@completer
def target_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes targets, also after a comma."""
    from thorvaldc import backends

    chosen = incomplete.split(",")[:-1]
    for name in backends.names():
        if name not in chosen:
            yield ",".join([*chosen, name])


@completer
def preset_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the presets of new robots."""
    from thorvaldc.compiler.scaffolding import presets

    yield from presets()


@completer
def module_types(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the module types of the library and of the folders of ``--library``."""
    from thorvaldc.compiler.modules.library import Library

    folders = [(Path(name), name) for name in ctx.params.get("library") or ()]
    yield from Library(folders).names()


@completer
def diagnostic_codes(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes numbers of diagnostics, and names where the word begins as none."""
    from thorvaldc.diagnostics.codes import all_codes

    for code in all_codes():
        yield code.number
        if incomplete:
            yield code.name


@completer
def schema_kinds(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the kinds of documents that have a schema."""
    from thorvaldc.schema import KINDS

    yield from (*KINDS, "model")


@completer
def view_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the named viewing directions of pictures."""
    from thorvaldc.simulation.pictures.render import VIEWS

    yield from VIEWS


@completer
def driver_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the running drivers of this user."""
    yield from _socket_names("-control")


@completer
def service_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the services of the running driver in the argument NAME."""
    from thorvaldc.runtime.control_channel import ControlClient

    client = ControlClient(ctx.params["name"], answer_time=0.2)
    try:
        yield from (service["name"] for service in client.call("services"))
    finally:
        client.close()


@completer
def bus_interfaces(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes CAN interfaces: simulated buses that run, SocketCAN, serial ports and the rest."""
    name, equals, _ = incomplete.partition("=")
    start = name + equals if equals else ""
    yield start + "virtual"
    yield from (f"{start}sim:{bus}" for bus in _socket_names("", without="-control"))
    for interface in sorted(Path("/sys/class/net").glob("*can*")):
        yield f"{start}socketcan:{interface.name}"
    for port in (*Path("/dev").glob("ttyACM*"), *Path("/dev").glob("ttyUSB*")):
        yield f"{start}slcan:{port}"
    yield start + "udp"


@completer
def base_names(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the bases that ``teleop --on`` drives."""
    yield from ("sim", "ideal", *bus_interfaces(ctx, ""))


@completer
def scenario_variables(ctx: typer.Context, incomplete: str) -> Iterator[str]:
    """Proposes the paths of the numbers, texts and flags of the scenario, for ``--set``."""
    from thorvaldc.compiler.source.reader import read_file
    from thorvaldc.diagnostics import Report

    # An option without its value ends the parsing, and the words before it are in ``args``.
    words = (ctx.params.get("scenario"), ctx.params.get("file"), *ctx.args)
    name = next(word for word in words if word and Path(word).is_file())
    document = read_file(Path(name), name, Report())
    if document is not None:
        yield from (f"{path}=" for path in _paths(document.plain(), ""))


def _paths(value: Any, path: str) -> Iterator[str]:
    """Returns the paths of the values in a document that are neither mappings nor lists."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _paths(inner, f"{path}.{key}" if path else str(key))
    elif path and not isinstance(value, list):
        yield path


def _socket_names(suffix: str, without: str = "\n") -> Iterator[str]:
    """Returns the sorted names of the local sockets of this user that a program listens on."""
    import socket

    from thorvaldc.can.local_socket import runtime_directory

    for path in sorted(runtime_directory().glob(f"*{suffix}.sock")):
        name = path.name.removesuffix(".sock")
        if name.endswith(without):
            continue
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(0.05)
            try:
                probe.connect(os.fspath(path))
            except OSError:
                continue  # the program was killed
        yield name.removesuffix(suffix)
