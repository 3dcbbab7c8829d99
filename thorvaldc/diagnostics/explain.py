"""The page of a diagnostic code."""

from __future__ import annotations

from pathlib import Path

from thorvaldc.diagnostics.codes import CODES, Code
from thorvaldc.diagnostics.suggest import did_you_mean

_PACKAGE = Path(__file__).resolve().parent.parent


class UnknownCode(LookupError):
    """There is no such code; ``hint`` names the nearest."""

    def __init__(self, asked: str, hint: str | None) -> None:
        super().__init__(f"there is no code `{asked}`")
        self.hint = hint


def find_code(asked: str) -> Code:
    """The code for ``TV501``, ``501`` or ``can-id-duplicate``.  Raises UnknownCode."""
    text = asked.strip()
    found = CODES.get(text.lower())
    if found is not None:
        return found
    number = text.upper() if text.upper().startswith("TV") else f"TV{text}"
    for code in CODES.values():
        if code.number == number:
            return code
    numbers = [code.number for code in CODES.values()]
    looks_like_number = text.isdigit() or text.upper().startswith("TV")
    raise UnknownCode(
        asked, did_you_mean(number if looks_like_number else text, [*CODES, *numbers])
    )


def page(code: Code) -> str:
    """The code's page in Markdown; its meaning alone where the page is not installed."""
    path = _folder() / f"{code.number}.md"
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return f"# {code.number} {code.name}\n\n{code.meaning}\n"


def explain(asked: str) -> str:
    """The page of the code that was asked for.  Raises UnknownCode."""
    return page(find_code(asked))


def _folder() -> Path:
    """In a checkout its own pages, which may be newer than an installed copy."""
    root = _PACKAGE.parent
    if (root / "pyproject.toml").is_file():
        return root / "docs" / "diagnostics"
    return _PACKAGE / "_data" / "diagnostics"
