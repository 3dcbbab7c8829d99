"""The quantities of the fields of model, facts and metrics: each field states its own in its type.

``mass: si.Kilograms`` is a field of the type ``float`` for Python and for a type checker.  The
quantity stays in the type hint, where ``quantity_at`` finds it for the programs that show, compare
or convert a value.  Type hints are texts until such a program asks, so that loading a model on a
robot takes no time for them.
"""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, NamedTuple

SI_UNITS = {
    "length": "m",
    "area": "m^2",
    "volume": "m^3",
    "mass": "kg",
    "time": "s",
    "angle": "rad",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "angular_velocity": "rad/s",
    "angular_acceleration": "rad/s^2",
    "force": "N",
    "torque": "N m",
    "inertia": "kg m^2",
    "stiffness": "N/m",
    "damping": "N s/m",
    "rotational_stiffness": "N m/rad",
    "rotational_damping": "N m s/rad",
    "ratio": "1",
    "number": "1",
    "frequency": "Hz",
    "voltage": "V",
    "current": "A",
    "resistance": "ohm",
    "charge": "A s",
    "energy": "J",
    "power": "W",
    "density": "kg/m^3",
    "pressure": "Pa",
    "bitrate": "bit/s",
    "data": "bit",
    "temperature": "K",
}
"""Kinds of quantities and their SI units."""


class Quantity(NamedTuple):
    """The quantity of a field.

    - ``kind``: key of ``SI_UNITS``, ``money``, or several kinds with `or` between them.
    - ``unit``: unit as text, empty for a number without a unit.
    """

    kind: str
    unit: str


def unit_of(kind: str) -> str:
    """Return the SI unit of a kind of quantity for people: empty for a number."""
    return SI_UNITS[kind].removeprefix("1")


def _quantity(*kinds: str) -> Quantity:
    return Quantity(" or ".join(kinds), " or ".join(map(unit_of, kinds)))


NUMBER = _quantity("number")
MONEY = Quantity("money", "")
"""An amount of money.  Another field of the same object states the currency."""
_LENGTH, _INERTIA = _quantity("length"), _quantity("inertia")

Number = Annotated[float, NUMBER]
Share = Annotated[float, Quantity("number", "share")]
"""A number from 0 to 1 that people read in percent."""
Money = Annotated[float, MONEY]
Metres = Annotated[float, _LENGTH]
Kilograms = Annotated[float, _quantity("mass")]
Seconds = Annotated[float, _quantity("time")]
Hertz = Annotated[float, _quantity("frequency")]
Radians = Annotated[float, _quantity("angle")]
MetresPerSecond = Annotated[float, _quantity("velocity")]
MetresPerSecond2 = Annotated[float, _quantity("acceleration")]
RadiansPerSecond = Annotated[float, _quantity("angular_velocity")]
RadiansPerSecond2 = Annotated[float, _quantity("angular_acceleration")]
Newtons = Annotated[float, _quantity("force")]
NewtonMetres = Annotated[float, _quantity("torque")]
KilogramSquareMetres = Annotated[float, _INERTIA]
Joules = Annotated[float, _quantity("energy")]
Watts = Annotated[float, _quantity("power")]
Volts = Annotated[float, _quantity("voltage")]
Amperes = Annotated[float, _quantity("current")]
AmpereSeconds = Annotated[float, _quantity("charge")]
Pascals = Annotated[float, _quantity("pressure")]
BitsPerSecond = Annotated[int, _quantity("bitrate")]
Position = Annotated[tuple[float, float, float], _LENGTH]
MomentsOfInertia = Annotated[tuple[float, float, float, float, float, float], _INERTIA]

# Of joints that turn or slide.
JointPosition = Annotated[float, _quantity("angle", "length")]
JointVelocity = Annotated[float, _quantity("angular_velocity", "velocity")]
JointEffort = Annotated[float, _quantity("torque", "force")]
JointDamping = Annotated[float, _quantity("rotational_damping", "damping")]
JointStiffness = Annotated[float, _quantity("rotational_stiffness", "stiffness")]


@functools.cache
def field_types(cls: type) -> dict[str, Any]:
    """Return the type of each field of a dataclass, with the quantities."""
    return typing.get_type_hints(cls, include_extras=True)


def quantity_at(cls: type, path: Sequence[str]) -> Quantity | None:
    """Return the quantity of a value in the JSON form of a dataclass, or ``None`` if it has none.

    - ``path``: names of the fields on the way to the value, with the names or numbers of the
      elements of lists, such as ``("wheels", "fl_wheel", "radius")``.

    The quantity of a list or of an object is that of all its values, if they have the same.
    """
    hint: Any = cls
    for key in path:
        if typing.get_origin(hint) is Annotated:
            break  # all values of the list have the quantity
        hint = _member(hint, key)
    quantities = set(_quantities(hint))
    return quantities.pop() if len(quantities) == 1 else None


def _member(hint: Any, key: str) -> Any:
    """Return the type of a field of an object, or of an element of a list."""
    for part in _alternatives(hint):
        if dataclasses.is_dataclass(part) and key in field_types(typing.cast(type, part)):
            return field_types(typing.cast(type, part))[key]
        if typing.get_origin(part) is tuple:
            element, *others = typing.get_args(part)
            if others == [Ellipsis]:
                return _value_of_pair(element)
            return part.__args__[int(key)] if key.isdecimal() else element
    return None


def _value_of_pair(element: Any) -> Any:
    """Return the type of the value, for a pair of a name and a value."""
    arguments = typing.get_args(element)
    is_pair = typing.get_origin(element) is tuple and len(arguments) == 2 and arguments[0] is str
    return arguments[1] if is_pair else element


def _alternatives(hint: Any) -> tuple[Any, ...]:
    is_union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return typing.get_args(hint) if is_union else (hint,)


def _quantities(hint: Any) -> Iterator[Quantity | None]:
    for part in _alternatives(hint):
        if typing.get_origin(part) is Annotated:
            yield from (data for data in part.__metadata__ if isinstance(data, Quantity))
        elif typing.get_origin(part) is tuple:
            for element in typing.get_args(part):
                if element is not Ellipsis:
                    yield from _quantities(_value_of_pair(element))
        elif dataclasses.is_dataclass(part):
            for element in field_types(typing.cast(type, part)).values():
                yield from _quantities(element)
        elif part is not type(None):
            yield None
