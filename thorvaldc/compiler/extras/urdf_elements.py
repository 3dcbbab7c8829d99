"""Reads the attributes of URDF elements.

The table ``ELEMENTS`` lists all supported elements and attributes of URDF.  Other URDF elements and
attributes are ignored, and the user gets a warning.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.diagnostics import Label, Report, did_you_mean

EXTENSIONS = ("gazebo", "transmission", "ros2_control", "sensor")
"""Child elements of <robot> that the compiler copies to the URDF output without reading them."""

_Range = tuple[Callable[[float], bool], str]
_LENGTH: _Range = (lambda value: value > 0.0, "must be greater than 0 m")
_NOT_NEGATIVE: _Range = (lambda value: value >= 0.0, "must not be negative")
_NOT_ZERO: _Range = (lambda value: value != 0.0, "must not be 0")
_FRACTION: _Range = (lambda value: 0.0 <= value <= 1.0, "must be between 0 and 1")


@dataclass(frozen=True, slots=True)
class _Numbers:
    """A numeric attribute of a URDF element, in SI units.

    - ``count``: required number of numbers in the attribute.
    - ``default``: text that the reader uses if the attribute is missing.  A numeric URDF attribute
      without a default is required.
    - ``range``: allowed range of each number.
    - ``range_code``: name of the diagnostic for a number outside the range.
    """

    count: int = 1
    default: str | None = None
    range: _Range | None = None
    range_code: str = "extra-number"


@dataclass(frozen=True, slots=True)
class _Content:
    """The child elements and attributes that a URDF element can have.

    - ``children``: names of the supported child elements.
    - ``text``: names of the attributes that contain text.
    - ``numbers``: attributes that contain numbers, by name.
    - ``ignored``: names of the child elements of URDF that the model cannot represent.
    """

    children: tuple[str, ...] = ()
    text: tuple[str, ...] = ()
    numbers: dict[str, _Numbers] = field(default_factory=dict)
    ignored: tuple[str, ...] = ()


_REQUIRED, _ZERO = _Numbers(), _Numbers(default="0")
_SIZE = _Numbers(range=_LENGTH)
_LIMIT = _Numbers(range=_NOT_NEGATIVE, range_code="extra-joint-limits")
_LOSS = _Numbers(default="0", range=_NOT_NEGATIVE)

ELEMENTS: dict[str, _Content] = {
    "robot": _Content(("link", "joint", "material", *EXTENSIONS)),
    "link": _Content(("inertial", "visual", "collision"), ("name", "type")),
    "inertial": _Content(("origin", "mass", "inertia")),
    "visual": _Content(("origin", "geometry", "material"), ("name",)),
    "collision": _Content(("origin", "geometry"), ("name",), ignored=("contact_coefficients",)),
    "origin": _Content(numbers={"xyz": _Numbers(3, "0 0 0"), "rpy": _Numbers(3, "0 0 0")}),
    "mass": _Content(numbers={"value": _REQUIRED}),
    "inertia": _Content(
        numbers={
            **dict.fromkeys(("ixx", "iyy", "izz"), _REQUIRED),
            **dict.fromkeys(("ixy", "ixz", "iyz"), _ZERO),
        }
    ),
    "geometry": _Content(("box", "cylinder", "sphere", "mesh")),
    "box": _Content(numbers={"size": _Numbers(3, range=_LENGTH)}),
    "cylinder": _Content(numbers={"radius": _SIZE, "length": _SIZE}),
    "sphere": _Content(numbers={"radius": _SIZE}),
    "mesh": _Content(text=("filename",), numbers={"scale": _Numbers(3, "1 1 1", _NOT_ZERO)}),
    "material": _Content(("color",), ("name",), ignored=("texture",)),
    "color": _Content(numbers={"rgba": _Numbers(4, range=_FRACTION)}),
    "joint": _Content(
        ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
        ("name", "type"),
        ignored=("safety_controller", "calibration"),
    ),
    "parent": _Content(text=("link",)),
    "child": _Content(text=("link",)),
    "axis": _Content(numbers={"xyz": _Numbers(3, "1 0 0")}),
    "limit": _Content(
        numbers={"lower": _ZERO, "upper": _ZERO, "effort": _LIMIT, "velocity": _LIMIT}
    ),
    "dynamics": _Content(numbers={"damping": _LOSS, "friction": _LOSS}),
    "mimic": _Content(
        text=("joint",), numbers={"multiplier": _Numbers(default="1"), "offset": _ZERO}
    ),
}


def call_labels(element: Element) -> tuple[Label, ...]:
    """Returns labels that show the xacro macro calls that created a URDF element.

    The label of the innermost xacro macro call comes first.
    """
    return tuple(Label(span, "in the macro called here") for span in element.calls[:4])


class ElementReader:
    """Reads the attributes of URDF elements.

    - ``report``: report that receives the errors.
    - ``macros``: names of the xacro macros in the file, for hints about elements without prefix.

    If a URDF attribute has an error, a method adds a diagnostic and returns ``None``.
    """

    def __init__(self, report: Report, macros: Collection[str]) -> None:
        self.report = report
        self.macros = macros

    def add(self, code: str, message: str, element: Element, hint: str | None = None) -> None:
        self.report.add(code, message, element.span, hint=hint, labels=call_labels(element))

    def report_unknown(self, element: Element, parent: str) -> None:
        tag = element.tag
        if tag in ("include", "macro", "property", "if", "unless", "arg"):
            hint: str | None = f"elements of xacro have a prefix: <xacro:{tag} ...>"
        elif tag in self.macros:
            hint = f"call a macro with the prefix: <xacro:{tag} ...>"
        else:
            hint = did_you_mean(tag, ELEMENTS[parent].children, fixable=False)
        self.add(
            "extra-left-out", f"unknown element <{tag}> in <{parent}> is ignored", element, hint
        )

    def check_content(self, element: Element) -> None:
        """Reports a warning for each URDF element or attribute that is not in ``ELEMENTS``."""
        content = ELEMENTS[element.tag]
        for child in element.children:
            if child.tag in content.ignored:
                message = (
                    f"<{child.tag}> in <{element.tag}> has no counterpart in the model: ignored"
                )
                self.add("extra-left-out", message, child)
            elif child.tag not in content.children:
                self.report_unknown(child, element.tag)
        attributes = (*content.text, *content.numbers)
        for name in element.attributes:
            if name not in attributes and not name.startswith("xmlns"):
                message = f"unknown attribute `{name}` of <{element.tag}> is ignored"
                hint = did_you_mean(name, attributes, fixable=False)
                self.add("extra-left-out", message, element, hint)

    def text(self, element: Element, name: str) -> str | None:
        """Returns the value of a required text attribute of a URDF element."""
        value = element.attributes.get(name, "").strip()
        if not value:
            self.add("extra-element", f"<{element.tag}> has no attribute `{name}`", element)
        return value or None

    def numbers(self, element: Element, names: Sequence[str] | None = None) -> Any:
        """Returns the values of the numeric attributes of a URDF element, by name.

        - ``names``: names of the attributes to read.  The value ``None`` selects all numeric
          attributes of the URDF element.

        The value of a URDF attribute is a float, or a tuple of floats for several numbers.
        """
        values = self.valid_numbers(element, names)
        attributes = ELEMENTS[element.tag].numbers if names is None else names
        return values if len(values) == len(attributes) else None

    def valid_numbers(self, element: Element, names: Sequence[str] | None = None) -> dict[str, Any]:
        """Returns the values of ``numbers`` that have no error."""
        self.check_content(element)
        attributes = ELEMENTS[element.tag].numbers
        values: dict[str, Any] = {}
        for name in attributes if names is None else names:
            numbers = self.attribute_numbers(element, name, attributes[name])
            if numbers is not None:
                values[name] = numbers if len(numbers) > 1 else numbers[0]
        return values

    def attribute_numbers(
        self, element: Element, name: str, attribute: _Numbers
    ) -> tuple[float, ...] | None:
        text = element.attributes.get(name, attribute.default)
        if text is None:
            self.text(element, name)
            return None
        shown = f'<{element.tag} {name}="{text}">'
        numbers: list[float] = []
        for word in text.split():
            try:
                number = math.nan if "_" in word else float(word)
            except ValueError:
                number = math.nan
            if not math.isfinite(number):
                self.add(
                    "extra-number",
                    f"{shown}: `{word}` is not a finite number",
                    element,
                    "separate numbers by spaces, in m, rad and kg, without a unit",
                )
                return None
            numbers.append(number)
        if len(numbers) != attribute.count:
            message = f"{shown} has {len(numbers)} numbers, not {attribute.count}"
            self.add("extra-number", message, element)
            return None
        if attribute.range is not None and not all(map(attribute.range[0], numbers)):
            hint = "divide bytes by 255" if element.tag == "color" else None
            message = f"{shown}: {name} {attribute.range[1]}"
            self.add(attribute.range_code, message, element, hint)
            return None
        return tuple(numbers)
