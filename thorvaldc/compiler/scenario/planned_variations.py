"""Plans the variations of a scenario file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from thorvaldc.compiler.scenario.variations import Variations, read_variations, without_variations
from thorvaldc.compiler.source.reader import read_file
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.diagnostics import Report


def plan_variations(
    path: Path | str,
    settings: Sequence[str] = (),
    draws: int | None = None,
    seed: int | None = None,
    *,
    from_document: bool = True,
    report: Report,
) -> Variations | None:
    """Returns the variations of a scenario.

    The scenario document and the argument ``settings`` define the variations.  With
    ``from_document=False`` only ``settings`` defines the variations.  Returns ``None`` if the file
    is not a scenario.  The function ``read_variations`` describes the arguments ``settings``,
    ``draws`` and ``seed``.
    """
    document_report = Report()  # compile_file reports these problems again, so they are dropped
    document = read_file(Path(path), str(path), document_report)
    if document is None:
        report.extend(document_report)
        return Variations(())
    if document.get("scenario") is None:
        return None
    check(document, "scenario", document_report)
    document = without_invalid_values(document, document_report)
    if not from_document:
        document = without_variations(document)
    return read_variations(document, settings, draws, seed, report)
