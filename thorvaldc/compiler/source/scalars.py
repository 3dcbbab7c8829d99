"""What a plain scalar means: YAML 1.2's core schema, with an error where readers differ."""

from __future__ import annotations

import math
import re

from thorvaldc.compiler.source.node import Value
from thorvaldc.diagnostics import Report, Span

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
    """What an unquoted scalar means.

    A fault goes to ``report``; then what was probably meant comes back.
    """
    if text in _WORDS:
        return _WORDS[text]
    if text[0] in "-+.0123456789":
        return _number(text, span, report)
    if text in _AMBIGUOUS:
        truth = _AMBIGUOUS[text]
        report.add(
            "yaml-ambiguous-word",
            f"`{text}` is a truth value to some YAML readers and text to others",
            span,
            hint=f'write `{"true" if truth else "false"}`, or `"{text}"` for text',
        )
        return truth if len(text) > 1 else text
    return text


def _number(text: str, span: Span, report: Report) -> Value:
    if _INTEGER.fullmatch(text):
        digits = text.lstrip("+-")
        if digits[0] == "0" and len(digits) > 1:
            plain = digits.lstrip("0") or "0"
            report.add(
                "yaml-leading-zero",
                f"`{text}` begins with 0: octal to some YAML readers, decimal to others",
                span,
                hint=f'write `{plain}`, `0o{plain}` for octal, or `"{text}"` for text',
            )
            if len(plain) > 20:
                return 0
            return int(plain)
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
            hint="leave the key out where there is no limit",
        )
        return 0.0
    return text


def _too_large(text: str, span: Span, report: Report) -> Value:
    shown = text if len(text) <= 40 else text[:37] + "..."
    report.add(
        "yaml-number-range",
        f"the number `{shown}` is too large",
        span,
        hint="integers have 64 bits, other numbers end at 1.8e308",
    )
    return 0


def key_kind(text: str) -> str | None:
    """What a plain key is, if not text.  ``on`` and ``y`` are: no reader of 1.2 differs."""
    if text in _WORDS:
        return "null" if _WORDS[text] is None else "a truth value"
    if text[0] in "-+.0123456789" and (
        _INTEGER.fullmatch(text) or _FLOAT.fullmatch(text) or _HEX_OR_OCTAL.fullmatch(text)
    ):
        return "a number"
    return None
