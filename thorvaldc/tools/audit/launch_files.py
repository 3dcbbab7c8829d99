"""Reads launch files in Python (syntax tree only), XML and YAML.

Python and YAML become the elements of XML, so that one reader reads all three.
"""

from __future__ import annotations

import ast
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from thorvaldc.compiler.descriptions.facts import Fact, UnreadableFileError
from thorvaldc.compiler.extras.plugin_facts import walk
from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Span
from thorvaldc.tools.audit import audit_facts as facts

# -- Python ------------------------------------------------------------------------------

_PACKAGE_FOLDER = (
    *("get_package_share_directory", "get_package_share_path", "FindPackageShare"),
    "FindPackagePrefix",
)
_WRAPPERS = (
    *("ParameterFile", "RewrittenYaml", "ReplaceString", "Path", "str", "ParameterValue"),
    *("PythonLaunchDescriptionSource", "AnyLaunchDescriptionSource", "XMLLaunchDescriptionSource"),
    *("FrontendLaunchDescriptionSource", "YAMLLaunchDescriptionSource", "TextSubstitution"),
)
_ACTIONS = {
    **dict.fromkeys(("Node", "LifecycleNode", "ComposableNodeContainer"), "node"),
    "ComposableNode": "composable_node",
    "IncludeLaunchDescription": "include",
    "DeclareLaunchArgument": "arg",
}
_KEYWORDS = {
    "package": "pkg",
    "executable": "exec",
    "plugin": "exec",
    "default_value": "default",
}


def read_python(data: bytes, file: str, path: Path) -> facts.LaunchFile:
    """Reads a Python launch file.  Raises ``UnreadableFileError``."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # such as invalid escapes in the file of others
            tree = ast.parse(data)
        children = tuple(_PythonElements(tree, file, path).elements())
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = f" (line {error.lineno})" if isinstance(error, SyntaxError) else ""
        raise UnreadableFileError(f"it is not Python{line}") from None
    return read_xml(Element("launch", {}, children, "", Span(file), (), path), file, path)


class _PythonElements:
    """Makes the elements of a launch file in XML from the calls in a syntax tree.

    Values that are computed in an unknown way, or of names with several values, are ``None``.
    """

    def __init__(self, tree: ast.Module, file: str, path: Path) -> None:
        self.tree, self.file, self.path = tree, file, path
        self.names: dict[str, ast.expr | None] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.Assign) and isinstance(target := node.targets[0], ast.Name):
                self.names[target.id] = None if target.id in self.names else node.value
            elif isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
                self.names[node.target.id] = None

    def elements(self) -> Iterator[Element]:
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Call) and call_name(node) in _ACTIONS:
                yield self.action(_ACTIONS[call_name(node)], node)

    def element(
        self, tag: str, span: Span, attributes: Mapping[str, Any], children: Iterable[Element] = ()
    ) -> Element:
        """Returns an element; attributes that are missing (``None``) are left out."""
        texts = {name: str(value) for name, value in attributes.items() if value is not None}
        return Element(tag, texts, tuple(children), "", span, (), self.path)

    def action(self, tag: str, call: ast.Call) -> Element:
        stated = {k.arg: _text(self.value(k.value)) for k in call.keywords if k.arg}
        attributes = {_KEYWORDS.get(name, name): text for name, text in stated.items()}
        if call.args and tag in ("arg", "include"):
            attributes["name" if tag == "arg" else "file"] = _text(self.value(call.args[0]))
        attributes["args"] = " ".join(map(str, self.items(keyword(call, "arguments"))))
        return self.element(tag, _span(call, self.file), attributes, self.parameters(call))

    def items(self, node: ast.expr | None) -> list[Any]:
        value = self.value(node)
        return [item for item in value if item is not None] if isinstance(value, list) else []

    def parameters(self, call: ast.Call) -> Iterator[Element]:
        listed = keyword(call, "parameters")
        if isinstance(listed, ast.Name):
            listed = self.names.get(listed.id)
        for item in listed.elts if isinstance(listed, ast.List | ast.Tuple) else ():
            value, span = self.value(item), _span(item, self.file)
            if isinstance(value, str):
                yield self.element("param", span, {"from": value})
            spans = {
                key.value: _span(inner, self.file)
                for key, inner in zip(item.keys, item.values, strict=True)
                if isinstance(key, ast.Constant)
            } if isinstance(item, ast.Dict) else {}  # fmt: skip
            for name, entry in _flat(value).items():
                text = "$(unknown)" if entry is None else _text(entry)
                place = spans.get(name, span)
                kind = "str" if isinstance(entry, str) else None
                attributes = {"name": name, "value": text, "type": kind}
                yield self.element("param", place, attributes)

    def value(self, node: ast.expr | None) -> Any:
        """Returns a text, number, flag, list or dict; ``None`` stands for an unknown value.

        A launch argument is the text ``$(var name)``, as in XML.
        """
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.Name):
            return self.value(self.names.get(node.id))
        if isinstance(node, ast.List | ast.Tuple):
            return [self.value(item) for item in node.elts]
        if isinstance(node, ast.Dict):
            pairs = [(self.value(k), self.value(v)) for k, v in zip(node.keys, node.values)]  # noqa: B905
            return {key: value for key, value in pairs if isinstance(key, str)}
        if isinstance(node, ast.FormattedValue):
            return self.value(node.value)
        if isinstance(node, ast.JoinedStr):
            parts = [self.value(part) for part in node.values]
            return None if None in parts else "".join(map(str, parts))
        if isinstance(node, ast.BinOp):
            parts = [self.value(node.left), self.value(node.right)]
            joined = "" if isinstance(node.op, ast.Add) else "/"
            return joined.join(parts) if all(isinstance(p, str) for p in parts) else None
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            number = self.value(node.operand)
            return -number if isinstance(number, int | float) else None
        return self.call_value(node) if isinstance(node, ast.Call) else None

    def call_value(self, node: ast.Call) -> Any:
        name = call_name(node)
        keywords = ("package", "variable_name", "source_file", "param_file", "launch_file_path")
        stated = (keyword(node, keyword_name) for keyword_name in keywords)
        first = self.value(node.args[0] if node.args else next(filter(None, stated), None))
        if name in _PACKAGE_FOLDER:
            package = _text(first)
            return f"package://{package}" if package is not None else None
        if name in ("join", "joinpath", "PathJoinSubstitution"):
            parts = [self.value(argument) for argument in node.args]
            texts = list(map(_text, first if name == "PathJoinSubstitution" and first else parts))
            return None if None in texts else "/".join(str(text).rstrip("/") for text in texts)
        if name == "LaunchConfiguration":
            return f"$(var {first})"
        if name in _WRAPPERS:  # a list of substitutions is joined without separator
            return _text(first) if isinstance(first, list) else first
        return None


def call_name(node: ast.Call) -> str:
    """Returns the last part of the name of the called function, such as ``join``."""
    function = node.func
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


def keyword(node: ast.Call, name: str) -> ast.expr | None:
    """Returns the value of a keyword argument of a call, or ``None``."""
    return next((k.value for k in node.keywords if k.arg == name), None)


def _span(node: ast.expr, file: str) -> Span:
    end = (node.end_lineno or node.lineno, (node.end_col_offset or node.col_offset) + 1)
    if end[0] != node.lineno:  # only the name of the call, not its many lines
        end = (node.lineno, node.col_offset + 2)
    return Span(file, node.lineno, node.col_offset + 1, *end)


def _text(value: Any) -> str | None:
    """Returns a value as XML has it; the texts of a list are joined."""
    if isinstance(value, list):
        texts = list(map(_text, value))
        return None if None in texts else "".join(map(str, texts))
    return str(value).lower() if isinstance(value, bool) else None if value is None else str(value)


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Returns the entries of a dict of parameters, with dotted names."""
    entries: dict[str, Any] = {}
    for name, item in value.items() if isinstance(value, dict) else ():
        entries |= (
            _flat(item, f"{prefix}{name}.") if isinstance(item, dict) else {prefix + name: item}
        )
    return entries


# -- XML and YAML ------------------------------------------------------------------------

_SUBSTITUTION = re.compile(r"\$\(([\w-]+)\s*([^()]*)\)")


def read_xml(root: Element, file: str, path: Path) -> facts.LaunchFile:
    """Reads the element ``<launch>`` of an XML launch file."""
    launch = facts.LaunchFile(path)
    elements = walk(root)
    defaults = {
        element.attributes.get("name", ""): element.attributes["default"]
        for element in elements
        if element.tag == "arg" and "default" in element.attributes
    }
    for element in elements:
        if element.tag in ("node", "composable_node"):
            launch.nodes.append(_node_of(element, defaults))
        elif element.tag == "include":
            name = substituted(element.attributes.get("file", ""), defaults)
            fact = Fact("launch file", "launch file", name, element.span)
            launch.includes += [fact] if name else []
    return launch


def read_yaml(document: Node, file: str, path: Path) -> facts.LaunchFile:
    """Reads the list ``launch`` of a YAML launch file, whose entries are elements as in XML."""
    return read_xml(_element("launch", document, path), file, path)


def _element(tag: str, node: Node, path: Path) -> Element:
    """Returns an entry of a YAML launch file as the XML element that means the same.

    Scalars become attributes.  The items of a list such as ``param`` become elements with this
    name.  An item of ``launch`` or a group has the name of its element as key: ``- node: {...}``.
    """
    mapping = node.value if isinstance(node.value, dict) else {"children": node}
    attributes: dict[str, str] = {}
    children: list[Element] = []
    for key, value in mapping.items():
        if not isinstance(value.value, tuple | dict):
            attributes[key] = _text(value.value) or ""
        for item in value.value if isinstance(value.value, tuple) else ():
            if key not in ("launch", "children"):
                children.append(_element(key, item, path))
            elif isinstance(item.value, dict) and len(item.value) == 1:
                children += [_element(kind, body, path) for kind, body in item.value.items()]
    stated = mapping.get("from") or mapping.get("value")
    span = stated.span if stated is not None else node.where
    return Element(tag, attributes, tuple(children), "", span, (), path)


def _node_of(element: Element, defaults: dict[str, str]) -> facts.LaunchedNode:
    attributes = element.attributes
    parameters: dict[str, Fact] = {}
    files: list[Fact] = []
    for child in element.children:
        if child.tag not in ("param", "rosparam"):
            continue
        source = child.attributes.get("from") or child.attributes.get("file")
        name = child.attributes.get("name", "")
        text = substituted(source or child.attributes.get("value", ""), defaults)
        if not source:
            value = text if child.attributes.get("type") == "str" else _scalar(text)
            parameters[name] = Fact("parameter", name, value, child.span)
        elif text is not None:
            files.append(Fact("parameter file", name, text, child.span))
    return facts.LaunchedNode(
        package=attributes.get("pkg", ""),
        executable=attributes.get("exec", attributes.get("type", attributes.get("plugin", ""))),
        name=attributes.get("name", ""),
        span=element.span,
        parameters=parameters,
        parameter_files=tuple(files),
        arguments=tuple(attributes.get("args", "").split()),
    )


def substituted(text: str, defaults: dict[str, str], depth: int = 0) -> str | None:
    """Replaces substitutions in a text of a launch file; returns ``None`` if one is unknown."""
    unknown = False

    def value_of(match: re.Match[str]) -> str:
        nonlocal unknown
        kind, argument = match[1], match[2].strip()
        if kind in ("find-pkg-share", "find", "find-pkg-prefix") and argument:
            return f"package://{argument}"
        if kind in ("var", "arg") and argument in defaults and depth < 10:
            value = substituted(defaults[argument], defaults, depth + 1)
            if value is not None:
                return value
        unknown = True
        return ""

    replaced = _SUBSTITUTION.sub(value_of, text)
    return None if unknown or "$(" in replaced else replaced


def _scalar(text: str | None) -> Any:
    if text is None:
        return None
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return float(text)
    except ValueError:
        return text


def resolved(fact: Fact, launch: facts.LaunchFile, evidence: facts.Evidence) -> Path | None:
    """Returns the path of a file that a launch file names, or ``None`` outside of the audit."""
    name = str(fact.value)
    if name.startswith("package://"):
        return evidence.file_in_package(name.removeprefix("package://"))
    if name.startswith("/") or "://" in name:
        return None
    return launch.path.parent / name
