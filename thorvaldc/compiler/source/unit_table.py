"""Tables of the physical units and the kinds of quantities that YAML documents can use.

The conversion factor of a unit to SI is an exact fraction times a power of pi.  The radian is a
separate dimension in the tables of units, although it has no dimension in SI.  With a dimension for
the radian, the compiler can distinguish ``rad/s`` from ``Hz``.
"""

from __future__ import annotations

from typing import NamedTuple

from thorvaldc.model.quantities import SI_UNITS

Dimension = tuple[float, ...]
"""Exponents of the base units m, kg, s, A, K, rad and bit, in this order.

They are integers; only a root in an expression gives fractions.
"""

BASE_UNITS = ("m", "kg", "s", "A", "K", "rad", "bit")


class Quantity(NamedTuple):
    """A kind of physical quantity, such as a length or a torque.

    - ``name``: name of the kind of quantity in the schemas, such as ``angular_velocity``.
    - ``article``: indefinite article of the name in messages, ``a`` or ``an``.
    - ``unit``: SI unit of the quantity, such as ``rad/s``.
    - ``example``: a quantity of this kind for hints, such as ``650 mm``.
    - ``dimensions``: allowed dimensions of the unit of a quantity.
    """

    name: str
    article: str
    unit: str
    example: str
    dimensions: tuple[Dimension, ...]

    def __str__(self) -> str:
        return f"{self.article} {self.name.replace('_', ' ')}"

    def format_value(self, value: float) -> str:
        """Returns a physical value as a text with its SI unit, such as ``1.5 m/s``."""
        return f"{value:.6g}" if self.unit == "1" else f"{value:.6g} {self.unit}"


class Unit(NamedTuple):
    """A physical unit with its dimension and its conversion factor to SI.

    Conversion: SI value = number * numerator / denominator * pi**pi_power + offset / 100.  The
    field ``offset`` of a unit is in hundredths of a kelvin.  Only the unit degree Celsius has an
    offset.
    """

    dimension: Dimension
    numerator: int = 1
    denominator: int = 1
    pi_power: int = 0
    offset: int = 0


PREFIXES = {
    "T": 12,
    "G": 9,
    "M": 6,
    "k": 3,
    "h": 2,
    "d": -1,
    "c": -2,
    "m": -3,
    "u": -6,
    "µ": -6,  # micro sign
    "μ": -6,  # Greek mu
    "n": -9,
    "p": -12,
}
LONG_PREFIXES = {"milli": -3, "centi": -2, "deci": -1, "kilo": 3, "mega": 6, "micro": -6}

_LENGTH: Dimension = (1, 0, 0, 0, 0, 0, 0)
_MASS: Dimension = (0, 1, 0, 0, 0, 0, 0)
_TIME: Dimension = (0, 0, 1, 0, 0, 0, 0)
_ANGLE: Dimension = (0, 0, 0, 0, 0, 1, 0)
_SPEED: Dimension = (1, 0, -1, 0, 0, 0, 0)
_TURNING: Dimension = (0, 0, -1, 0, 0, 1, 0)
_PER_TIME: Dimension = (0, 0, -1, 0, 0, 0, 0)
_FORCE: Dimension = (1, 1, -2, 0, 0, 0, 0)
_TORQUE: Dimension = (2, 1, -2, 0, 0, 0, 0)
_POWER: Dimension = (2, 1, -3, 0, 0, 0, 0)
_PRESSURE: Dimension = (-1, 1, -2, 0, 0, 0, 0)
_CHARGE: Dimension = (0, 0, 1, 1, 0, 0, 0)
_VOLTAGE: Dimension = (2, 1, -3, -1, 0, 0, 0)
_RESISTANCE: Dimension = (2, 1, -3, -2, 0, 0, 0)
_BIT: Dimension = (0, 0, 0, 0, 0, 0, 1)
_BITRATE: Dimension = (0, 0, -1, 0, 0, 0, 1)
_KELVIN: Dimension = (0, 0, 0, 0, 1, 0, 0)
_NONE: Dimension = (0, 0, 0, 0, 0, 0, 0)
PLAIN = Unit(_NONE)


def _aliases(*rows: tuple[str, Unit]) -> dict[str, Unit]:
    return {name: unit for names, unit in rows for name in names.split()}


UNITS: dict[str, Unit] = _aliases(
    ("m meter meters metre metres", Unit(_LENGTH)),
    ('in inch inches " ″', Unit(_LENGTH, 254, 10000)),
    ("ft foot feet ' ′", Unit(_LENGTH, 3048, 10000)),
    ("g gram grams", Unit(_MASS, 1, 1000)),
    ("t tonne tonnes", Unit(_MASS, 1000)),
    ("lb lbs", Unit(_MASS, 45359237, 100000000)),
    ("s sec second seconds", Unit(_TIME)),
    ("min minute minutes", Unit(_TIME, 60)),
    ("h hr hour hours", Unit(_TIME, 3600)),
    ("d day days", Unit(_TIME, 86400)),
    ("week weeks", Unit(_TIME, 604800)),
    ("rad radian radians", Unit(_ANGLE)),
    ("deg degree degrees °", Unit(_ANGLE, 1, 180, 1)),
    ("rev turn turns", Unit(_ANGLE, 2, 1, 1)),
    ("rpm RPM", Unit(_TURNING, 1, 30, 1)),
    ("kph kmh", Unit(_SPEED, 5, 18)),
    ("mph", Unit(_SPEED, 44704, 100000)),
    ("Hz hertz", Unit(_PER_TIME)),
    ("N newton newtons", Unit(_FORCE)),
    ("lbf", Unit(_FORCE, 44482216152605, 10**13)),
    ("Nm", Unit(_TORQUE)),
    ("Ncm", Unit(_TORQUE, 1, 100)),
    ("Nmm", Unit(_TORQUE, 1, 1000)),
    ("J joule joules", Unit(_TORQUE)),
    ("Wh", Unit(_TORQUE, 3600)),
    ("W watt watts", Unit(_POWER)),
    ("Pa pascal", Unit(_PRESSURE)),
    ("bar", Unit(_PRESSURE, 100000)),
    ("A amp amps ampere", Unit((0, 0, 0, 1, 0, 0, 0))),
    ("C coulomb", Unit(_CHARGE)),
    ("Ah", Unit(_CHARGE, 3600)),
    ("V volt volts", Unit(_VOLTAGE)),
    ("Ω Ω ohm ohms", Unit(_RESISTANCE)),
    ("K kelvin", Unit(_KELVIN)),
    ("°C degC", Unit(_KELVIN, offset=27315)),
    ("bit bits", Unit(_BIT)),
    ("B byte bytes", Unit(_BIT, 8)),
    ("bps bd baud", Unit(_BITRATE)),
    ("% percent", Unit(_NONE, 1, 100)),
)


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


PREFIXABLE = _words("m g s rad Hz N Nm J W Wh Pa bar A C Ah V Ω ohm K bit B bps bd baud")
NEVER_MILLIONS = _words("m g s rad")
"""Units of which no robot has millions: `Mm` is a mistyped `mm`."""
LONG_PREFIXABLE = _words(
    "meter meters metre metres gram grams second seconds newton newtons volt volts "
    "watt watts joule joules hertz pascal amp amps ampere"
)

# Units with a prefix, such as ``mm``, that the hint "did you mean" can suggest.
_PREFIXED = (
    "kg mg mm cm km ms us kN kNm mNm kW mW mV kV mA kHz MHz kbit Mbit kB kPa kWh mAh mrad "
    "millimeter millimetre centimeter centimetre kilometer kilometre kilogram milligram"
)
COMMON: tuple[str, ...] = (*UNITS, *_PREFIXED.split())


# -- kinds of quantities ------------------------------------------------------------


def _quantities(*rows: tuple[str, str, tuple[Dimension, ...]]) -> dict[str, Quantity]:
    return {
        name: Quantity(
            name, "an" if name[0] in "aeiou" else "a", SI_UNITS[name], example, dimensions
        )
        for name, example, dimensions in rows
    }


QUANTITIES: dict[str, Quantity] = _quantities(
    ("length", "650 mm", (_LENGTH,)),
    ("area", "0.5 m^2", ((2, 0, 0, 0, 0, 0, 0),)),
    ("volume", "0.02 m^3", ((3, 0, 0, 0, 0, 0, 0),)),
    ("mass", "5 kg", (_MASS,)),
    ("time", "0.5 s", (_TIME,)),
    ("angle", "15 deg", (_ANGLE,)),
    ("velocity", "1.5 m/s", (_SPEED,)),
    ("acceleration", "1.5 m/s^2", ((1, 0, -2, 0, 0, 0, 0),)),
    ("angular_velocity", "3000 rpm", (_TURNING,)),
    ("angular_acceleration", "40 rad/s^2", ((0, 0, -2, 0, 0, 1, 0),)),
    ("force", "120 N", (_FORCE,)),
    ("torque", "90 N m", (_TORQUE,)),
    ("inertia", "1e-4 kg m^2", ((2, 1, 0, 0, 0, 0, 0),)),
    ("stiffness", "20 kN/m", ((0, 1, -2, 0, 0, 0, 0),)),
    ("damping", "900 N s/m", ((0, 1, -1, 0, 0, 0, 0),)),
    (
        "rotational_stiffness",
        "300 N m/rad",
        ((2, 1, -2, 0, 0, -1, 0), _TORQUE),
    ),
    (
        "rotational_damping",
        "0.5 N m s/rad",
        ((2, 1, -1, 0, 0, -1, 0), (2, 1, -1, 0, 0, 0, 0)),
    ),
    ("ratio", "42:1", (_NONE,)),
    ("number", "0.8", (_NONE,)),
    ("frequency", "50 Hz", (_PER_TIME,)),
    ("voltage", "48 V", (_VOLTAGE,)),
    ("current", "30 A", ((0, 0, 0, 1, 0, 0, 0),)),
    ("resistance", "0.2 ohm", (_RESISTANCE,)),
    ("charge", "70 Ah", (_CHARGE,)),
    ("energy", "3.3 kWh", (_TORQUE,)),
    ("power", "500 W", (_POWER,)),
    ("density", "2700 kg/m^3", ((-3, 1, 0, 0, 0, 0, 0),)),
    ("pressure", "2 bar", (_PRESSURE,)),
    ("bitrate", "500 kbit/s", (_BITRATE,)),
    ("data", "8 byte", (_BIT,)),
    ("temperature", "20 degC", (_KELVIN,)),
)
