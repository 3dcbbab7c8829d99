"""Converts unquoted YAML scalars to Python values by the core schema of YAML 1.2.

YAML 1.1 and YAML 1.2 interpret some unquoted values differently.  For example, YAML 1.1 reads
``on`` as true and ``010`` as 8.  YAML 1.2 reads ``on`` as a text and ``010`` as 10.  The compiler
reports an error for each value that YAML 1.1 and YAML 1.2 interpret differently.
"""

from __future__ import annotations

import math
import re

from thorvaldc.compiler.source.node import Value
from thorvaldc.diagnostics import Proposal, Report, Span

_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_HEX_OR_OCTAL = re.compile(r"0x[0-9a-fA-F]+|0o[0-7]+")

_WORDS: dict[str, bool | None] = {
    "": None,
    "~": None,
    "null": None,
    "Null": None,
    "NULL": None,
    "true": True,
    "True": True,
    "TRUE": True,
    "false": False,
    "False": False,
    "FALSE": False,
}
_AMBIGUOUS = {
    form: truth
    for words, truth in ((("on", "yes", "y"), True), (("off", "no", "n"), False))
    for word in words
    for form in (word, word.capitalize(), word.upper())
}


def plain_scalar(text: str, span: Span, report: Report) -> Value:
    """Returns the Python value of an unquoted YAML scalar.

    If the YAML scalar has an error, adds a diagnostic to ``report`` and returns the most likely
    value.
    """
    if text in _WORDS:
        return _WORDS[text]
    if text[0] in "-+.0123456789":
        return _number(text, span, report)
    if text in _AMBIGUOUS:
        truth = _AMBIGUOUS[text]
        report.add(
            "yaml-ambiguous-word",
            f"`{text}` is a truth value for some YAML readers and text for others",
            span,
            hint=_alternatives(
                "write `{}`, or `{}` for text", "true" if truth else "false", f'"{text}"'
            ),
        )
        return truth if len(text) > 1 else text
    return text


def _number(text: str, span: Span, report: Report) -> Value:
    if _INTEGER.fullmatch(text):
        digits = text.lstrip("+-")
        if digits[0] == "0" and len(digits) > 1:
            decimal = digits.lstrip("0") or "0"
            report.add(
                "yaml-leading-zero",
                f"`{text}` starts with 0: octal for some YAML readers, decimal for others",
                span,
                hint=_leading_zero_hint(text, decimal),
            )
            if len(decimal) > 20:
                return 0
            return int(decimal)
        if len(digits) > 20 or not -(2**63) <= int(text) < 2**64:
            return _too_large(text, span, report)
        return int(text)
    if _FLOAT.fullmatch(text):
        value = float(text)
        return value if math.isfinite(value) else _too_large(text, span, report)
    if _HEX_OR_OCTAL.fullmatch(text):
        return int(text, 0) if len(text) <= 18 else _too_large(text, span, report)
    if text.lstrip("+-").lower() in (".inf", ".nan"):
        report.add(
            "yaml-not-finite",
            f"`{text}` is not a finite number",
            span,
            hint="to set no limit, remove the key",
        )
        return 0.0
    return text


def _alternatives(hint: str, *replacements: str) -> Proposal:
    return Proposal(hint.format(*replacements), *replacements)


def _leading_zero_hint(text: str, decimal: str) -> Proposal:
    sign = "-" if text[0] == "-" else ""
    if "8" in decimal or "9" in decimal or sign:
        return _alternatives("write `{}`, or `{}` for text", sign + decimal, f'"{text}"')
    return _alternatives(
        "write `{}`, `{}` for octal, or `{}` for text", decimal, f"0o{decimal}", f'"{text}"'
    )


def _too_large(text: str, span: Span, report: Report) -> Value:
    shown = text if len(text) <= 40 else text[:37] + "..."
    report.add(
        "yaml-number-range",
        f"the number `{shown}` is too large",
        span,
        hint="integers have 64 bits; other numbers are at most 1.8e308",
    )
    return 0


def is_plain_text(text: str) -> bool:
    """Returns whether every YAML reader reads an unquoted scalar as text."""
    if text in _WORDS or text in _AMBIGUOUS:
        return False
    return not (_INTEGER.fullmatch(text) or _FLOAT.fullmatch(text) or text.startswith("0"))


def key_kind(text: str) -> str | None:
    """Returns the kind of an unquoted YAML mapping key, or ``None`` if the key is a text.

    The YAML mapping keys ``on`` and ``y`` are texts, because YAML 1.2 reads them as texts.
    """
    if text in _WORDS:
        return "null" if _WORDS[text] is None else "a truth value"
    if text[0] in "-+.0123456789" and (
        _INTEGER.fullmatch(text) or _FLOAT.fullmatch(text) or _HEX_OR_OCTAL.fullmatch(text)
    ):
        return "a number"
    return None
