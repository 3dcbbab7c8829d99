"""docs/api.md has the docstrings of the present code."""

from __future__ import annotations

import inspect
import re

import thorvaldc
from thorvaldc import model
from workshop import api_page


def test_the_page_is_fresh() -> None:
    assert api_page.PAGE.read_text(encoding="utf-8") == api_page.page(), (
        "docs/api.md differs from the docstrings; write it again: python workshop/api_page.py"
    )


def test_the_page_has_every_public_name() -> None:
    headings = re.findall(r"^### (\w+)$", api_page.page(), re.M)
    assert len(headings) == len(set(headings))
    classes = {name for name in model.__all__ if isinstance(getattr(model, name), type)}
    assert set(headings) == (set(thorvaldc.__all__) - {"__version__"}) | classes


def test_every_field_is_described() -> None:
    """In the table, or in the sentences of the docstring."""
    for name in [*thorvaldc.__all__, *model.__all__]:
        value = getattr(thorvaldc, name, None) or getattr(model, name)
        if isinstance(value, type):
            for field, _ in api_page.fields_of(value):
                described = re.search(rf"\b{field}\b", inspect.getdoc(value) or "")
                assert described or field in ("name", "span"), f"{name}.{field}"
