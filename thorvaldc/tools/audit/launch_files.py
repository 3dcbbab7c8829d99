"""Reads launch files in Python (syntax tree only), XML and YAML, and follows their includes."""

from __future__ import annotations

import ast
import os
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from thorvaldc.compiler.extras.xacro_expand import Element
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Span
from thorvaldc.tools.audit.audit_facts import Evidence, Fact, LaunchedNode, LaunchFile
from thorvaldc.tools.audit.launch_values import (
    LaunchValues,
    call_name,
    keyword,
    plain_parameters,
)

_NODES = ("Node", "LifecycleNode", "ComposableNodeContainer", "ComposableNode")
MAX_NESTING = 150


def is_python_launch(data: bytes) -> bool:
    return b"generate_launch_description" in data


def read_python_launch(data: bytes, file: str, path: Path) -> LaunchFile:
    """Reads a Python launch file.  Raises ``ValueError`` if the text is not Python."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # such as invalid escapes in the file of others
            tree = ast.parse(data)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = f" (line {error.lineno})" if isinstance(error, SyntaxError) else ""
        raise ValueError(f"it is not Python{line}") from None
    values = LaunchValues(tree)
    launch = LaunchFile(file, path)
    for call, conditional in _calls(tree):
        name = call_name(call)
        span = _span(call, file)
        if name in _NODES:
            launch.nodes.append(_python_node(call, values, span, conditional))
        elif name == "IncludeLaunchDescription":
            source = values.value(call.args[0] if call.args else None)
            if isinstance(source, list):
                source = source[0] if len(source) == 1 else None
            if isinstance(source, str):
                kind = "conditional include" if conditional else "include"
                launch.includes.append(Fact(kind, "launch file", source, span))
    return launch


def _span(node: ast.expr, file: str) -> Span:
    end = (node.end_lineno or node.lineno, (node.end_col_offset or node.col_offset) + 1)
    if end[0] != node.lineno:  # only the name of the call, not its many lines
        end = (node.lineno, node.col_offset + 2)
    return Span(file, node.lineno, node.col_offset + 1, *end)


def _calls(tree: ast.AST) -> Iterator[tuple[ast.Call, bool]]:
    """Yields all calls, and whether a condition decides on them."""
    stack: list[tuple[ast.AST, bool]] = [(tree, False)]
    while stack:
        node, conditional = stack.pop()
        if isinstance(node, ast.Call):
            conditional = conditional or keyword(node, "condition") is not None
            yield node, conditional
        conditional = conditional or isinstance(node, ast.If | ast.IfExp)
        stack += [(child, conditional) for child in reversed(list(ast.iter_child_nodes(node)))]


def _python_node(
    call: ast.Call, values: LaunchValues, span: Span, conditional: bool
) -> LaunchedNode:
    def text(name: str) -> str:
        value = values.value(keyword(call, name))
        return value if isinstance(value, str) else ""

    parameters: dict[str, Fact] = {}
    files: list[Fact] = []
    listed = keyword(call, "parameters")
    if isinstance(listed, ast.Name):
        listed = values.names.get(listed.id)
    for item in listed.elts if isinstance(listed, ast.List | ast.Tuple) else ():
        value = values.value(item)
        place = _span(item, span.file)
        if isinstance(value, str):
            files.append(Fact("parameter file", text("name"), value, place))
        for name, entry in plain_parameters(value).items():
            parameters[name] = Fact("parameter", name, entry, _entry_span(item, name, place))
    remappings = values.value(keyword(call, "remappings"))
    return LaunchedNode(
        package=text("package"),
        executable=text("executable") or text("plugin"),
        name=text("name"),
        namespace=_namespace(call, values),
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


def _namespace(call: ast.Call, values: LaunchValues) -> str:
    node = keyword(call, "namespace")
    value = values.value(node)
    if node is None:
        return ""
    if isinstance(value, str):
        return value
    # Two nodes with the same variable as name space are in the same name space.
    return f"<{node.id}>" if isinstance(node, ast.Name) else f"<line {node.lineno}>"


def _pairs(value: Any) -> Iterator[tuple[str, str]]:
    for item in value if isinstance(value, list) else ():
        if isinstance(item, list) and len(item) == 2 and all(isinstance(i, str) for i in item):
            yield item[0], item[1]


def _texts(value: Any) -> list[str]:
    return [str(v) for v in value if v is not None] if isinstance(value, list) else []


# -- XML and YAML ------------------------------------------------------------------------

_SUBSTITUTION = re.compile(r"\$\(([\w-]+)\s*([^()]*)\)")


def read_xml_launch(root: Element, file: str, path: Path) -> LaunchFile:
    """Reads the element ``<launch>`` of an XML launch file."""
    launch = LaunchFile(file, path)
    defaults = {
        child.attributes.get("name", ""): child.attributes["default"]
        for child in root.children
        if child.tag == "arg" and "default" in child.attributes
    }

    def collect(element: Element, conditional: bool, namespace: str) -> None:
        for child in element.children:
            attributes = child.attributes
            decided = conditional or "if" in attributes or "unless" in attributes
            if child.tag == "group":
                pushed = child.find("push-ros-namespace") or child.find("push_ros_namespace")
                inner = pushed.attributes.get("namespace", "") if pushed is not None else ""
                collect(child, decided, f"{namespace}/{inner}".strip("/"))
            elif child.tag == "include":
                kind = "conditional include" if decided else "include"
                name = substituted(attributes.get("file", ""), defaults)
                if name is not None:
                    launch.includes.append(Fact(kind, "launch file", name, child.span))
            elif child.tag in ("node", "composable_node"):
                launch.nodes.append(_xml_node(child, defaults, decided, namespace))
            else:
                collect(child, decided, namespace)

    collect(root, False, "")
    return launch


def _xml_node(
    element: Element, defaults: dict[str, str], conditional: bool, namespace: str
) -> LaunchedNode:
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
        if text is None:
            continue
        if source:
            files.append(Fact("parameter file", name, text, child.span))
        else:
            parameters[name] = Fact("parameter", name, _scalar(text), child.span)
    own = attributes.get("namespace", attributes.get("ns", ""))
    return LaunchedNode(
        package=attributes.get("pkg", ""),
        executable=attributes.get("exec", attributes.get("type", attributes.get("plugin", ""))),
        name=attributes.get("name", ""),
        namespace=f"{namespace}/{own}".strip("/"),
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

    def replace(match: re.Match[str]) -> str:
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

    result = _SUBSTITUTION.sub(replace, text)
    return None if unknown or "$(" in result else result


def _scalar(text: str) -> Any:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return float(text)
    except ValueError:
        return text


def read_yaml_launch(document: Node, file: str, path: Path) -> LaunchFile:
    """Reads the list ``launch`` of a YAML launch file."""
    launch = LaunchFile(file, path)
    defaults: dict[str, str] = {}

    def items(node: Node | None) -> tuple[Node, ...]:
        return node.value if node is not None and isinstance(node.value, tuple) else ()

    def text(node: Node | None) -> str:
        return str(node.value) if node is not None and not isinstance(node.value, tuple) else ""

    def collect(entries: tuple[Node, ...], conditional: bool, namespace: str) -> None:
        for entry in entries:
            if not isinstance(entry.value, dict) or len(entry.value) != 1:
                continue
            ((kind, body),) = entry.value.items()
            decided = conditional or body.get("if") is not None or body.get("unless") is not None
            if kind == "arg" and body.get("default") is not None:
                defaults[text(body.get("name"))] = text(body.get("default"))
            elif kind == "group":
                collect(items(body) or items(body.get("children")), decided, namespace)
            elif kind == "include":
                name = substituted(text(body.get("file")), defaults)
                if name is not None:
                    fact = "conditional include" if decided else "include"
                    launch.includes.append(Fact(fact, "launch file", name, body.where))
            elif kind == "node":
                launch.nodes.append(node_of(body, decided, namespace))

    def node_of(body: Node, conditional: bool, namespace: str) -> LaunchedNode:
        parameters: dict[str, Fact] = {}
        files: list[Fact] = []
        for entry in items(body.get("param")):
            source, name = entry.get("from"), text(entry.get("name"))
            value = entry.get("value")
            if source is not None:
                shown = substituted(text(source), defaults)
                if shown is not None:
                    files.append(Fact("parameter file", name, shown, source.span))
            elif value is not None and not isinstance(value.value, tuple | dict):
                parameters[name] = Fact("parameter", name, value.value, value.span)
        pairs = [(text(e.get("from")), text(e.get("to"))) for e in items(body.get("remap"))]
        return LaunchedNode(
            package=text(body.get("pkg")),
            executable=text(body.get("exec")),
            name=text(body.get("name")),
            namespace=text(body.get("namespace")) or namespace,
            span=body.where,
            parameters=parameters,
            parameter_files=tuple(files),
            remappings=tuple(pairs),
            arguments=tuple(text(body.get("args")).split()),
            conditional=conditional,
        )

    collect(items(document.get("launch")), False, "")
    return launch


# -- the tree of launch files ---------------------------------------------------------------

MAX_LAUNCH_FILES = 200


def launched_nodes(launch: LaunchFile, evidence: Evidence) -> Iterator[LaunchedNode]:
    """Yields the nodes of a launch file and of the files that it includes without condition."""
    by_path = {os.path.realpath(other.path): other for other in evidence.launches}
    open_files, known = [launch], {os.path.realpath(launch.path)}
    while open_files and len(known) < MAX_LAUNCH_FILES:
        current = open_files.pop()
        yield from current.nodes
        for include in current.includes:
            path = resolved(include, current, evidence)
            real = os.path.realpath(path) if path is not None else ""
            if include.kind == "include" and real in by_path and real not in known:
                known.add(real)
                open_files.append(by_path[real])


def resolved(fact: Fact, launch: LaunchFile, evidence: Evidence) -> Path | None:
    """Returns the path of a file that a launch file names, or ``None`` outside of the audit."""
    name = str(fact.value)
    if name.startswith("package://"):
        return evidence.file_in_package(name.removeprefix("package://"))
    if name.startswith("/") or "://" in name:
        return None
    return launch.path.parent / name
