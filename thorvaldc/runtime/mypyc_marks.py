"""The marks of classes for the compiled runtime.

Plug-ins and some modules are interpreted. mypyc refuses an interpreted subclass of a compiled class
without the mark ``@mypyc_attr(allow_interpreted_subclasses=True)``, and a second base class without
the mark ``@trait``. The package mypy_extensions defines them for type checkers and for mypyc; when
the program runs they have no effect, so the runtime does not require this package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mypy_extensions import mypyc_attr as mypyc_attr
    from mypy_extensions import trait as trait
else:

    def mypyc_attr(**_):
        return lambda cls: cls

    def trait(cls):
        return cls
