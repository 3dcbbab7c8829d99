"""What the readers of the audit learn about a robot, beside the facts of single files."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from thorvaldc.compiler.descriptions.facts import Fact, FileDescription, ParameterSection
from thorvaldc.compiler.extras.xacro_rules import find_in_sources
from thorvaldc.diagnostics import Span

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class LaunchedNode:
    """A node that a launch file starts.

    - ``name``: name of the node, or empty text if the launch file does not state a plain text.
    - ``parameters``: parameters in the launch file itself, by name; an unknown value is ``None``.
    - ``parameter_files``: plain names of parameter files, such as ``config/nav2.yaml``.
    """

    package: str
    executable: str
    name: str
    span: Span
    parameters: Mapping[str, Fact]
    parameter_files: tuple[Fact, ...] = ()
    arguments: tuple[str, ...] = ()


@dataclass(slots=True)
class LaunchFile:
    """A launch file: its nodes, and the names of the launch files that it includes."""

    path: Path
    nodes: list[LaunchedNode] = field(default_factory=list)
    includes: list[Fact] = field(default_factory=list)


@dataclass(slots=True)
class Evidence:
    """All that the audit has read.

    - ``facts``: statements of the parameter files, made from ``sections``.
    - ``incomplete``, ``unread_launches``: names of the descriptions and launch files that could
      not be read.
    - ``packages``: folder of each ROS package, by its name.
    """

    descriptions: list[FileDescription] = field(default_factory=list)
    sections: list[ParameterSection] = field(default_factory=list)
    launches: list[LaunchFile] = field(default_factory=list)
    facts: list[Fact] = field(default_factory=list)
    packages: dict[str, Path] = field(default_factory=dict)
    incomplete: list[str] = field(default_factory=list)
    unread_launches: list[str] = field(default_factory=list)

    def stated(self, *kinds: str) -> list[Fact]:
        """Returns the statements of parameter files and launch files of some kinds."""
        return [fact for fact in self.facts if fact.kind in kinds]

    def described(self, *kinds: str) -> list[tuple[FileDescription, Fact]]:
        """Returns the statements in descriptions of some kinds, with their descriptions."""
        return [(d, fact) for d in self.descriptions for fact in d.facts if fact.kind in kinds]

    def file_in_package(self, name: str) -> Path | None:
        """Returns the path of ``package/path``, or ``None`` if the package is not audited."""
        package, _, rest = name.partition("/")
        folder = self.packages.get(package)
        if folder is None or not rest or "\0" in rest:
            return None
        return Path(find_in_sources(str(folder), rest) or folder / rest)

    def related(self, file: str, names: tuple[str, ...] = ()) -> list[FileDescription]:
        """Returns the descriptions to which a file belongs, most probably.

        These are the descriptions with most of the joints or links ``names``; of several, those
        whose paths have most words in common with the path of the file.  A repository can contain
        several robots: `config/burger.yaml` belongs to `urdf/burger.urdf`.
        """

        def known(description: FileDescription) -> int:
            return sum(1 for n in names if n in description.joints or n in description.links)

        candidates = _most(self.descriptions, known)
        if names and not any(map(known, candidates)):
            return []
        nearest = _most(candidates, lambda description: affinity(file, description.file))
        best = affinity(file, nearest[0].file) if nearest else 0
        if any(affinity(file, unread) > best for unread in self.incomplete):
            return []  # it probably belongs to a description that cannot be read
        return nearest


def _most(items: Sequence[T], value: Callable[[T], int]) -> list[T]:
    """Returns the items with the largest value."""
    best = max(map(value, items), default=0)
    return [item for item in items if value(item) == best]


def affinity(file: str, other: str) -> int:
    """Returns the number of words that two paths have in common and that can name a robot."""
    return len(path_words(file) & path_words(other))


_GENERAL_WORDS = frozenset(
    [
        *("config", "params", "param", "parameters", "urdf", "xacro", "yaml", "yml", "sdf", "mjcf"),
        *("description", "control", "controllers", "launch", "py", "xml", "robot", "robots"),
        *("model", "src"),
    ]
)


def path_words(file: str) -> set[str]:
    """Returns the words of a path that can name a robot."""
    return set(re.findall(r"[a-z0-9]+", file.lower())) - _GENERAL_WORDS


_DISTRIBUTIONS = frozenset(
    ["foxy", "galactic", "humble", "iron", "jazzy", "kilted", "lyrical", "rolling"]
)


def closest(facts: Sequence[Fact], file: str) -> list[Fact]:
    """Returns the statements whose files have most words in common with the path of a file.

    Files for another distribution of ROS, as in `param/humble/nav2.yaml`, are alternatives.
    """
    distributions = path_words(file) & _DISTRIBUTIONS
    candidates = [f for f in facts if path_words(f.span.file) & _DISTRIBUTIONS == distributions]
    return _most(candidates, lambda fact: affinity(file, fact.span.file))
