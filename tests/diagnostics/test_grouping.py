"""Tests of the groups of similar warnings and notes, by means of extras."""

from __future__ import annotations

from pathlib import Path

from tests.compiler.extras.xacro_files import load_one
from thorvaldc.diagnostics import Report, Span
from thorvaldc.diagnostics.report import grouped

ARM = """
<xacro:macro name="part" params="n">
  <link name="link_${n}" colour="red" size="2"/>
</xacro:macro>
"""


def test_a_macro_that_is_called_often_gives_one_warning(tmp_path: Path) -> None:
    calls = "\n".join(f'<xacro:part n="{n}"/>' for n in range(7))
    loaded = load_one(tmp_path, ARM + calls)
    assert loaded.codes == ["extra-left-out"]
    assert "(14 places; also `size`)" in loaded.only.message
    assert str(loaded.only.span).startswith("a.xacro:5:")
    lines = [(label.span.line, label.text) for label in loaded.only.labels]
    assert lines == [(7, "in the macro called here"), (8, "and here"), (9, "and here")]


def test_errors_are_not_grouped(tmp_path: Path) -> None:
    loaded = load_one(tmp_path, "\n".join('<link name="a"><visual/></link>' for _ in range(3)))
    assert loaded.codes.count("extra-element") == 3


def test_other_advice_is_another_group() -> None:
    report = Report()
    for line, (name, hint) in enumerate((("a", "x"), ("b", "x"), ("c", "y"), ("c", "y")), start=1):
        report.add("extra-left-out", f"`{name}` of 3 is ignored", Span("f", line), hint=hint)
    messages = [d.message for d in grouped(report)]
    assert messages == [
        "`a` of 3 is ignored (2 places; also `b`)",
        "`c` of 3 is ignored (2 places)",
    ]
