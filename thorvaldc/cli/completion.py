"""Completion of commands, options and values in the shells bash, zsh and fish.

typer generates the shell scripts (``thorvaldc --install-completion``).  A script starts the program
with ``_THORVALDC_COMPLETE`` in its environment at each press of the Tab key, so the answer must
come at once: the modules of the commands are loaded with placeholders for all other packages.
"""

from __future__ import annotations

import contextlib
import importlib.abc
import importlib.machinery
import io
import os
import sys
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any

COMPLETE_VARIABLE = "_THORVALDC_COMPLETE"
LOADED = ("thorvaldc.cli", "thorvaldc.diagnostics")
"""Packages that are loaded to complete an option; all other packages are placeholders."""


def is_completion() -> bool:
    """Returns whether a shell asks for the completion of a command line."""
    return os.environ.get(COMPLETE_VARIABLE, "").startswith("complete_")


@contextlib.contextmanager
def shell_completion() -> Iterator[None]:
    """Adapts the answer of typer to the shell that asks for a completion.

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
            yield
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


class _AnyName(type):
    """Metaclass of a placeholder: every attribute, call and union is the placeholder itself."""

    def __getattr__(cls, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return cls

    def __call__(cls, *args: object, **kwargs: object) -> Any:
        return cls

    def __iter__(cls) -> Iterator[Any]:
        return iter(())


class _Placeholder(metaclass=_AnyName):
    """Stands for a class, function or constant of a module that is not loaded."""


class _PlaceholderModule(ModuleType):
    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _Placeholder


class _PlaceholderFinder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds a placeholder for each module of the package except those in ``LOADED``."""

    def find_spec(
        self, fullname: str, path: object = None, target: object = None
    ) -> importlib.machinery.ModuleSpec | None:
        if not fullname.startswith("thorvaldc.") or fullname.startswith(LOADED):
            return None
        return importlib.machinery.ModuleSpec(fullname, self, is_package=True)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        return _PlaceholderModule(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        pass


@contextlib.contextmanager
def placeholders() -> Iterator[None]:
    """Imports placeholders instead of the compiler, the simulation and the runtime within the
    block, to read the options of a command."""
    finder = _PlaceholderFinder()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        package = sys.modules["thorvaldc"]
        for name, module in list(sys.modules.items()):
            if isinstance(module, _PlaceholderModule):
                del sys.modules[name]
                if vars(package).get(name.removeprefix("thorvaldc.")) is module:
                    delattr(package, name.removeprefix("thorvaldc."))
