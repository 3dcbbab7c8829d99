"""The files of a folder of ``templates/``, filled in with jinja2.

In a Python or YAML file, ``# % if x`` stands for the line ``{% if x %}`` of jinja2, and ``# # x``
for its comment ``{# x #}``: linters and editors read such a template as the file that it becomes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

from thorvaldc.model.plugins import data_folder

if TYPE_CHECKING:
    from jinja2 import Environment


# jinja2's own ``line_statement_prefix`` also removes the empty lines after a statement.
_LINE = re.compile(r"^ *# ([%#]) (.*)$", re.MULTILINE)


class Templates:
    """The templates of a folder.

    A backend must not read files, so the templates are read at once, when the target is loaded.
    jinja2 is imported for the first text.
    """

    def __init__(
        self,
        folder: str,
        filters: Mapping[str, Callable[[str], str]] | None = None,
        *,
        escapes_html: bool = False,
    ) -> None:
        """Read the templates. ``filters`` are functions that templates use by these names. With
        ``escapes_html``, values are text in HTML."""
        root = data_folder("templates") / folder
        self.texts = {
            path.name: _LINE.sub(r"{\1 \2 \1}", path.read_text(encoding="utf-8"))
            for path in root.iterdir()
            if path.is_file()
        }
        self.filters = dict(filters or {})
        self.escapes_html = escapes_html

    @cached_property
    def environment(self) -> Environment:
        from jinja2 import DictLoader, Environment, StrictUndefined

        environment = Environment(
            loader=DictLoader(self.texts),
            autoescape=self.escapes_html,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
            keep_trailing_newline=True,
        )
        environment.filters.update(self.filters)
        return environment

    def render(self, name: str, **values: Any) -> str:
        """Return the text of a template with its values.

        Raises ``jinja2.UndefinedError`` for a name without a value.
        """
        return self.environment.get_template(name).render(values)
