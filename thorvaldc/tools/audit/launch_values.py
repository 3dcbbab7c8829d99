"""Reads plain values from the syntax tree of a Python launch file, without running it."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from typing import Any

_PACKAGE_FOLDER = (
    *("get_package_share_directory", "get_package_share_path", "FindPackageShare"),
    "FindPackagePrefix",
)
_WRAPPERS = (
    *("ParameterFile", "RewrittenYaml", "ReplaceString", "Path", "str", "ParameterValue"),
    *("PythonLaunchDescriptionSource", "AnyLaunchDescriptionSource", "XMLLaunchDescriptionSource"),
    *("FrontendLaunchDescriptionSource", "YAMLLaunchDescriptionSource", "TextSubstitution"),
)
MAX_DEPTH = 60


class LaunchValues:
    """Values of the names in a launch file: constants, and the defaults of launch arguments.

    A value that is computed in another way, or has several values, is unknown (``None``).
    """

    def __init__(self, tree: ast.Module) -> None:
        self.arguments: dict[str, ast.expr] = {}
        self.names: dict[str, ast.expr | None] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and call_name(node) == "DeclareLaunchArgument":
                name = node.args[0] if node.args else keyword(node, "name")
                default = keyword(node, "default_value")
                if isinstance(name, ast.Constant) and default is not None:
                    self.arguments[str(name.value)] = default
            elif isinstance(node, ast.Assign) and len(node.targets) == 1:
                target = node.targets[0]
                if isinstance(target, ast.Name):
                    is_new = target.id not in self.names
                    self.names[target.id] = node.value if is_new else None
            elif isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
                self.names[node.target.id] = None

    def value(self, node: ast.expr | None, depth: int = 0) -> Any:
        """Returns a text, number, flag, list or dict; ``None`` stands for an unknown value."""
        if node is None or depth > MAX_DEPTH:
            return None
        inner = depth + 1
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.Name):
            return self.value(self.names.get(node.id), inner)
        if isinstance(node, ast.List | ast.Tuple):
            return [self.value(item, inner) for item in node.elts]
        if isinstance(node, ast.Dict):
            keys = [self.value(key, inner) for key in node.keys]
            values = [self.value(value, inner) for value in node.values]
            return {k: v for k, v in zip(keys, values, strict=True) if isinstance(k, str)}
        if isinstance(node, ast.JoinedStr):
            return self.joined(node, inner)
        if isinstance(node, ast.BinOp):
            left, right = self.value(node.left, inner), self.value(node.right, inner)
            if isinstance(left, str) and isinstance(right, str):
                return left + right if isinstance(node.op, ast.Add) else f"{left}/{right}"
            return None
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            number = self.value(node.operand, inner)
            return -number if isinstance(number, int | float) else None
        if isinstance(node, ast.Call):
            return self.call(node, inner)
        return None

    def joined(self, node: ast.JoinedStr, depth: int) -> str | None:
        parts = [
            self.value(part.value if isinstance(part, ast.FormattedValue) else part, depth)
            for part in node.values
        ]
        return "".join(map(str, parts)) if all(part is not None for part in parts) else None

    def call(self, node: ast.Call, depth: int) -> Any:
        name = call_name(node)
        first = node.args[0] if node.args else None
        if name in _PACKAGE_FOLDER:
            package = self.value(first or keyword(node, "package"), depth)
            package = package[0] if isinstance(package, list) and len(package) == 1 else package
            return f"package://{package}" if isinstance(package, str) else None
        if name in ("join", "joinpath"):
            parts = [self.value(argument, depth) for argument in node.args]
            return _joined_path(parts)
        if name == "PathJoinSubstitution":
            parts = self.value(first, depth)
            return _joined_path(parts) if isinstance(parts, list) else None
        if name == "LaunchConfiguration":
            argument = self.value(first or keyword(node, "variable_name"), depth)
            default = self.arguments.get(argument) if isinstance(argument, str) else None
            return self.value(default or keyword(node, "default"), depth)
        if name in _WRAPPERS:
            wrapped = first or keyword(node, "source_file") or keyword(node, "param_file")
            value = self.value(wrapped or keyword(node, "launch_file_path"), depth)
            if isinstance(value, list):  # a list of substitutions is joined without separator
                known = all(isinstance(part, str) for part in value)
                return "".join(value) if known else None
            return value
        return None


def _joined_path(parts: list[Any]) -> str | None:
    flat = [p[0] if isinstance(p, list) and len(p) == 1 else p for p in parts]
    if not flat or not all(isinstance(part, str) for part in flat):
        return None
    return "/".join(part.rstrip("/") for part in flat)


def call_name(node: ast.Call) -> str:
    """Returns the last part of the name of the called function, such as ``join``."""
    function = node.func
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


def keyword(node: ast.Call, name: str) -> ast.expr | None:
    """Returns the value of a keyword argument of a call, or ``None``."""
    return next((k.value for k in node.keywords if k.arg == name), None)


def plain_parameters(value: Any) -> Mapping[str, Any]:
    """Returns the entries of a dict of parameters, with dotted names."""
    entries: dict[str, Any] = {}
    if isinstance(value, dict):
        for name, item in value.items():
            if isinstance(item, dict):
                inner = plain_parameters(item)
                entries.update({f"{name}.{key}": entry for key, entry in inner.items()})
            else:
                entries[name] = item
    return entries
