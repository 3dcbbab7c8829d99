"""Classes of the differences between two robots or two fleets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from thorvaldc.comparison.leaf_differences import ABSENT, LeafDifference

ADDED, REMOVED, CHANGED = "added", "removed", "changed"


@dataclass(frozen=True)
class ValueChange:
    """A property of the robot that differs.

    Attributes
    ----------
    section : part of the robot: ``robot``, ``wheels``, ``drives``, ``buses`` ...
    subjects : names of the elements with this change.  Empty for the robot itself.
    label : name of the property, such as ``radius``.  Empty if whole elements were added or
        removed.
    before, after : values in SI units or texts.  ``ABSENT`` for an element that one robot lacks.
    unit : SI unit of the values, or an empty text.
    """

    section: str
    subjects: tuple[str, ...]
    label: str
    before: Any
    after: Any
    unit: str = ""

    @property
    def kind(self) -> str:
        """``added``, ``removed`` or ``changed``."""
        if self.before is ABSENT:
            return ADDED
        return REMOVED if self.after is ABSENT else CHANGED


@dataclass(frozen=True)
class ModuleChange:
    """A module that was added, removed, renamed, moved, exchanged or given other parameters.

    Attributes
    ----------
    kinds : ``added``, ``removed``, or some of ``renamed``, ``exchanged``, ``moved``, ``changed``.
    name : path of the module, such as ``fl`` or ``fl.drive``; of the robot after the change,
        except for a removed module.
    old_name : path of the module before the change.
    old_type, type : module types, empty if they are unknown.
    old_place, place : where the module is mounted, such as ``frame.front_left``.
    parameters : parameters with other values.
    """

    kinds: tuple[str, ...]
    name: str
    old_name: str
    old_type: str
    type: str
    old_place: str
    place: str
    parameters: tuple[ValueChange, ...] = ()


@dataclass(frozen=True)
class RobotDifference:
    """The differences of two robots, in robot terms and as values of the model.

    Attributes
    ----------
    before, after : names of the robots.
    modules : changes of modules, in the order of the robot file.
    values : changes of properties of the robot and its elements.
    derived : values of the model that follow from the changes above, or that are of little
        interest: shapes, poses, frame identifiers, rounding.
    types : changes in the documents of module types that both robots use.  They are causes of other
        changes; a change without an effect, such as that of a description, is no difference.
    leaves : every value of the model that differs.  Each of them is in ``values``, in ``derived``,
        or belongs to an element of a module in ``modules``.
    """

    before: str
    after: str
    modules: tuple[ModuleChange, ...]
    values: tuple[ValueChange, ...]
    derived: tuple[LeafDifference, ...]
    types: tuple[ValueChange, ...]
    leaves: tuple[LeafDifference, ...]

    @property
    def is_equal(self) -> bool:
        return not (self.leaves or self.modules)


@dataclass(frozen=True)
class FleetDifference:
    """The differences of two fleets.

    Attributes
    ----------
    values : robots added, removed and placed elsewhere, and changes of the world.
    robots : differences of the robots with the same name in both fleets.
    leaves : every value of the fleet, without its robots, that differs.
    """

    before: str
    after: str
    values: tuple[ValueChange, ...]
    robots: tuple[tuple[str, RobotDifference], ...]
    leaves: tuple[LeafDifference, ...]

    @property
    def is_equal(self) -> bool:
        return not self.leaves and all(difference.is_equal for _, difference in self.robots)


Difference = RobotDifference | FleetDifference
