"""Evaluates the parameters and the `let` values of a module.

Expressions in the module document may use the names of the parameters and of the `let` values.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from typing import Any

from thorvaldc.compiler.modules.library import Library, ModuleType
from thorvaldc.compiler.source.dimensions import EXPECTED
from thorvaldc.compiler.source.dimensions import NONE as NO_DIMENSION
from thorvaldc.compiler.source.node import Node, describe_node, insertion
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.source.units import UnitError, parse_any
from thorvaldc.compiler.values import value_reader as values
from thorvaldc.diagnostics import Label, Proposal, Report, did_you_mean
from thorvaldc.model.number_origins import read_at
from thorvaldc.schema.old_words import old_parameter

NONE = "none"
# Greatest length of a chain of parameters in which the value of each parameter depends on the next
# parameter.
MAX_CHAIN = 30
MAX_CHOICES = 12  # Greatest depth of modules that are chosen by parameters of other modules.
WHEEL_SIZES = ("radius", "width")


def hint_of_known(word: str, known: list[str], text: str | None = None) -> str:
    """Returns a hint for an error message about an unknown word.

    The hint suggests the known word with the most similar spelling.  If no known word is similar,
    the hint lists all known words.  ``text``: the text of the document that contains the word, if
    it differs from the word.
    """
    all_words = "known: " + ", ".join(f"`{k}`" for k in known) if known else "there are none"
    hint = did_you_mean(word, known, all_words) or all_words
    return hint.within(text) if text is not None and isinstance(hint, Proposal) else hint


class ModuleChoice(Mapping[str, Any]):
    """The value of a `module` parameter: a module type and its parameter values.

    A ``ModuleChoice`` is a mapping of the parameter values of the chosen module.  An expression
    such as `${wheel.radius}` reads a parameter value of the chosen module.  If the chosen module
    has no parameter `radius` or `width`, the value is read from the section `wheel` of the module
    document.

    Attributes
    ----------
    module : the chosen module type.
    params : arguments for the parameters of the chosen module, by name.
    written_in : scope of the expressions in the arguments.
    """

    def __init__(self, module: ModuleType, params: dict[str, Node], written_in: Scope) -> None:
        self.module = module
        self.params = params
        self.written_in = written_in
        self._scope: Scope | None = None

    @property
    def scope(self) -> Scope:
        """Names and parameter values of the chosen module."""
        if self._scope is None:
            if self.written_in.depth > MAX_CHOICES:
                raise values.ReferenceCycleError(
                    f"itself: {self.module.name} -> {self.module.name}"
                )
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
            size = wheel.get(name) if wheel is not None else None
            if size is not None:
                return self.scope.quantity(size, "length")
        return self.scope[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.scope)

    def __len__(self) -> int:
        return len(self.scope)

    def dimension(self, name: str) -> Any:
        """Returns the dimension of a parameter of the chosen module.

        Raises ``KeyError`` if there is no such parameter.
        """
        if name in WHEEL_SIZES and name not in self.scope:
            return EXPECTED["length"]
        return self.scope.dimension(name)

    # Two ``ModuleChoice`` objects are equal only if both are the same object.  A comparison of two
    # modules by the parameter values would compute the values of all parameters.
    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def __bool__(self) -> bool:
        """Returns true, so that an expression can test whether a module parameter has a module or
        is `none`.
        """
        return True


class Scope(values.ValueReader):
    """Parameters and `let` values that expressions in a module document may use.

    The value of a parameter is computed when an expression first uses the name of the parameter.

    Parameters
    ----------
    module : the module type, or ``None`` for a robot document.  A robot document has no names.
    arguments : parameter values that the user of the module sets, by the name of the parameter.
        Each value has the scope for the expressions in the value.
    entry : entry of the document that uses the module.  Missing parameters are reported at the
        span of the entry.  ``None``: missing parameters are not reported.
    """

    def __init__(
        self,
        module: ModuleType | None,
        arguments: dict[str, tuple[Node, Scope]],
        library: Library,
        report: Report,
        entry: Node | None,
    ) -> None:
        super().__init__(report, on_robot=True)
        self.module = module
        self.library = library
        self.depth = 0
        self._params = module.section("params") if module is not None else {}
        self._let = module.section("let") if module is not None else {}
        self.arguments = arguments
        self._entry = entry
        self._values: dict[str, Any] = {}
        self._name_dimensions: dict[str, Any] = {}
        self._in_evaluation: list[str] = []
        self._in_inference: list[str] = []

    def with_names(self, extra: dict[str, Any], dimensions: dict[str, Any]) -> Scope:
        """Returns a copy of the scope with additional names for expressions.

        ``dimensions``: dimensions of the names, as ``dimensions`` describes them.
        """
        inner = Scope(self.module, self.arguments, self.library, self.report, self._entry)
        inner._values = {**self._values, **extra}
        known = {name: part for name, part in self._name_dimensions.items() if part is not None}
        inner._name_dimensions = {**known, **dimensions}
        return inner

    # -- values of names --------------------------------------------------------

    def __getitem__(self, name: str) -> Any:
        value = self._value_of(name)
        if value is values.INVALID:
            raise values.InvalidNameError
        return value

    def _value_of(self, name: str) -> Any:
        """Returns the value of a parameter or a `let` entry.

        The value of each parameter is computed once.  Raises ``KeyError`` if the name is unknown.
        Raises ``ReferenceCycleError`` if the parameter value depends on itself.
        """
        if name in self._values:
            return self._values[name]
        if name not in self._params and name not in self._let:
            raise KeyError(name)
        chain = self._in_evaluation
        if name in chain:
            cycle = [*chain[chain.index(name) :], name]
            raise values.ReferenceCycleError("itself: " + " -> ".join(cycle))
        if len(chain) >= MAX_CHAIN:
            start = " -> ".join([*chain[:3], "..."])
            raise values.ReferenceCycleError(f"more than {MAX_CHAIN} others in a row: {start}")
        chain.append(name)
        try:
            if name in self._params:
                value = self._parameter(name, self._params[name])
            else:
                value = self._let_value(self._let[name])
        finally:
            chain.pop()
        self._values[name] = value
        return value

    def dimension(self, name: str) -> Any:
        """Returns the dimension of a parameter, a `let` entry or an additional name.

        The declaration of a parameter states its dimension.  Raises ``KeyError`` if the name is
        unknown.
        """
        known = self._name_dimensions
        if name not in known:
            if name not in self:
                raise KeyError(name)
            # A name that depends on itself, or on a long chain of names, is reported elsewhere.
            known[name] = None
            if len(self._in_inference) >= MAX_CHAIN:
                return None
            declaration = self._params.get(name)
            if declaration is not None:
                known[name] = self._parameter_dimension(name, declaration)
            else:
                self._in_inference.append(name)
                known[name] = self.dimension_of(self._let[name])
                self._in_inference.pop()
        return known[name]

    def let_node(self, name: str) -> Node | None:
        return self._let.get(name)

    def _parameter_dimension(self, name: str, declaration: Node) -> Any:
        kind = _kind(declaration)
        if kind == "module":
            try:
                choice = self._value_of(name)
            except values.ReferenceCycleError:
                return None
            return choice.dimension if isinstance(choice, ModuleChoice) else None
        if kind == "integer":
            return NO_DIMENSION
        dimension = EXPECTED.get(_text(declaration, "quantity") or "ratio")
        return {"quantity": dimension, "list": [dimension]}.get(kind)

    def origin(self, name: str) -> tuple[Node, Scope] | None:
        """Returns the YAML node with the value of a parameter or a `let` entry, and the scope of
        the expression in the node.

        Returns ``None`` if the name is unknown, or if the parameter has no value.
        """
        if name in self._let:
            return self._let[name], self
        declaration = self._params.get(name)
        if declaration is None:
            return None
        argument = self.arguments.get(name)
        if argument is not None:
            node, scope = argument
            if scope.value(node) is not None or _kind(declaration) == "module":
                return argument
        default = declaration.get("default")
        return (default, self) if default is not None else None

    def __iter__(self) -> Iterator[str]:
        return iter({**self._params, **self._let, **self._values})

    def __len__(self) -> int:
        return len({**self._params, **self._let, **self._values})

    def __contains__(self, name: object) -> bool:
        return name in self._values or name in self._params or name in self._let

    def _let_value(self, node: Node) -> Any:
        """Returns the value of a `let` entry, or of an element in the list of a `let` entry.

        A text with a unit is converted to a number in SI units.
        """
        if isinstance(node.value, tuple):
            elements = [self._let_value(element) for element in node.value]
            return (
                values.INVALID
                if any(element is values.INVALID for element in elements)
                else elements
            )
        value = self.value(node)
        return _in_si(value, node) if value is node.value else value

    def scalar(self, node: Node, otherwise: Any = None) -> Any:
        """Returns a boolean, a number or a text; a text with a unit is a number in SI units.

        ``otherwise``: instead of any other value.
        """
        value = _in_si(self.evaluate(node), node)
        return value if isinstance(value, bool | int | float | str) else otherwise

    # -- parameters ---------------------------------------------------------------

    def parameter_values(self) -> tuple[Any, ...]:
        """Returns the values of all parameters, in the order of the module document."""
        return tuple(self._value_of(name) for name in self._params)

    def check_arguments(self) -> None:
        """Reports arguments whose names are not parameters of the module type."""
        for name, (node, _) in self.arguments.items():
            if name not in self._params and self.module is not None:
                old = old_parameter(self.module.name, name)
                self.report.add(
                    "param-unknown",
                    f"`{self.module.name}` has no parameter `{name}`",
                    node.where,
                    hint=old.hint if old is not None else hint_of_known(name, list(self._params)),
                )

    def _parameter(self, name: str, declaration: Node) -> Any:
        """Returns the value of a parameter, from an argument or from the default value."""
        argument = self.arguments.get(name)
        if argument is not None:
            node, scope = argument
            value = scope._typed(node, declaration)
            # If an assembly passes a parameter without a value to a module, the default value of
            # the module's parameter applies.
            if value is not None or _kind(declaration) == "module":
                return self._in_range(name, declaration, node, value)
        default = declaration.get("default")
        if default is None:
            if self._entry is not None and self.module is not None:
                self.report.add(
                    "param-missing",
                    f"`{self.module.name}` needs a value for `{name}`",
                    self._entry.where,
                    hint=_missing_param_hint(name, declaration, self._entry),
                )
            return values.INVALID
        value = self._typed(default, declaration, is_default=True)
        return self._in_range(name, declaration, default, value)

    def _typed(self, node: Node, declaration: Node, *, is_default: bool = False) -> Any:
        """Returns the value of a YAML node, converted to the declared type of a parameter.

        Returns ``INVALID`` and reports an error if the parameter value does not have the declared
        type.
        """
        kind = _kind(declaration)
        quantity = _text(declaration, "quantity") or "ratio"
        if node.value is None or (node.value == NONE and kind != "module"):
            # Only the default value of a parameter may be `none`.  An expression can test whether a
            # parameter is `none`.
            if is_default:
                return None
            if node.value is None:
                return values.INVALID  # The schema check has already reported the missing value.
            self.report.add(
                "wrong-type",
                f"`{node.value}` is not a value of this parameter",
                node.span,
                hint="leave the parameter out to get its default",
            )
            return values.INVALID
        if kind == "module":
            return self._module(node, declaration)
        value = self.value(node, quantity if kind in ("quantity", "list", "integer") else None)
        if value is values.INVALID or value is None:
            return value
        if kind == "quantity":
            value = self._to_si(value, node, quantity, math.nan)
            return values.INVALID if math.isnan(value) else value
        if kind == "list":
            if isinstance(value, tuple | list):
                elements = [
                    self.quantity(element, quantity, math.nan)
                    if isinstance(element, Node)
                    else self._to_si(element, node, quantity, math.nan)
                    for element in value
                ]
                return values.INVALID if any(map(math.isnan, elements)) else tuple(elements)
            expected = "a list"
        elif kind == "integer":
            if isinstance(value, float) and value.is_integer():
                value = round(value)
            if isinstance(value, int) and not isinstance(value, bool):
                return value if self.has_dimension(node, quantity="number") else values.INVALID
            expected = "a whole number"
        elif kind == "boolean":
            if isinstance(value, bool):
                return value
            expected = "`true` or `false`"
        else:
            if isinstance(value, str):
                return value
            expected = "text"
        self._report_type(expected, node)
        return values.INVALID

    def _module(self, node: Node, declaration: Node) -> Any:
        """Returns the value of a `module` parameter as a ``ModuleChoice``.

        Returns ``None`` if the parameter value is `none`, and ``INVALID`` if the parameter value
        has an error.
        """
        params: dict[str, Node] = {}
        name_node: Node | None = node
        if isinstance(node.value, dict):
            name_node = node.get("type")
            params = values.entries(node.get("params"))
        if name_node is None:
            self.report.add("wrong-type", "a module needs a `type`", node.span)
            return values.INVALID
        value = self.value(name_node)
        if value is values.INVALID or value is None or isinstance(value, ModuleChoice):
            return value
        if value == NONE:
            return None
        if not isinstance(value, str):
            self.report.add(
                "wrong-type",
                f"expected a module type, got {describe_node(node)}",
                name_node.span,
                hint="write its name, as in `wheel/agri_200`, or `none`",
            )
            return values.INVALID
        module = self.library.load(value, name_node, self.report)
        if module is None:
            return values.INVALID
        category = _text(declaration, "category")
        if category and module.category != category:
            self.report.add(
                "module-category",
                f"`{value}` is a {module.category}; expected a {category}",
                name_node.span,
            )
            return values.INVALID
        return ModuleChoice(module, params, self)

    def _in_range(self, name: str, declaration: Node, node: Node, value: Any) -> Any:
        """Checks the value of a parameter against the choices and the limits of the parameter.

        Returns the value.  Reports an error and returns ``INVALID`` if the parameter value is not
        allowed.
        """
        if value is None or value is values.INVALID:
            return value
        choices = declaration.get("choices")
        if choices is not None and isinstance(choices.value, tuple):
            return self._one_of(name, declaration, choices, node, value)
        if not isinstance(value, int | float) or isinstance(value, bool):
            return value
        quantity = QUANTITIES[_text(declaration, "quantity") or "ratio"]
        for key, relation, sign in (("minimum", "at least", 1.0), ("maximum", "at most", -1.0)):
            limit_node = declaration.get(key)
            if limit_node is None:
                continue
            limit = self._typed(limit_node, declaration)
            if limit is not values.INVALID and sign * value < sign * limit:
                limit_text = quantity.format_value(limit)
                if isinstance(limit_node.value, str) and not limit_node.value.startswith("${"):
                    # The error message shows the limit of the parameter with the unit.
                    limit_text = limit_node.value
                self.report.add(
                    "param-range",
                    f"`{name}` is {values.describe_value(node, value, quantity)}; "
                    f"it must be {relation} {limit_text}",
                    node.span,
                    hint=_inverted_ratio(node),
                    labels=[Label(limit_node.span, "the limit is stated here")],
                )
                return values.INVALID
        return value

    def _one_of(self, name: str, declaration: Node, choices: Node, node: Node, value: Any) -> Any:
        """Checks that the value of a parameter is one of the allowed choices.

        Returns the value.  Reports an error and returns ``INVALID`` if the parameter value is not
        allowed.
        """
        known = [str(choice.value) for choice in values.items(choices)]
        if isinstance(value, ModuleChoice):
            is_known = value.module.name in known
        else:
            is_known = value in [
                self._typed(choice, declaration) for choice in values.items(choices)
            ]
        if is_known:
            return value
        self.report.add(
            "param-range",
            f"`{name}` is {values.describe_value(node, value)}; it may be one of "
            + ", ".join(f"`{k}`" for k in known),
            node.span,
            hint=did_you_mean(str(node.value), known),
        )
        return values.INVALID


def _in_si(value: Any, node: Node) -> Any:
    """Returns a value of a node; a text with a unit becomes its SI value."""
    if isinstance(value, str) and not node.quoted:
        with contextlib.suppress(UnitError):
            return read_at(parse_any(value), node.span)
    return value


def _text(node: Node, key: str) -> str:
    entry = node.get(key)
    return str(entry.value) if entry is not None else ""


def _missing_param_hint(name: str, declaration: Node, entry: Node) -> str:
    """Returns the hint to add a value for a parameter to the entry of a module."""
    choices = values.items(declaration.get("choices"))
    quantity = QUANTITIES.get(_text(declaration, "quantity"))
    example = str(choices[0].value) if choices else quantity.example if quantity else ""
    hint = f"add `params: {{{name}: {example or '...'}}}`: {_text(declaration, 'description')}"
    if not example or not isinstance(entry.value, dict):
        return hint
    params = entry.get("params")
    if params is not None and isinstance(params.value, dict):
        return insertion(hint, params, name, example, is_example=True)
    return insertion(hint, entry, "params", f"{{{name}: {example}}}", is_example=True)


def _kind(declaration: Node) -> str:
    return _text(declaration, "type") or "quantity"


def _inverted_ratio(node: Node) -> Proposal | None:
    """Returns the hint for a ratio such as ``1:42`` that is out of range, or ``None``."""
    first, colon, second = str(node.value).partition(":")
    if not colon or node.quoted:
        return None
    ratio = f"{second.strip()}:{first.strip()}"
    return Proposal(f"write `{ratio}` if that is meant", ratio)
