"""The folders with data beside the code: module library and templates."""

from __future__ import annotations

from functools import cache
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent


@cache
def data_folder(name: str) -> Path:
    """Return the path of the data folder ``modules`` or ``templates``.

    The folder of a source checkout is preferred to the copy in an installed package, because an
    editable installation may contain an outdated copy.
    """
    checkout = _PACKAGE.parent / name
    if (_PACKAGE.parent / "pyproject.toml").is_file() and checkout.is_dir():
        return checkout
    return _PACKAGE / "_data" / name
