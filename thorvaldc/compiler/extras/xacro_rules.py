"""Rules of xacro files: what their Python expressions use, and where the files of packages are.

The package xacro evaluates expressions with ``eval``.  Without rules, an expression reaches every
function of the interpreter through the attributes of an object, such as ``().__class__``.

The rules are:

- An expression contains only the kinds of syntax in ``_SYNTAX``.
- Names do not begin with ``__``.
- Each access to an attribute becomes a call of ``read_attribute``.  This function returns only
  values of YAML files, properties of xacro namespaces, and methods of plain Python values.
- The format string of the method ``format`` reaches no attributes.
- The builtins are the functions of ``BUILTINS``, which read no files and reach no attributes.

The worker process applies the rules at each of the two functions with which xacro evaluates an
expression (``safe_eval`` and ``substitution_args._eval``).  The rules do not limit time and memory.
"""

from __future__ import annotations

import ast
import operator
import os
import re
from collections.abc import Callable, Sequence
from functools import reduce
from pathlib import Path
from string import Formatter
from types import CodeType
from typing import Any

_SYNTAX = (
    *(ast.Expression, ast.Constant, ast.Name, ast.Attribute, ast.Subscript, ast.Slice),
    *(ast.Call, ast.keyword, ast.Starred, ast.IfExp, ast.BoolOp, ast.BinOp, ast.UnaryOp),
    *(ast.Compare, ast.List, ast.Tuple, ast.Set, ast.Dict, ast.JoinedStr, ast.FormattedValue),
    *(ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp, ast.comprehension),
    *(ast.Lambda, ast.arguments, ast.arg),
    *(ast.expr_context, ast.boolop, ast.operator, ast.unaryop, ast.cmpop),
)
_CONSTANTS = (str, int, float, complex, bool, type(None), type(...))
_ATTRIBUTE_FUNCTION = "<attribute>"  # no name in an expression can be equal to this name


def _names(text: str) -> frozenset[str]:
    return frozenset(text.split())


_TEXT = _names(
    "capitalize casefold center count endswith expandtabs find format index isalnum isalpha "
    "isascii isdecimal isdigit isidentifier islower isnumeric isprintable isspace istitle isupper "
    "join ljust lower lstrip partition removeprefix removesuffix replace rfind rindex rjust "
    "rpartition rsplit rstrip split splitlines startswith strip swapcase title upper zfill"
)
_LIST = _names("append clear copy count extend index insert pop remove reverse sort")
_DICT = _names("clear copy get items keys pop popitem setdefault update values")
_SET = _names(
    "add clear copy difference discard intersection isdisjoint issubset issuperset pop remove "
    "symmetric_difference union update"
)
_NUMBER = _names("as_integer_ratio conjugate denominator imag is_integer numerator real")
# Attributes that an expression can read, by the exact class of the value.
_ATTRIBUTES: dict[type, frozenset[str]] = {
    str: _TEXT,
    list: _LIST,
    tuple: frozenset({"count", "index"}),
    dict: _DICT,
    set: _SET,
    frozenset: _SET,
    int: _NUMBER | {"bit_length"},
    bool: _NUMBER,
    float: _NUMBER | {"hex"},
    complex: _NUMBER,
    range: frozenset({"start", "stop", "step", "count", "index"}),
}
# Attributes of classes, such as `str.upper` in `map(str.upper, names)`.
_CLASS_ATTRIBUTES: dict[type, frozenset[str]] = {
    str: _TEXT - {"format"},
    dict: frozenset({"fromkeys"}),
}


class ForbiddenExpressionError(Exception):
    """Raised if an expression uses something that the rules do not allow.

    The text of the exception names what is not allowed.
    """


def compile_expression(expression: str) -> CodeType:
    """Compiles an expression, and replaces each access to an attribute by ``read_attribute``.

    Raises ``ForbiddenExpressionError`` if the rules do not allow the expression, and
    ``SyntaxError`` if it is not an expression.  The caller must evaluate the result with the
    builtins of ``builtins_for``.
    """
    tree = ast.parse(expression.strip(), "<expression>", "eval")
    for node in ast.walk(tree):
        _check_node(node)
    return compile(ast.fix_missing_locations(_AttributeCalls().visit(tree)), "<expression>", "eval")


def _check_node(node: ast.AST) -> None:
    if not isinstance(node, _SYNTAX):
        raise ForbiddenExpressionError(f"the syntax `{type(node).__name__}`")
    if isinstance(node, ast.Constant) and not isinstance(node.value, _CONSTANTS):
        raise ForbiddenExpressionError(f"a value of the class `{type(node.value).__name__}`")
    names: list[str | None] = []
    if isinstance(node, ast.Name):
        names = [node.id]
    elif isinstance(node, (ast.arg, ast.keyword)):
        names = [node.arg]
    elif isinstance(node, ast.comprehension) and node.is_async:
        raise ForbiddenExpressionError("the syntax `async`")
    for name in names:
        if name is not None and name.startswith("__"):
            raise ForbiddenExpressionError(f"the name `{name}`")
    if isinstance(node, ast.Attribute) and node.attr.startswith("__"):
        raise ForbiddenExpressionError(f"the attribute `{node.attr}`")


class _AttributeCalls(ast.NodeTransformer):
    """Replaces ``value.name`` by a call of ``read_attribute`` with the value and the name."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        value = self.visit(node.value)
        function = ast.Name(_ATTRIBUTE_FUNCTION, ast.Load())
        return ast.copy_location(ast.Call(function, [value, ast.Constant(node.attr)], []), node)


def attribute_reader(
    yaml_dict: type, yaml_list: type, namespaces: tuple[type, ...]
) -> Callable[[Any, str], Any]:
    """Returns the function ``read_attribute(value, name)`` for the classes of xacro.

    - ``yaml_dict``, ``yaml_list``: classes of mappings and lists in YAML files.
    - ``namespaces``: classes of namespaces, such as ``math`` or an included file with ``ns``.
    """

    def read_attribute(value: Any, name: str) -> Any:
        kind = type(value)
        if kind in namespaces:
            # `getattr` of a namespace would also find the methods of the class.
            if name in value:
                return value[name]
            raise NameError(f"name '{name}' is not defined")
        if kind is yaml_dict and (name in _DICT or name in value or not hasattr(kind, name)):
            return getattr(value, name)
        plain = list if kind is yaml_list else kind
        allowed = _CLASS_ATTRIBUTES.get(value) if kind is type else _ATTRIBUTES.get(plain)
        if allowed is None or name not in allowed:
            if kind is not type and not hasattr(value, name):
                raise AttributeError(f"'{kind.__name__}' object has no attribute '{name}'")
            raise ForbiddenExpressionError(f"the attribute `{name}` of a `{kind.__name__}`")
        if kind is str and name == "format":
            return _checked_format(value)
        return getattr(value, name)

    return read_attribute


def _checked_format(text: str) -> Callable[..., str]:
    """Returns the method ``format`` of a text whose format string reaches no attributes."""
    _check_format(text)
    return text.format


def _check_format(text: str) -> None:
    for _, field, specification, _ in Formatter().parse(text):
        if field is not None and "." in field:
            raise ForbiddenExpressionError(f"the attribute in the format `{{{field}}}`")
        if specification:
            _check_format(specification)


def add_all(values: Any, start: Any = 0) -> Any:
    """Replaces the builtin ``sum``, whose rounding of floats depends on the version of Python."""
    return reduce(operator.add, values, start)


def class_of(value: Any) -> type:
    """Replaces the builtin ``type``, which also creates classes."""
    return type(value)


# Builtins of expressions in `$(eval ...)`.
BUILTINS: dict[str, Any] = {
    f.__name__: f
    for f in (
        *(list, dict, map, len, str, float, int, bool, min, max, round, abs, all, any, complex),
        *(divmod, enumerate, filter, frozenset, hash, isinstance, ord, chr, pow, range, repr),
        *(reversed, slice, set, sorted, tuple, zip),
    )
} | {"sum": add_all, "type": class_of}


def builtins_for(read_attribute: Callable[[Any, str], Any], functions: dict[str, Any]) -> Any:
    """Returns the builtins with which a compiled expression must be evaluated."""
    return {**functions, _ATTRIBUTE_FUNCTION: read_attribute}


# -- files and folders of ROS packages ----------------------------------------------


def find_package(
    name: str,
    packages: dict[str, str],
    search: dict[str, Sequence[str]],
    near: str,
) -> str | None:
    """Returns the folder of a ROS package, or ``None`` if the package is not found.

    Search order for a ROS package:

    1. the folders in ``packages``, which the robot file sets
    2. the folders ``share/<name>`` in the install prefixes ``search["ament"]``
    3. the folders ``search["ros"]``, which are packages or contain packages
    4. the parent folders of the file ``near``, and the subfolders of these folders
    """
    if name in packages:
        return packages[name]
    for prefix in search["ament"]:
        folder = os.path.join(prefix, "share", name)
        if os.path.isdir(folder):
            return folder
    for root in search["ros"]:
        for folder in (root, os.path.join(root, name)):
            if os.path.basename(folder) == name and os.path.isdir(folder):
                return folder
    for above in Path(near).absolute().parents:
        if above.name == name:
            return str(above)
        if (above / "package.xml").is_file():
            declared = re.search(
                r"<name>\s*([^<\s]+)\s*</name>",
                (above / "package.xml").read_text("utf-8", "replace"),
            )
            if declared is not None and declared[1] == name:
                return str(above)
        if (above / name / "package.xml").is_file():
            return str(above / name)
    return None


MAX_SOURCE_FOLDERS = 3000


def find_in_sources(folder: str, rest: str) -> str | None:
    """Returns the file of the path ``rest`` in the source folder of a package.

    A package can install `description/urdf/` as `urdf/`.  If the path does not exist in the source
    folder, returns the only file whose path ends with ``rest``, or ``None``.
    """
    path = os.path.join(folder, rest)
    if os.path.exists(path):
        return path
    ending = os.path.join(os.sep, os.path.normpath(rest))
    matches: list[str] = []
    for count, (inner, folders, files) in enumerate(os.walk(folder)):
        if count > MAX_SOURCE_FOLDERS:
            return None
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if os.path.basename(rest) in files:
            candidate = os.path.join(inner, os.path.basename(rest))
            matches += [candidate] if candidate.endswith(ending) else []
    return matches[0] if len(matches) == 1 else None
