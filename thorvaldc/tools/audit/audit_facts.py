"""What the readers of the audit learn about a robot, beside the facts of single files."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from thorvaldc.compiler.descriptions.facts import Fact, FileDescription, ParameterSection
from thorvaldc.compiler.extras.xacro_rules import find_in_sources
from thorvaldc.diagnostics import Span


@dataclass(frozen=True, slots=True)
class LaunchedNode:
    """A node that a launch file starts.

    - ``name``: name of the node, or empty text if the launch file does not state a plain text.
    - ``parameters``: parameters in the launch file itself, by name; an unknown value is ``None``.
    - ``parameter_files``: plain names of parameter files, such as ``config/nav2.yaml``.
    - ``remappings``: the new names.
    """

    package: str
    executable: str
    name: str
    span: Span
    parameters: Mapping[str, Fact]
    parameter_files: tuple[Fact, ...] = ()
    remappings: tuple[str, ...] = ()
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
        candidates = self.descriptions
        if names:
            counts = [
                sum(1 for n in names if n in d.joints or n in d.links) for d in self.descriptions
            ]
            most = max(counts, default=0)
            if most == 0:
                return []
            candidates = [
                d for d, count in zip(self.descriptions, counts, strict=True) if count == most
            ]
        words = path_words(file)
        affinities = [len(words & path_words(d.file)) for d in candidates]
        best = max(affinities, default=0)
        if any(len(words & path_words(unread)) > best for unread in self.incomplete):
            return []  # it probably belongs to a description that cannot be read
        return [d for d, value in zip(candidates, affinities, strict=True) if value == best]


def is_nearer(file: str, unread: str, other: str) -> bool:
    """Whether a file belongs to ``unread`` at least as probably as to ``other``, by its path."""
    words = path_words(file)
    return len(words & path_words(unread)) >= len(words & path_words(other))


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
    words = path_words(file)
    distributions = words & _DISTRIBUTIONS
    candidates = [
        (len(words & path_words(fact.span.file)), fact)
        for fact in facts
        if path_words(fact.span.file) & _DISTRIBUTIONS == distributions
    ]
    best = max((affinity for affinity, _ in candidates), default=0)
    return [fact for affinity, fact in candidates if affinity == best]
