"""Reads launch files in Python (syntax tree only), XML and YAML, and follows their includes.

Python and YAML become the elements of XML, so that one reader reads all three.
"""

from __future__ import annotations

import ast
import os
import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
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
    "GroupAction": "group",
    "PushRosNamespace": "push_ros_namespace",
    "PushROSNamespace": "push_ros_namespace",
    "DeclareLaunchArgument": "arg",
}


def is_python_launch(data: bytes) -> bool:
    return b"generate_launch_description" in data


def read_python(data: bytes, file: str, path: Path) -> facts.LaunchFile:
    """Reads a Python launch file.  Raises ``UnreadableFileError``."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # such as invalid escapes in the file of others
            tree = ast.parse(data)
        children = tuple(_PythonElements(tree, file, path).of(tree))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = f" (line {error.lineno})" if isinstance(error, SyntaxError) else ""
        raise UnreadableFileError(f"it is not Python{line}") from None
    return read_xml(Element("launch", {}, children, "", Span(file), (), path), file, path)


class _PythonElements:
    """Makes the elements of a launch file in XML from the calls in a syntax tree.

    Values that are computed in an unknown way, or of names with several values, are ``None``.
    """

    def __init__(self, tree: ast.Module, file: str, path: Path) -> None:
        self.file, self.path = file, path
        self.names: dict[str, ast.expr | None] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.Assign) and isinstance(target := node.targets[0], ast.Name):
                self.names[target.id] = None if target.id in self.names else node.value
            elif isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
                self.names[node.target.id] = None
        # What a group contains by its name is read with the group.
        calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call)]
        groups = [call for call in calls if call_name(call) == "GroupAction"]
        self.grouped = {id(action) for group in groups for action in self.actions(group)}

    def of(self, node: ast.AST) -> list[Element]:
        """Returns the elements of the calls in a node."""
        tag = _ACTIONS.get(call_name(node)) if isinstance(node, ast.Call) else None
        if isinstance(node, ast.Call) and tag is not None:
            return [self.action(tag, node)]
        if isinstance(node, ast.Assign) and id(node.value) in self.grouped:
            return []
        children = [e for child in ast.iter_child_nodes(node) for e in self.of(child)]
        if isinstance(node, ast.If | ast.IfExp) and children:
            span = children[0].span
            return [self.element("group", span, children, {"if": "?", "scoped": "false"})]
        return children

    def element(
        self, tag: str, span: Span, children: list[Element], attributes: Mapping[str, Any]
    ) -> Element:
        """Returns an element; attributes that are missing (``None``) are left out."""
        texts = {name: str(value) for name, value in attributes.items() if value is not None}
        return Element(tag, texts, tuple(children), "", span, (), self.path)

    def action(self, tag: str, call: ast.Call) -> Element:
        first = call.args[0] if call.args else None
        attributes: dict[str, Any] = {"if": "?" if keyword(call, "condition") else None}
        children: list[Element] = []
        if tag == "group":
            attributes["scoped"] = _text(self.value(keyword(call, "scoped")))
            children = [e for action in self.actions(call) for e in self.of(action)]
        elif tag == "push_ros_namespace":
            attributes["namespace"] = self.namespace(first or keyword(call, "namespace"))
        elif tag == "arg":
            attributes["name"] = self.value(first or keyword(call, "name"))
            attributes["default"] = _text(self.value(keyword(call, "default_value")))
        elif tag == "include":
            attributes["file"] = _text(self.value(first)) or "$(unknown)"
            children = self.passed(call)
        else:
            plain = {n: self.value(keyword(call, n)) for n in ("package", "executable", "plugin")}
            attributes |= {
                "pkg": plain["package"],
                "exec": plain["executable"] or plain["plugin"],
                "name": self.value(keyword(call, "name")),
                "namespace": self.namespace(keyword(call, "namespace")),
                "args": " ".join(map(str, self.items(keyword(call, "arguments")))),
            }
            children = [*self.parameters(call), *self.remappings(call)]
            nested = keyword(call, "composable_node_descriptions")
            children += self.of(nested) if nested is not None else []
        return self.element(tag, _span(call, self.file), children, attributes)

    def actions(self, group: ast.Call) -> list[ast.expr]:
        """Returns the actions of a group; names stand for the only value that a file gives them."""
        listed = self.named(group.args[0] if group.args else keyword(group, "actions"))
        if not isinstance(listed, ast.List | ast.Tuple):
            return [listed] if listed is not None else []
        items = [item.value if isinstance(item, ast.Starred) else item for item in listed.elts]
        return [self.named(item) or item for item in items]

    def named(self, node: ast.expr | None) -> ast.expr | None:
        known = self.names.get(node.id) if isinstance(node, ast.Name) else None
        return known if known is not None else node

    def passed(self, include: ast.Call) -> list[Element]:
        """Returns the arguments in ``launch_arguments``, the items of a dict."""
        node = keyword(include, "launch_arguments")
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            node = node.func.value
        node = self.named(node)
        if not isinstance(node, ast.Dict):
            return []
        return [
            self.element(
                "arg",
                _span(value, self.file),
                [],
                {"name": self.value(key), "value": self.namespace(value)},
            )
            for key, value in zip(node.keys, node.values, strict=True)
        ]

    def namespace(self, node: ast.expr | None) -> str:
        """Returns a text; an unknown value is the text of its expression."""
        value = _text(self.value(node))
        return value or "" if node is None or value is not None else f"<{ast.unparse(node)[:80]}>"

    def items(self, node: ast.expr | None) -> list[Any]:
        value = self.value(node)
        return [item for item in value if item is not None] if isinstance(value, list) else []

    def parameters(self, call: ast.Call) -> Iterator[Element]:
        listed = self.named(keyword(call, "parameters"))
        for item in listed.elts if isinstance(listed, ast.List | ast.Tuple) else ():
            value, span = self.value(item), _span(item, self.file)
            if isinstance(value, str):
                yield self.element("param", span, [], {"from": value})
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
                yield self.element("param", place, [], attributes)

    def remappings(self, call: ast.Call) -> Iterator[Element]:
        for pair in self.items(keyword(call, "remappings")):
            if isinstance(pair, list) and len(pair) == 2:
                names = dict(zip(("from", "to"), pair, strict=True))
                yield self.element("remap", _span(call, self.file), [], names)

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
_PUSHES = ("push-ros-namespace", "push_ros_namespace")


def read_xml(root: Element, file: str, path: Path) -> facts.LaunchFile:
    """Reads the element ``<launch>`` of an XML launch file."""
    launch = facts.LaunchFile(file, path)
    defaults = launch.defaults = {
        element.attributes.get("name", ""): element.attributes["default"]
        for element in walk(root)
        if element.tag == "arg" and "default" in element.attributes
    }

    def collect(element: Element, conditional: bool, namespace: str) -> None:
        for child in element.children:
            attributes = child.attributes
            decided = conditional or "if" in attributes or "unless" in attributes
            own = join(namespace, attributes.get("namespace", attributes.get("ns", "")))
            if child.tag == "include":
                name = substituted(attributes.get("file", ""), defaults)
                if name is not None:
                    fact = Fact("launch file", "launch file", name, child.span)
                    passed = {
                        arg.attributes.get("name", ""): arg.attributes.get("value")
                        for arg in child.children
                    }
                    launch.includes.append(facts.LaunchInclude(fact, own, passed, decided))
            elif child.tag in ("node", "composable_node"):
                launch.nodes.append(_node_of(child, defaults, decided, own))
                collect(child, decided, namespace)
            elif child.tag not in _PUSHES:
                pushed = _pushed(child) if attributes.get("scoped") != "false" else ""
                collect(child, decided, join(own, pushed))

    collect(root, False, _pushed(root))
    return launch


def join(*namespaces: str) -> str:
    """Returns the name space in which name spaces are one inside of the other."""
    return "/".join(filter(None, (namespace.strip("/") for namespace in namespaces)))


def _pushed(element: Element) -> str:
    """Returns the name space that an element pushes, also in groups without a scope."""
    names = [
        child.attributes.get("namespace", "") if child.tag in _PUSHES else _pushed(child)
        for child in element.children
        if child.tag in _PUSHES
        or (child.tag == "group" and child.attributes.get("scoped") == "false")
    ]
    return join(*names)


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


def _node_of(
    element: Element, defaults: dict[str, str], conditional: bool, namespace: str
) -> facts.LaunchedNode:
    attributes = element.attributes
    parameters: dict[str, Fact] = {}
    files: list[Fact] = []
    remappings: list[tuple[str, str]] = []
    for child in element.children:
        if child.tag == "remap":
            remappings.append((child.attributes.get("from", ""), child.attributes.get("to", "")))
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
        namespace=namespace,
        span=element.span,
        parameters=parameters,
        parameter_files=tuple(files),
        remappings=tuple(remappings),
        arguments=tuple(attributes.get("args", "").split()),
        conditional=conditional,
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


# -- the tree of launch files ---------------------------------------------------------------

MAX_LAUNCH_FILES = 200


def launched_nodes(
    launch: facts.LaunchFile, evidence: facts.Evidence
) -> Iterator[facts.LaunchedNode]:
    """Yields the nodes of a launch file and of the files that it includes without condition.

    Their name spaces are complete; an argument of unknown value is a name space of its own.
    """
    by_path = {os.path.realpath(other.path): other for other in evidence.launches}
    open_files: list[tuple[facts.LaunchFile, str, dict[str, str]]] = [(launch, "", {})]
    known: set[tuple[str, str, str]] = set()
    while open_files and len(known) < MAX_LAUNCH_FILES:
        current, outer, passed = open_files.pop()
        values = {**current.defaults, **passed}
        for node in current.nodes:
            yield replace(node, namespace=join(outer, _filled(node.namespace, values)))
        for include in current.includes:
            path = resolved(include.file, current, evidence)
            real = os.path.realpath(path) if path is not None else ""
            namespace = join(outer, _filled(include.namespace, values))
            arguments = {
                name: _filled(value or f"<{name}>", values)
                for name, value in include.arguments.items()
            }
            key = (real, namespace, str(arguments))
            if not include.conditional and real in by_path and key not in known:
                known.add(key)
                open_files.append((by_path[real], namespace, arguments))


_VARIABLE = re.compile(r"\$\((?:var|arg)\s+([\w-]+)\s*\)")


def _filled(text: str, values: Mapping[str, str]) -> str:
    return _VARIABLE.sub(lambda match: values.get(match[1], f"<{match[1]}>"), text)


def resolved(fact: Fact, launch: facts.LaunchFile, evidence: facts.Evidence) -> Path | None:
    """Returns the path of a file that a launch file names, or ``None`` outside of the audit."""
    name = str(fact.value)
    if name.startswith("package://"):
        return evidence.file_in_package(name.removeprefix("package://"))
    if name.startswith("/") or "://" in name:
        return None
    return launch.path.parent / name
