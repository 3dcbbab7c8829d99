"""Values of a module's parameters, and of the scalars and expressions that use them.

Every reader here returns a value of the asked type in SI, whatever it finds: a
fault is reported and a harmless value goes on, so that one run shows all faults.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from typing import Any

from thorvaldc.compiler.library import Library, ModuleType
from thorvaldc.compiler.source.expressions import ExpressionError, evaluate
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.units import UnitError, parse_any, parse_quantity
from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model.spatial import Pose, Vec3

NONE = "none"
LARGEST = 1e12  # in SI, of any quantity: its squares and products stay far from overflow
SMALLEST = 1e-15
FULL_TURN = 2.0 * math.pi
MAX_CHAIN = 30  # values that need one another in a row
MAX_CHOICES = 12  # modules chosen by parameters of modules chosen by parameters ...
WHEEL_SIZES = ("radius", "width")


class _Cycle(Exception):
    """A `let` or a parameter that needs itself."""


class _Faulty(Exception):
    """A name was used whose own value has a fault that is in the report already."""


FAULT: Any = object()  # in place of a value whose fault is reported


def nearest(word: str, known: list[str]) -> str:
    """A hint: the nearest of the known words, or all of them."""
    everything = "known: " + ", ".join(f"`{k}`" for k in known) if known else "there are none"
    return did_you_mean(word, known) or everything


class ModuleChoice(Mapping[str, Any]):
    """The value of a `module` parameter: a type with parameters of its own.

    As a mapping it gives the values of the chosen module's parameters, which is
    what `${wheel.radius}` reads; for a wheel without such a parameter, the radius
    and width that it states as a wheel.
    """

    def __init__(self, module: ModuleType, params: dict[str, Node], written_in: Scope) -> None:
        self.module = module
        self.params = params
        self.written_in = written_in
        self._scope: Scope | None = None

    @property
    def scope(self) -> Scope:
        if self._scope is None:
            if self.written_in.depth > MAX_CHOICES:
                raise _Cycle(f"itself: {self.module.name} -> {self.module.name}")
            self._scope = Scope(
                self.module,
                {name: (node, self.written_in) for name, node in self.params.items()},
                self.written_in.library,
                self.written_in.report,
                None,
            )
            self._scope.depth = self.written_in.depth + 1
        return self._scope

    def __getitem__(self, name: str) -> Any:
        if name in WHEEL_SIZES and name not in self.scope:
            wheel = self.module.document.get("wheel")
            stated = wheel.get(name) if wheel is not None else None
            if stated is not None:
                return self.scope.quantity(stated, "length")
        return self.scope[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.scope)

    def __len__(self) -> int:
        return len(self.scope)

    # Two choices are equal where they are one; to compare their values would evaluate all.
    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def __bool__(self) -> bool:
        """A choice is true in an expression, also where the module has no parameters."""
        return True


class Scope(Mapping[str, Any]):
    """The names that an expression of a module may use, evaluated when asked for.

    ``given`` holds the parameters set by the user of the module, each with the
    scope that its expression was written in; ``place`` is where the module is
    used, for a parameter that is missing.  ``extra`` adds names (a loop variable).
    """

    def __init__(
        self,
        module: ModuleType | None,
        given: dict[str, tuple[Node, Scope]],
        library: Library,
        report: Report,
        place: Node | None,
        extra: dict[str, Any] | None = None,
    ) -> None:
        self.module = module
        self.library = library
        self.report = report
        self._params = module.section("params") if module is not None else {}
        self._let = module.section("let") if module is not None else {}
        self._given = given
        self._place = place
        self._values: dict[str, Any] = dict(extra or {})
        self._busy: list[str] = []
        self.depth = 0

    def with_names(self, extra: dict[str, Any]) -> Scope:
        """The same scope with more names."""
        inner = Scope(self.module, self._given, self.library, self.report, self._place, extra)
        inner._values = {**self._values, **extra}
        return inner

    # -- as a mapping -----------------------------------------------------------

    def __getitem__(self, name: str) -> Any:
        value = self._value(name)
        if value is FAULT:
            raise _Faulty
        return value

    def _value(self, name: str) -> Any:
        if name in self._values:
            return self._values[name]
        if name not in self._params and name not in self._let:
            raise KeyError(name)
        if name in self._busy:
            way = [*self._busy[self._busy.index(name) :], name]
            raise _Cycle("itself: " + " -> ".join(way))
        if len(self._busy) >= MAX_CHAIN:
            way = [*self._busy[:3], "..."]
            raise _Cycle(f"more than {MAX_CHAIN} others in a row: " + " -> ".join(way))
        self._busy.append(name)
        try:
            if name in self._params:
                value = self._param(name, self._params[name])
            else:
                value = self._plain(self._let[name])
        finally:
            self._busy.pop()
        self._values[name] = value
        return value

    def __iter__(self) -> Iterator[str]:
        return iter({**self._params, **self._let, **self._values})

    def __len__(self) -> int:
        return len({**self._params, **self._let, **self._values})

    def __contains__(self, name: object) -> bool:
        return name in self._values or name in self._params or name in self._let

    def evaluate_all(self) -> tuple[Any, ...]:
        """All parameters' values, in order: with the type, what the hardware depends on."""
        return tuple(self._value(name) for name in self._params)

    # -- parameters ---------------------------------------------------------------

    def check_given(self) -> None:
        """Report parameters that the type does not have."""
        for name, (node, _) in self._given.items():
            if name not in self._params and self.module is not None:
                self.report.add(
                    "param-unknown",
                    f"`{self.module.name}` has no parameter `{name}`",
                    node.where,
                    hint=nearest(name, list(self._params)),
                )

    def _param(self, name: str, declared: Node) -> Any:
        given = self._given.get(name)
        if given is not None:
            node, scope = given
            value = scope._typed(node, declared)
            # An assembly may hand on that there is no value; that is as left out.
            if value is not None or _kind(declared) == "module":
                return self._in_range(name, declared, node, value)
        default = declared.get("default")
        if default is None:
            if self._place is not None and self.module is not None:
                self.report.add(
                    "param-missing",
                    f"`{self.module.name}` needs a value for `{name}`",
                    self._place.where,
                    hint=f"add `params: {{{name}: ...}}`: {_text(declared, 'description')}",
                )
            return FAULT
        value = self._typed(default, declared, is_default=True)
        return self._in_range(name, declared, default, value)

    def _typed(self, node: Node, declared: Node, *, is_default: bool = False) -> Any:
        kind = _kind(declared)
        quantity = _text(declared, "quantity") or "ratio"
        if node.value is None or (node.value == NONE and kind != "module"):
            # Only a default may say that there is no value; expressions then ask for it.
            if is_default:
                return None
            self.report.add(
                "wrong-type",
                f"`{node.value}` is no value here",
                node.span,
                hint="leave the parameter out to have its default",
            )
            return FAULT
        if kind == "module":
            return self._module(node, declared)
        value = self.read(node)
        if value is FAULT or value is None:
            return value
        if kind == "quantity":
            value = self._as_quantity(value, node, quantity, math.nan)
            return FAULT if math.isnan(value) else value
        if kind == "list":
            if isinstance(value, tuple | list):
                items = [
                    self.quantity(v, quantity, math.nan)
                    if isinstance(v, Node)
                    else self._as_quantity(v, node, quantity, math.nan)
                    for v in value
                ]
                return FAULT if any(map(math.isnan, items)) else tuple(items)
            wanted = "a list"
        elif kind == "integer":
            if isinstance(value, float) and value.is_integer():
                value = int(value)
            if isinstance(value, int) and not isinstance(value, bool):
                return value
            wanted = "a whole number"
        elif kind == "boolean":
            if isinstance(value, bool):
                return value
            wanted = "`true` or `false`"
        else:
            if isinstance(value, str):
                return value
            wanted = "text"
        self.report.add("wrong-type", f"{wanted} is wanted, not {_found(node)}", node.span)
        return FAULT

    def _module(self, node: Node, declared: Node) -> Any:
        params: dict[str, Node] = {}
        name_node: Node | None = node
        if isinstance(node.value, dict):
            name_node = node.get("type")
            given = node.get("params")
            params = given.value if given is not None and isinstance(given.value, dict) else {}
        if name_node is None:
            self.report.add("wrong-type", "a module needs a `type`", node.span)
            return FAULT
        value = self.read(name_node)
        if value is FAULT or value is None or isinstance(value, ModuleChoice):
            return value
        if value == NONE:
            return None
        if not isinstance(value, str):
            self.report.add(
                "wrong-type",
                f"a module type is wanted, not {_found(node)}",
                name_node.span,
                hint="write its name, as in `wheel/agri_200`, or `none`",
            )
            return FAULT
        module = self.library.load(value, name_node, self.report)
        if module is None:
            return FAULT
        wanted = _text(declared, "category")
        if wanted and module.category != wanted:
            self.report.add(
                "module-category",
                f"`{value}` is a {module.category}; a {wanted} is wanted",
                name_node.span,
            )
            return FAULT
        return ModuleChoice(module, params, self)

    def _in_range(self, name: str, declared: Node, node: Node, value: Any) -> Any:
        """The value, or ``FAULT`` where it is none of the choices or beyond a limit."""
        if value is None or value is FAULT:
            return value
        choices = declared.get("choices")
        if choices is not None and isinstance(choices.value, tuple):
            known = [str(c.value) for c in choices.value]
            if isinstance(value, ModuleChoice):
                fits = value.module.name in known
            else:
                fits = value in [self._typed(c, declared) for c in choices.value]
            if not fits:
                self.report.add(
                    "param-range",
                    f"`{name}` is {_shown(node, value)}; it may be one of "
                    + ", ".join(f"`{k}`" for k in known),
                    node.span,
                    hint=did_you_mean(str(node.value), known),
                )
                return FAULT
            return value
        if not isinstance(value, int | float) or isinstance(value, bool):
            return value
        for key, word, sign in (("minimum", "at least", 1.0), ("maximum", "at most", -1.0)):
            limit_node = declared.get(key)
            if limit_node is None:
                continue
            limit = self._typed(limit_node, declared)
            if limit is not FAULT and sign * value < sign * limit:
                shown = limit_node.value if isinstance(limit_node.value, str) else f"{limit:g}"
                if isinstance(shown, str) and shown.startswith("${"):
                    shown = f"{limit:g}"
                self.report.add(
                    "param-range",
                    f"`{name}` is {_shown(node, value)}; it must be {word} {shown}",
                    node.span,
                    labels=[Label(limit_node.span, "the limit is stated here")],
                )
                return FAULT
        return value

    # -- scalars --------------------------------------------------------------------

    def evaluate(self, node: Node) -> Any:
        """The node's own value, or that of the expression in it (``None`` on a fault)."""
        value = self.read(node)
        return None if value is FAULT else value

    def _plain(self, node: Node) -> Any:
        """The value of a `let`, or of an item of its list: a text with a unit is a quantity."""
        if isinstance(node.value, tuple):
            items = [self._plain(item) for item in node.value]
            return FAULT if any(item is FAULT for item in items) else items
        value = self.read(node)
        if isinstance(value, str) and value is node.value and not node.quoted:
            with contextlib.suppress(UnitError):
                return parse_any(value)
        return value

    def read(self, node: Node) -> Any:
        """As ``evaluate``, with ``FAULT`` for a fault: ``None`` is then a module's `none`."""
        value = node.value
        if value is None:
            return FAULT  # the schema says so
        if not (isinstance(value, str) and value.startswith("${") and value.endswith("}")):
            return value
        try:
            return evaluate(value[2:-1], self)
        except ExpressionError as fault:
            self.report.add(fault.code, fault.message, node.span, hint=fault.hint)
        except _Cycle as fault:
            self.report.add("expression-cycle", f"the value needs {fault}", node.span)
        except _Faulty:
            pass
        return FAULT

    def quantity(self, node: Node | None, quantity: str, default: float = 0.0) -> float:
        """The SI value of a quantity; ``default`` where it is left out or at fault."""
        if node is None:
            return default
        return self._as_quantity(self.read(node), node, quantity, default)

    def _as_quantity(self, value: Any, node: Node, quantity: str, default: float) -> float:
        if value is FAULT:
            return default
        if isinstance(value, bool):
            pass
        elif isinstance(value, int | float):
            if quantity == "angle" and abs(value) > FULL_TURN and node.value == value:
                self._doubt_radians(value, node)
            return self._bounded(value, node, default)
        elif isinstance(value, str):
            try:
                return self._bounded(parse_quantity(value, quantity), node, default)
            except UnitError as fault:
                self.report.add(fault.code, fault.message, node.span, hint=fault.hint)
                return default
        self.report.add(
            "wrong-type", f"a {quantity.replace('_', ' ')} is wanted, not {_found(node)}", node.span
        )
        return default

    def _doubt_radians(self, value: float, node: Node) -> None:
        self.report.add(
            "angle-in-radians",
            f"`{value:g}` without a unit is an angle of {value:g} rad, more than a full turn",
            node.span,
            hint=f"write `{value:g} deg` if degrees are meant, else `{value:g} rad`",
        )

    def _bounded(self, value: float, node: Node, default: float) -> float:
        if value == 0.0 or SMALLEST <= abs(value) <= LARGEST:
            return float(value)
        self.report.add(
            "number-out-of-range",
            f"{_shown(node, value)} is too {'small' if abs(value) < 1 else 'large'} for a robot; "
            f"numbers are from {SMALLEST:g} to {LARGEST:g} in SI units",
            node.span,
        )
        return default

    def boolean(self, node: Node | None, default: bool) -> bool:
        if node is None:
            return default
        value = self.read(node)
        if isinstance(value, bool):
            return value
        if value is not FAULT:
            self.report.add(
                "wrong-type", f"`true` or `false` is wanted, not {_found(node)}", node.span
            )
        return default

    def text(self, node: Node | None, default: str = "") -> str:
        if node is None:
            return default
        value = self.read(node)
        if isinstance(value, str):
            return value
        if value is not FAULT:
            self.report.add("wrong-type", f"text is wanted, not {_found(node)}", node.span)
        return default

    def vector(self, node: Node | None, quantity: str, default: Vec3 = (0.0, 0.0, 0.0)) -> Vec3:
        """Three quantities."""
        if node is None:
            return default
        items = node.value
        if isinstance(items, str):
            value = self.read(node)
            if value is FAULT:
                return default
            if isinstance(value, tuple | list) and len(value) == 3 and all(map(_is_number, value)):
                x, y, z = (self._bounded(v, node, 0.0) for v in value)
                return (x, y, z)
        if not isinstance(items, tuple) or len(items) != 3:
            self.report.add("wrong-type", "three numbers are wanted, x, y and z", node.span)
            return default
        return (
            self.quantity(items[0], quantity),
            self.quantity(items[1], quantity),
            self.quantity(items[2], quantity),
        )

    def pose(self, node: Node) -> Pose:
        """The pose that the keys `xyz` and `rpy` of a mapping say."""
        return Pose.from_xyz_rpy(
            self.vector(node.get("xyz"), "length"), self.vector(node.get("rpy"), "angle")
        )


def _text(node: Node, key: str) -> str:
    found = node.get(key)
    return str(found.value) if found is not None else ""


def _found(node: Node) -> str:
    if isinstance(node.value, dict):
        return "a mapping"
    if isinstance(node.value, tuple):
        return "a list"
    if node.value is None:
        return "nothing"
    if isinstance(node.value, bool):
        return f"`{str(node.value).lower()}`"
    return f"`{node.value}`"


def _shown(node: Node, value: Any) -> str:
    """What stands there, and the value where that is an expression."""
    if isinstance(node.value, str) and "${" in node.value and isinstance(value, int | float):
        return f"{value:g} (`{node.value}`)"
    return _found(node)


def _kind(declared: Node) -> str:
    return _text(declared, "type") or "quantity"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
