"""The files of a folder of ``templates/``, filled in with jinja2.

In a Python or YAML file, ``# % if x`` stands for the line ``{% if x %}`` of jinja2, and ``# # x``
for its comment ``{# x #}``: linters and editors read such a template as the file that it becomes.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

from thorvaldc.model.plugins import data_folder

if TYPE_CHECKING:
    from pathlib import Path

    from jinja2 import Environment, FileSystemBytecodeCache
    from jinja2.bccache import Bucket


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
        self._folder = root = data_folder("templates") / folder
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
            bytecode_cache=_bytecode_cache(self._folder),
        )
        environment.filters.update(self.filters)
        return environment

    def render(self, name: str, **values: Any) -> str:
        """Return the text of a template with its values.

        Raises ``jinja2.UndefinedError`` for a name without a value.
        """
        return self.environment.get_template(name).render(values)


def _bytecode_cache(folder: Path) -> FileSystemBytecodeCache | None:
    """Return the place of the compiled templates of a folder, beside them as that of a module.

    The compilation takes a tenth of the time of a build.  A text that has changed is compiled
    again.  ``None`` where modules are no files, as in a zip file.
    """
    from jinja2 import FileSystemBytecodeCache, compiler

    class BytecodeCache(FileSystemBytecodeCache):
        """Does without the files that cannot be read or written, as in a folder of another user."""

        def load_bytecode(self, bucket: Bucket) -> None:
            with contextlib.suppress(OSError):
                super().load_bytecode(bucket)

        def dump_bytecode(self, bucket: Bucket) -> None:
            if not sys.dont_write_bytecode:
                with contextlib.suppress(OSError):
                    os.makedirs(self.directory, exist_ok=True)
                    super().dump_bytecode(bucket)

    # What jinja2 does not compare: its own version, and the options in this file.
    try:
        times = [f"{os.stat(file).st_mtime_ns:x}" for file in (compiler.__file__, __file__)]
    except OSError:
        return None
    version = "-".join([sys.implementation.cache_tag or "", *times])
    return BytecodeCache(str(folder / "__pycache__"), f"{version}-%s.cache")
