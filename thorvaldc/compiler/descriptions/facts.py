"""What files of others state about a robot: values with the place where they stand.

All values are in SI units.  The readers of URDF, SDF and MJCF return the same description.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from thorvaldc.compiler.descriptions.description import Description, Places
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import FIRST_USE, Label, Report, Span, did_you_mean
from thorvaldc.model import Joint, Link


class UnreadableFileError(Exception):
    """Raised if a file cannot be read; ``span`` is the place of the error, if it is known."""

    def __init__(self, reason: str, span: Span | None = None) -> None:
        super().__init__(reason)
        self.span = span


class Fact(NamedTuple):
    """A statement of one file about the robot.

    - ``kind``: what is stated, such as ``wheel radius``.
    - ``subject``: who states it, as in messages, such as ``controller `diff_drive```.
    - ``value``: number, text, flag or a tuple of these.
    - ``span``: place of the value.
    - ``unit``: unit of a number, such as ``m``.
    - ``names``: names of the joints or links that the statement is about.
    """

    kind: str
    subject: str
    value: Any
    span: Span
    unit: str = ""
    names: tuple[str, ...] = ()


@dataclass
class FileDescription(Description):
    """A robot in URDF, SDF or MJCF.

    The types of joints are those of URDF; joints of other types keep their own.

    - ``format``: URDF, SDF or MJCF.
    - ``file``: name of the file in messages; ``path``: its absolute path.
    - ``frames``: names of frames that are no links, such as MJCF sites.
    - ``facts``: statements of plug-ins and of ``<ros2_control>`` in the file.
    """

    format: str = ""
    name: str = ""
    file: str = ""
    path: Path = Path()
    frames: set[str] = field(default_factory=set)
    facts: list[Fact] = field(default_factory=list)

    def add_parts(
        self,
        links: Sequence[Link],
        joints: Sequence[Joint],
        places: Places,
        report: Report,
        *,
        is_guessed: bool = False,
    ) -> None:
        """Adds links and joints; reports those whose name another one has.

        - ``is_guessed``: whether arguments of macros may be guessed.  Then two calls of one macro
          can have the same names, which is not reported.
        """
        parts: list[Link | Joint] = [*links, *joints]
        for part in parts:
            known: dict[str, Any] = self.links if isinstance(part, Link) else self.joints
            first = known.setdefault(part.name, part)
            is_same_place = first.span == part.span  # as of a macro that is called twice
            if first is not part and not (is_guessed and is_same_place):
                report.add(
                    "audit-description-broken",
                    f"{type(part).__name__.lower()} `{part.name}` is defined twice; readers of"
                    f" {self.format} reject the file",
                    part.span,
                    labels=() if is_same_place else [Label(first.span, FIRST_USE)],
                )
        self.places |= places

    def check_joints(self, report: Report, others: Sequence[str] = ()) -> None:
        """Reports links of joints that do not exist.

        - ``others``: names of frames and of links elsewhere to which joints may refer.
        """
        known = [*self.links, *others]
        for joint in self.joints.values():
            for role, link in (("parent", joint.parent), ("child", joint.child)):
                if link not in known:
                    report.add(
                        "audit-description-broken",
                        f"the {role} of joint `{joint.name}` is link `{link}`, which does not"
                        " exist",
                        joint.span,
                        hint=did_you_mean(link, known, fixable=False),
                    )

    def limit(self, joint: Joint, quantity: str) -> Fact | None:
        """Returns the limit ``lower``, ``upper``, ``velocity`` or ``effort`` of a joint.

        A very large limit means that there is none.
        """
        value = getattr(joint, quantity)
        if value is None or abs(value) >= UNLIMITED:
            return None
        unit = _UNITS[quantity][joint.type == "prismatic"]
        return Fact(quantity, joint.name, value, self.place(joint, quantity).span, unit)


UNLIMITED = 1e15
# Units of each limit: of joints that turn, and of those that slide.
_UNITS = {
    "lower": ("rad", "m"),
    "upper": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "effort": ("N m", "N"),
}


@dataclass(frozen=True, slots=True)
class ParameterSection:
    """The parameters of one node in a ROS parameter file.

    - ``node``: name of the node, with its name space.
    - ``values``: YAML values by the name of the parameter, such as ``linear.x.max_velocity``.
    """

    node: str
    file: str
    path: Path
    span: Span
    values: Mapping[str, Node]

    @property
    def short_name(self) -> str:
        return self.node.rsplit("/", 1)[-1]

    def number(self, name: str) -> float | None:
        node = self.values.get(name)
        if node is None or isinstance(node.value, bool):
            return None
        return float(node.value) if isinstance(node.value, int | float) else None

    def flag(self, name: str) -> bool | None:
        node = self.values.get(name)
        return node.value if node is not None and isinstance(node.value, bool) else None

    def text(self, name: str) -> str | None:
        node = self.values.get(name)
        return node.value if node is not None and isinstance(node.value, str) else None

    def items(self, name: str) -> tuple[Node, ...]:
        """Returns the values in a list; a value that is no list is a list of one value."""
        node = self.values.get(name)
        if node is None:
            return ()
        return node.value if isinstance(node.value, tuple) else (node,)
