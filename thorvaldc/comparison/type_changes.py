"""Changes in the documents of the module types that two robots use."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from thorvaldc.comparison.leaf_differences import leaf_differences
from thorvaldc.comparison.module_outline import Outline
from thorvaldc.comparison.robot_difference import ValueChange
from thorvaldc.compiler.source.node import Node

# Texts for readers, without an effect on the robot.
_TEXTS = ("description", "source")


def type_changes(before: Outline, after: Outline) -> Iterator[ValueChange]:
    """Yields the changes in the documents of module types with the same name."""
    old, new = _documents(before), _documents(after)
    for name, document in old.items():
        if name not in new or new[name] is document:
            continue  # One file was read for both robots.
        for leaf in leaf_differences(_plain(document), _plain(new[name])):
            if leaf.path[-1] not in _TEXTS:
                yield ValueChange("module types", (name,), leaf.text_path, leaf.before, leaf.after)


def _documents(outline: Outline) -> dict[str, Node]:
    return {
        module.type: module.document for module in outline.values() if module.document is not None
    }


def _plain(node: Node) -> Any:
    """Returns a document with lists as mappings of their indices, so that items are compared."""
    if isinstance(node.value, dict):
        return {key: _plain(item) for key, item in node.value.items()}
    if isinstance(node.value, tuple) and any(isinstance(i.value, dict) for i in node.value):
        return {str(index): _plain(item) for index, item in enumerate(node.value)}
    return node.plain()
