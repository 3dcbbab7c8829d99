"""Recognises robot descriptions in XML, such as a URDF, at the place of a YAML document."""

from __future__ import annotations

import re

from thorvaldc.diagnostics import Report, Span

_START = re.compile(rb"(?:\xef\xbb\xbf)?\s*<(?:[?!]|\w+[\s/>])")
_ROOT = re.compile(rb"<(robot|sdf|mujoco)[\s/>]")
_HEAD = 100_000  # bytes in which the root element is searched; comments can stand before it
_AUDIT = "`thorvaldc audit DIR` checks the files of any robot"
_KINDS = {b"robot": "a URDF file", b"sdf": "an SDF file", b"mujoco": "an MJCF file"}


def report_xml(data: bytes, file: str, report: Report) -> bool:
    """Reports an error and returns ``True`` if a document is XML instead of YAML.

    - ``data``: the whole document.
    - ``file``: file name in source spans.
    """
    start = _START.match(data)
    if start is None:
        return False
    root = _ROOT.search(data, 0, _HEAD)
    name = root[1] if root is not None else b""
    hint = _AUDIT
    if name == b"robot":
        hint = (
            "a robot file joins it to its modules: "
            f"`extras: [{{xacro: {file}, parent: frame}}]`; {_AUDIT}"
        )
    kind = _KINDS.get(name, "an XML file")
    report.add("other-document", f"this is {kind}; expected YAML", Span(file), hint=hint)
    return True
