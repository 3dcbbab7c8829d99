"""The names of the numbers that ``thorvaldc why`` explains, for completion in a shell."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from thorvaldc.compiler.modules.module_tree import Instance
from thorvaldc.model.facts.facts_document import facts_document
from thorvaldc.tools.provenance.explanation import FACTS, Explainer
from thorvaldc.tools.provenance.model_paths import all_paths, changed_value, value_at

_HIDDEN = ("meshes", "modules", "inertial")
"""Parts of the model whose numbers have other names, or none that a person would type."""


def known_paths(explainer: Explainer) -> Iterator[str]:
    """Yields the names of all numbers of a robot: of the model, of the facts and of the modules."""
    model = {key: part for key, part in explainer.document.items() if key not in _HIDDEN}
    facts = {name: compute(explainer.robot) for name, compute in FACTS.items()}
    documents = {name: facts_document(part) for name, part in facts.items() if part is not None}
    yield "mass"
    yield from (f"com.{axis}" for axis in "xyz")
    for document in (model, documents):
        for path in all_paths(document):
            if changed_value(value_at(document, path), 1e-3) is not None:
                yield ".".join(path)
    yield from _parameters(explainer.probe.instances)


def _parameters(instance: Instance) -> Iterator[str]:
    if instance.type is not None:
        for name in instance.type.section("params"):
            yield f"modules.{instance.path}.params.{name}"
    for child in instance.children.values():
        yield from _parameters(child)


def next_names(paths: Iterable[str], start: str) -> list[str]:
    """Returns what can follow ``start`` in the paths, up to the next point that is a choice."""
    fitting = [path for path in paths if path.startswith(start)]
    names: list[str] = []
    while not names or (len(names) == 1 and names[0].endswith(".")):
        ends = [path.find(".", len(start)) + 1 or len(path) for path in fitting]
        names = sorted({path[:end] for path, end in zip(fitting, ends, strict=True)})
        if not names:
            return []
        start = names[0]
    return names
