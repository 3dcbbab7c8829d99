"""Finds a diagnostic code and its documentation page."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.diagnostics.codes import CODES, Code
from thorvaldc.diagnostics.report import did_you_mean

_PACKAGE = Path(__file__).resolve().parent.parent


class UnknownCode(LookupError):
    """Raised if no diagnostic code has the requested number or name.

    - ``hint``: suggestion of a similar code, or ``None``.
    """

    def __init__(self, number_or_name: str, hint: str | None) -> None:
        super().__init__(f"there is no code `{number_or_name}`")
        self.hint = hint


def find_code(number_or_name: str) -> Code:
    """Returns the diagnostic code with a number such as ``TV501`` or a name.

    - ``number_or_name``: ``TV501``, ``501`` or ``can-id-duplicate``, for example.

    Raises ``UnknownCode`` if no diagnostic code has this number or name.
    """
    text = number_or_name.strip()
    if text.lower() in CODES:
        return CODES[text.lower()]
    number = text.upper() if text.upper().startswith("TV") else f"TV{text}"
    for code in CODES.values():
        if code.number == number:
            return code
    numbers = [code.number for code in CODES.values()]
    looks_like_number = text.isdigit() or text.upper().startswith("TV")
    hint = did_you_mean(number if looks_like_number else text, [*CODES, *numbers])
    raise UnknownCode(number_or_name, hint)


def page(code: Code) -> str:
    """Returns the documentation page of a diagnostic code in Markdown.

    If the documentation page is not installed, returns the summary of the diagnostic code.
    """
    path = _folder() / f"{code.number}.md"
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return f"# {code.number} {code.name}\n\n{code.summary}\n"


def explain(number_or_name: str) -> str:
    """Returns the documentation page of a diagnostic code in Markdown.

    Raises ``UnknownCode`` if no diagnostic code has this number or name.
    """
    return page(find_code(number_or_name))


def _folder() -> Path:
    """Returns the folder with the documentation pages of the diagnostic codes.

    In the source repository, the documentation pages are in the folder ``docs/diagnostics``.  An
    installed package contains a copy of the documentation pages.
    """
    root = _PACKAGE.parent
    if (root / "pyproject.toml").is_file():
        return root / "docs" / "diagnostics"
    return _PACKAGE / "_data" / "diagnostics"
