"""Objects that a notebook shows as HTML."""

from __future__ import annotations

from importlib import import_module


class HtmlView:
    """A class whose objects a notebook shows by a function of another module.

    ``html_view``: ``module:function``.  The module imports that of the class, so that it cannot be
    imported before.
    """

    __slots__ = ()
    html_view = ""

    def _repr_html_(self) -> str:
        module, function = self.html_view.split(":")
        return str(getattr(import_module(module), function)(self))
