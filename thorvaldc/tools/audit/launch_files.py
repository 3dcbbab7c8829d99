"""Reads launch files in Python (syntax tree only), XML and YAML, and follows their includes."""

from __future__ import annotations

import ast
import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Span
from thorvaldc.tools.audit import audit_facts as facts
from thorvaldc.tools.audit.descriptions import walk

# -- plain values in the syntax tree of a Python launch file ----------------------------

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

    def namespace(self, node: ast.expr | None) -> str:
        """Returns a name space; equal expressions of unknown values are the same name space."""
        if isinstance(node, ast.Call) and call_name(node) == "LaunchConfiguration" and node.args:
            name = self.value(node.args[0])
            return f"$(var {name})"
        value = self.value(node)
        if isinstance(value, list) and all(isinstance(part, str) for part in value):
            value = "".join(value)
        if node is None or isinstance(value, str):
            return value or ""
        if isinstance(node, ast.Name) and (known := self.names.get(node.id)) is not None:
            return self.namespace(known)
        return f"<{ast.unparse(node)[:80]}>"

    def pushed(self, pushes: Sequence[ast.AST]) -> str:
        """Returns the name space of actions that push name spaces."""
        calls = [push for push in pushes if isinstance(push, ast.Call)]
        nodes = [call.args[0] if call.args else keyword(call, "namespace") for call in calls]
        return join(*map(self.namespace, nodes))

    def passed(self, node: ast.expr | None) -> dict[str, str | None]:
        """Returns the arguments in ``launch_arguments``, a dict or its items."""
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            node = node.func.value
        if isinstance(node, ast.Name):
            node = self.names.get(node.id)
        if not isinstance(node, ast.Dict):
            return {}
        keys = [self.value(key) for key in node.keys]
        pairs = zip(keys, map(self.namespace, node.values), strict=True)
        return {key: value for key, value in pairs if isinstance(key, str)}

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


_NODES = ("Node", "LifecycleNode", "ComposableNodeContainer", "ComposableNode")
_PUSHES = ("PushRosNamespace", "PushROSNamespace")


def is_python_launch(data: bytes) -> bool:
    return b"generate_launch_description" in data


def read_python(data: bytes, file: str, path: Path) -> facts.LaunchFile:
    """Reads a Python launch file.  Raises ``UnreadableFileError``."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # such as invalid escapes in the file of others
            tree = ast.parse(data)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = f" (line {error.lineno})" if isinstance(error, SyntaxError) else ""
        raise facts.UnreadableFileError(f"it is not Python{line}") from None
    values = LaunchValues(tree)
    launch = facts.LaunchFile(file, path)
    for name, default in values.arguments.items():
        if isinstance(text := values.value(default), str):
            launch.defaults[name] = text
    for call, namespace, conditional in _actions(tree, values):
        span = _span(call, file)
        if call_name(call) in _NODES:
            own = join(namespace, values.namespace(keyword(call, "namespace")))
            launch.nodes.append(_python_node(call, values, span, own, conditional))
        elif call_name(call) == "IncludeLaunchDescription":
            source = values.value(call.args[0] if call.args else None)
            if isinstance(source, list):
                source = source[0] if len(source) == 1 else None
            if isinstance(source, str):
                fact = facts.Fact("launch file", "launch file", source, span)
                arguments = values.passed(keyword(call, "launch_arguments"))
                include = facts.LaunchInclude(fact, namespace, arguments, conditional)
                launch.includes.append(include)
    return launch


def join(*namespaces: str) -> str:
    """Returns the name space in which name spaces are one inside of the other."""
    return "/".join(filter(None, (namespace.strip("/") for namespace in namespaces)))


def _actions(tree: ast.Module, values: LaunchValues) -> Iterator[tuple[ast.Call, str, bool]]:
    """Yields all calls with the name space of their groups, and whether a condition decides.

    A name space that is pushed outside of a group, or in a group without a scope, is that of the
    whole file.
    """
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    groups = {
        id(call): _group_actions(call, values) for call in calls if call_name(call) == "GroupAction"
    }
    pushes = {
        group: [action for action in actions if _is_push(action)]
        for group, actions in groups.items()
    }
    open_groups = {id(c) for c in calls if values.value(keyword(c, "scoped")) is False}
    scoped = {id(p) for group in pushes.keys() - open_groups for p in pushes[group]}
    outer = [call for call in calls if _is_push(call) and id(call) not in scoped]
    # What a group contains by its name is read with the group.
    grouped = {id(action) for actions in groups.values() for action in actions}
    stack: list[tuple[ast.AST, str, bool]] = [(tree, values.pushed(outer), False)]
    while stack:
        node, namespace, conditional = stack.pop()
        if isinstance(node, ast.Assign) and id(node.value) in grouped:
            continue
        children = list(ast.iter_child_nodes(node))
        if isinstance(node, ast.Call):
            conditional = conditional or keyword(node, "condition") is not None
            yield node, namespace, conditional
            if id(node) in groups:
                children = groups[id(node)]
                if id(node) not in open_groups:
                    namespace = join(namespace, values.pushed(pushes[id(node)]))
        conditional = conditional or isinstance(node, ast.If | ast.IfExp)
        stack += [(child, namespace, conditional) for child in reversed(children)]


def _is_push(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and call_name(node) in _PUSHES


def _group_actions(group: ast.Call, values: LaunchValues) -> list[ast.AST]:
    """Returns the actions of a group; names stand for the only value that a file gives them."""

    def named(node: ast.expr) -> ast.expr:
        known = values.names.get(node.id) if isinstance(node, ast.Name) else None
        return known if known is not None else node

    listed = group.args[0] if group.args else keyword(group, "actions")
    if listed is None:
        return []
    listed = named(listed)
    if not isinstance(listed, ast.List | ast.Tuple):
        return [listed]
    return [named(item.value if isinstance(item, ast.Starred) else item) for item in listed.elts]


def _span(node: ast.expr, file: str) -> Span:
    end = (node.end_lineno or node.lineno, (node.end_col_offset or node.col_offset) + 1)
    if end[0] != node.lineno:  # only the name of the call, not its many lines
        end = (node.lineno, node.col_offset + 2)
    return Span(file, node.lineno, node.col_offset + 1, *end)


def _python_node(
    call: ast.Call, values: LaunchValues, span: Span, namespace: str, conditional: bool
) -> facts.LaunchedNode:
    def text(name: str) -> str:
        value = values.value(keyword(call, name))
        return value if isinstance(value, str) else ""

    parameters: dict[str, facts.Fact] = {}
    files: list[facts.Fact] = []
    listed = keyword(call, "parameters")
    if isinstance(listed, ast.Name):
        listed = values.names.get(listed.id)
    for item in listed.elts if isinstance(listed, ast.List | ast.Tuple) else ():
        value = values.value(item)
        place = _span(item, span.file)
        if isinstance(value, str):
            files.append(facts.Fact("parameter file", text("name"), value, place))
        for name, entry in plain_parameters(value).items():
            parameters[name] = facts.Fact("parameter", name, entry, _entry_span(item, name, place))
    remappings = values.value(keyword(call, "remappings"))
    return facts.LaunchedNode(
        package=text("package"),
        executable=text("executable") or text("plugin"),
        name=text("name"),
        namespace=namespace,
        span=span,
        parameters=parameters,
        parameter_files=tuple(files),
        remappings=tuple(_pairs(remappings)),
        arguments=tuple(_texts(values.value(keyword(call, "arguments")))),
        conditional=conditional,
    )


def _entry_span(item: ast.expr, name: str, otherwise: Span) -> Span:
    """Returns the place of a parameter in a dict, if the dict stands in the list itself."""
    if isinstance(item, ast.Dict):
        for key, value in zip(item.keys, item.values, strict=True):
            if isinstance(key, ast.Constant) and key.value == name:
                return _span(value, otherwise.file)
    return otherwise


def _pairs(value: Any) -> Iterator[tuple[str, str]]:
    for item in value if isinstance(value, list) else ():
        if isinstance(item, list) and len(item) == 2 and all(isinstance(i, str) for i in item):
            yield item[0], item[1]


def _texts(value: Any) -> list[str]:
    return [str(v) for v in value if v is not None] if isinstance(value, list) else []


# -- XML and YAML ------------------------------------------------------------------------

_SUBSTITUTION = re.compile(r"\$\(([\w-]+)\s*([^()]*)\)")


def read_xml(root: Element, file: str, path: Path) -> facts.LaunchFile:
    """Reads the element ``<launch>`` of an XML launch file."""
    launch = facts.LaunchFile(file, path)
    defaults = {
        element.attributes.get("name", ""): element.attributes["default"]
        for element in walk(root)
        if element.tag == "arg" and "default" in element.attributes
    }

    launch.defaults.update(defaults)

    def collect(element: Element, conditional: bool, namespace: str) -> None:
        for child in element.children:
            attributes = child.attributes
            decided = conditional or "if" in attributes or "unless" in attributes
            own = join(namespace, attributes.get("namespace", attributes.get("ns", "")))
            if child.tag == "include":
                name = substituted(attributes.get("file", ""), defaults)
                if name is not None:
                    fact = facts.Fact("launch file", "launch file", name, child.span)
                    passed = {
                        arg.attributes.get("name", ""): arg.attributes.get("value")
                        for arg in child.children
                    }
                    launch.includes.append(facts.LaunchInclude(fact, own, passed, decided))
            elif child.tag in ("node", "composable_node"):
                launch.nodes.append(_node_of(child, defaults, decided, own))
            elif child.tag not in _PUSH_TAGS:
                pushed = _pushed(child) if attributes.get("scoped") != "false" else ""
                collect(child, decided, join(own, pushed))

    collect(root, False, _pushed(root))
    return launch


_PUSH_TAGS = ("push-ros-namespace", "push_ros_namespace")


def _pushed(element: Element) -> str:
    """Returns the name space that an element pushes, also in groups without a scope."""
    return join(
        *(
            _pushed(child) if child.tag == "group" else child.attributes.get("namespace", "")
            for child in element.children
            if child.tag in _PUSH_TAGS
            or (child.tag == "group" and child.attributes.get("scoped") == "false")
        )
    )


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
            attributes[key] = str(value.value)
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
    parameters: dict[str, facts.Fact] = {}
    files: list[facts.Fact] = []
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
            parameters[name] = facts.Fact("parameter", name, _scalar(text), child.span)
        elif text is not None:
            files.append(facts.Fact("parameter file", name, text, child.span))
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

    result = _SUBSTITUTION.sub(value_of, text)
    return None if unknown or "$(" in result else result


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


def resolved(fact: facts.Fact, launch: facts.LaunchFile, evidence: facts.Evidence) -> Path | None:
    """Returns the path of a file that a launch file names, or ``None`` outside of the audit."""
    name = str(fact.value)
    if name.startswith("package://"):
        return evidence.file_in_package(name.removeprefix("package://"))
    if name.startswith("/") or "://" in name:
        return None
    return launch.path.parent / name
