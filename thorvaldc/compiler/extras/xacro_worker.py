"""Expands xacro files in a separate process with limited rights, time and memory.

A xacro file contains Python expressions.  For security, the compiler expands xacro files in a
separate worker process, which has no environment variables.  The rules of ``xacro_rules`` apply
to each expression, the file may read only in the folders of the request, and the process has the
limits of ``worker_protocol``.  With the option ``--trust``, only these limits are left.
The messages are described in ``worker_protocol``.

The package xacro does not keep the line numbers of XML elements.  The class ``_Builder`` stores the
position of each XML element as DOM user data.  A clone of an XML element keeps the position of the
original element.  The method ``Expansion.patches`` replaces functions of xacro by wrappers that use
the positions of XML elements.  Each element of the expanded file has the line of its definition in
a xacro file, and the macro calls that created the element.  Each error of the xacro expansion has
the position of the XML element that causes the error.
"""

from __future__ import annotations

import os
import re
import xml.dom.minidom
from collections.abc import Callable, Iterator, Sequence
from typing import Any
from xml.dom import expatbuilder
from xml.parsers.expat import ExpatError

from thorvaldc.compiler.extras import xacro_rules
from thorvaldc.compiler.source.readable_folders import is_below

Position = tuple[int, int, int]  # index of the file, line, column

MEMORY_BYTES = 450_000_000
MAX_SOURCE_BYTES = 8 << 20
MAX_ELEMENTS = 100_000
_KEY = "position"


class ExpansionError(Exception):
    """Raised if a xacro file cannot be expanded.

    - ``kind``: kind of the error, which is ``xml``, ``root``, ``limit``, ``argument``,
      ``environment``, ``package``, ``forbidden`` or ``expression``.  The compiler reports a
      different diagnostic for each kind.
    - ``text``: description of the error.
    - ``position``: position of the error, or ``None`` if it is unknown.
    """

    def __init__(self, kind: str, text: str, position: Position | None = None) -> None:
        super().__init__(text)
        self.kind = kind
        self.position = position


class _PositionKeeper:
    """A DOM user data handler that copies the position of an XML element to its clone."""

    def handle(self, operation: int, key: str, data: Any, source: Any, clone: Any) -> None:
        clone.setUserData(key, data, self)


_KEEPER = _PositionKeeper()


class _Builder(expatbuilder.ExpatBuilderNS):
    """A DOM builder that stores the position at which each XML element starts."""

    def __init__(self, file_index: int) -> None:
        super().__init__()
        self.file_index = file_index

    def start_element_handler(self, name: str, attributes: Any) -> None:
        super().start_element_handler(name, attributes)
        parser = self.getParser()
        position = (self.file_index, parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)
        self.curNode.setUserData(_KEY, (position, ()), _KEEPER)  # with no macro calls yet


class _Arguments(dict[str, str]):
    """Arguments or environment variables of a xacro file, with a record of the names that xacro
    reads."""

    def __init__(self, arguments: dict[str, str]) -> None:
        super().__init__(arguments)
        self.used: dict[str, None] = {}

    def __getitem__(self, name: str) -> str:
        self.used[name] = None
        return super().__getitem__(name)

    def __contains__(self, name: object) -> bool:
        self.used[str(name)] = None
        return super().__contains__(name)


def _position(node: Any) -> Position | None:
    data = node.getUserData(_KEY) if node.nodeType == node.ELEMENT_NODE else None
    return data[0] if data is not None else None


class Expansion:
    """Expands one xacro file.

    - ``xacro``: the imported module xacro.
    - ``entry``: JSON object of the file in the request.
    - ``folders``: folders in which the file may read, or ``None`` if the user trusts the file.
    """

    def __init__(self, xacro: Any, entry: dict[str, Any], folders: Sequence[str] | None) -> None:
        self.xacro = xacro
        self.entry = entry
        self.folders = folders
        self.files: list[str] = []
        self.warnings: list[tuple[str, Position | None]] = []
        self.macros: dict[str, tuple[list[str], Position | None]] = {}
        self.called: dict[str, None] = {}
        self.properties: dict[str, Position | None] = {}
        self.packages: dict[str, str] = {}
        self.environment = _Arguments(entry["env"])
        self.error_position: Position | None = None
        # Xacro includes, macro calls and property definitions that lead to an error.
        self.trail: list[tuple[Position, str]] = []
        self.current: Any = None  # element whose attributes xacro reads

    # -- replacements of functions of xacro --------------------------------------

    def parse(self, inp: Any, filename: str | None = None) -> Any:
        """Replaces the function ``parse`` of xacro, which parses a xacro file.

        Limits the size of a xacro file and stores the position of each XML element.
        """
        if inp is not None or filename is None:
            return inp
        filename = self.in_sources(filename)
        try:
            with self.open(filename, "rb") as file:
                data = file.read(MAX_SOURCE_BYTES + 1)
        except OSError as error:
            # The error of a failed include belongs to the xacro file that contains the include.
            self.xacro.filestack.pop()
            text = f"file `{filename}` cannot be read: {error.strerror}"
            # If an optional include fails, xacro expects an OSError inside a XacroException.
            raise self.xacro.XacroException(exc=OSError(text)) from error
        if len(data) > MAX_SOURCE_BYTES:
            raise ExpansionError(
                "limit", f"file `{filename}` is larger than {MAX_SOURCE_BYTES >> 20} MB"
            )
        if filename not in self.files:
            self.files.append(filename)
        index = self.files.index(filename)
        try:
            return _Builder(index).parseString(data)
        except ExpatError as error:
            text = str(error).partition(": line")[0]
            raise ExpansionError("xml", text, (index, error.lineno, error.offset + 1)) from error

    def open(self, filename: str, mode: str = "r") -> Any:
        """Replaces the builtin ``open``, with which xacro reads YAML files."""
        path = os.path.realpath(self.in_sources(filename))
        is_outside = self.folders is not None and not is_below(path, self.folders)
        if is_outside and os.path.exists(path):
            text = f"the file `{filename}` is outside of the folders that may be read"
            raise ExpansionError("forbidden", text)
        return open(path, mode)

    def in_sources(self, filename: str) -> str:
        """Returns the place of an installed file in the source folder of its package."""
        if self.entry.get("source_layout"):
            for folder in self.packages.values():
                if filename.startswith(os.path.join(folder, "")):
                    return (
                        xacro_rules.find_in_sources(folder, os.path.relpath(filename, folder))
                        or filename
                    )
        return filename

    def with_rules(self, function: Callable[..., Any], builtins: dict[str, Any]) -> Any:
        """Returns a replacement of ``eval`` that applies ``xacro_rules`` to an expression.

        - ``function``: the original function, which evaluates expressions of a trusted file.
        - ``builtins``: builtins of the expression.
        """
        x = self.xacro
        read_attribute = xacro_rules.attribute_reader(
            x.YamlDictWrapper, x.YamlListWrapper, (x.NameSpace,)
        )
        functions = xacro_rules.builtins_for(read_attribute, builtins)

        def call(expression: str, symbols: Any, more: Any = None) -> Any:
            try:
                if self.folders is None:
                    return function(expression, symbols, more)
                code = xacro_rules.compile_expression(expression)
                symbols.update(__builtins__=functions)
                return eval(code, symbols, more)
            except SyntaxError as error:
                raise ValueError(f"`{expression}` is not an expression: {error.msg}") from error
            except xacro_rules.ForbiddenExpressionError as error:
                shown = expression if len(expression) < 100 else f"{expression[:100]}..."
                raise ExpansionError("forbidden", f"`{shown}` uses {error}") from error

        return call

    def with_position(self, function: Callable[..., Any], label: str = "") -> Callable[..., Any]:
        """Wraps a function of xacro whose first argument is an XML element.

        If the xacro function raises an exception, the wrapper stores the position of the XML
        element.

        - ``label``: text of the entry that the wrapper adds to the trail of the error.
        """

        def call(node: Any, *rest: Any) -> Any:
            try:
                result = function(node, *rest)
            except Exception:
                position = _position(node)
                if self.error_position is None:
                    child = self.current
                    is_child = child is not None and child.parentNode is node
                    self.error_position = (_position(child) if is_child else None) or position
                elif label and position is not None and position != self.error_position:
                    self.trail.append((position, label))
                raise
            self.error_position = None  # xacro has ignored the error of an optional include
            self.trail.clear()
            return result

        return call

    def with_current(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps ``reqd_attrs`` of xacro, and stores the XML element that xacro reads."""

        def call(node: Any, names: Any) -> Any:
            self.current = node
            return function(node, names)

        return call

    def with_calls(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps the function ``replace_node`` of xacro, which inserts the result of a macro call.

        Stores the position of a xacro macro call in each XML element that the macro call inserts.
        """

        def call(node: Any, by: Any, content_only: bool = False) -> None:
            call_position = _position(node)
            if isinstance(by, xml.dom.minidom.Element) and by.tagName == "xacro:macro":
                for element in by.getElementsByTagName("*"):
                    data = element.getUserData(_KEY)
                    if data is not None and call_position is not None:
                        calls = (*data[1], call_position)
                        element.setUserData(_KEY, (data[0], calls), _KEEPER)
            function(node, by, content_only)

        return call

    def recording_property(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps ``grab_property`` of xacro, and stores the position of each property definition."""

        def call(node: Any, table: Any) -> Any:
            self.properties[node.getAttribute("name")] = _position(node)
            return function(node, table)

        return self.with_position(call)

    def recording_macro(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps the function ``grab_macro`` of xacro, which reads a macro definition.

        Stores the required parameters and the position of each xacro macro definition.
        """

        def call(node: Any, macros: Any) -> Any:
            name = node.getAttribute("name").removeprefix("xacro:")
            result = function(node, macros)
            macro = macros[name]
            required = [p for p in macro.params if p not in macro.defaultmap]
            self.macros[name] = (required, _position(node))
            return result

        return self.with_position(call)

    def recording_call(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps ``handle_macro_call`` of xacro, and stores the name of each called macro."""

        def call(node: Any, *rest: Any) -> Any:
            self.called[node.tagName.rpartition(":")[2].rpartition(".")[2]] = None
            return function(node, *rest)

        return self.with_position(call, "called here")

    def with_definition(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps the method ``Table._resolve_`` of xacro, which evaluates a property.

        If a xacro property has an error, the error message also shows the definition of the
        property.
        """

        def call(table: Any, key: str) -> Any:
            try:
                return function(table, key)
            except Exception:
                position = self.properties.get(key)
                if position is not None:
                    self.trail.append((position, f"property `{key}` is defined here"))
                raise

        return call

    def find(self, name: str) -> str:
        """Replaces the xacro substitution ``$(find name)``.

        Returns the folder of a ROS package.  The original ``$(find)`` of xacro would search the ROS
        installation.
        """
        near = self.xacro.filestack[-1] or self.entry["file"]
        folder = xacro_rules.find_package(name, self.entry["packages"], self.entry["search"], near)
        if folder is None:
            raise ExpansionError("package", name)
        self.packages[name] = folder
        return folder

    def with_packages(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps the function ``abs_filename_spec`` of xacro, which finds an included file.

        A xacro include can then have a URL that begins with ``package://`` or ``file://``.
        """

        def call(spec: str) -> Any:
            if spec.startswith("package://"):
                name, _, rest = spec.removeprefix("package://").partition("/")
                return os.path.join(self.find(name), rest)
            return function(spec.removeprefix("file://"))

        return call

    def with_substitutions(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wraps ``eval_extension`` of xacro, which evaluates a substitution ``$(...)``.

        The xacro substitution ``$(find)`` then calls ``find_package``.  The xacro substitutions
        ``$(env)`` and ``$(optenv)`` read the variables that the robot file states; the worker
        process itself has no environment variables.
        """

        def required(name: str) -> str:
            if name not in self.environment:
                raise ExpansionError("environment", name)
            return self.environment[name]

        def optional(name: str, default: str = "") -> str:
            self.environment.used[name] = None
            return self.environment.get(name, default)

        def call(text: str) -> Any:
            from xacro import substitution_args

            substitution_args._eval_find = self.find
            substitution_args._eval_env = required
            substitution_args._eval_optenv = optional
            substitution_args._eval_dict.update(find=self.find, env=required, optenv=optional)
            substitution_args.eval = self.with_rules(eval, xacro_rules.BUILTINS)
            try:
                return function(text)
            except self.xacro.XacroException as error:
                if isinstance(error.exc, ExpansionError):
                    raise error.exc from error
                if isinstance(error.exc, substitution_args.ArgException):
                    raise ExpansionError("argument", str(error.exc)) from error
                raise

        return call

    def warn(self, *words: Any, **_: Any) -> str:
        """Replaces the functions ``warning`` and ``error`` of xacro, and stores their messages."""
        text = " ".join(str(w) for w in words)
        if "deprecated" not in text:
            self.warnings.append((text, _position(self.current) if self.current else None))
        return ""

    # -- the run -----------------------------------------------------------------

    def patches(self) -> dict[str, Any]:
        """Returns the replacements for functions of xacro, by the name of the function."""
        x = self.xacro
        return {
            "parse": self.parse,
            "eval_all": self.with_position(x.eval_all),
            "process_include": self.with_position(x.process_include, "included here"),
            "grab_property": self.recording_property(x.grab_property),
            "grab_macro": self.recording_macro(x.grab_macro),
            "handle_macro_call": self.recording_call(x.handle_macro_call),
            "reqd_attrs": self.with_current(x.reqd_attrs),
            "replace_node": self.with_calls(x.replace_node),
            "abs_filename_spec": self.with_packages(x.abs_filename_spec),
            "eval_extension": self.with_substitutions(x.eval_extension),
            "warning": self.warn,
            "error": self.warn,
            "safe_eval": self.with_rules(x.safe_eval, {}),
            "open": self.open,
        }

    def run(self) -> dict[str, Any]:
        """Evaluates the xacro file.  The caller must first apply ``patches`` to xacro."""
        path = self.entry["file"]
        arguments = _Arguments(self.entry["args"])
        self.xacro.init_stacks(path)
        document = self.parse(None, path)
        root = document.documentElement
        if root.tagName != "robot":
            raise ExpansionError("root", f"<{root.tagName}>", _position(root))
        if self.entry["macro"]:
            call = root.appendChild(document.createElement(f"xacro:{self.entry['macro']}"))
            call.setUserData(_KEY, (_position(root), ()), _KEEPER)
        plain = path.lower().endswith(".urdf") and not root.hasAttribute("xmlns:xacro")
        if not plain:
            self.xacro.process_doc(document, mappings=arguments)
        children = [c for c in root.childNodes if c.nodeType == c.ELEMENT_NODE]
        if sum(1 for _ in _walk(root)) > MAX_ELEMENTS:
            raise ExpansionError(
                "limit", f"the expanded file has more than {MAX_ELEMENTS} elements"
            )
        return {
            "elements": [_encode(child, root) for child in children],
            "unused": [name for name in self.entry["args"] if name not in arguments.used],
            "known": list(arguments.used),
            "unused_env": [n for n in self.entry["env"] if n not in self.environment.used],
            "known_env": list(self.environment.used),
        }

    def answer(self) -> dict[str, Any]:
        """Returns the JSON answer with the expanded xacro file or the reason of a failure.

        The JSON answer also contains the list of the files that xacro read.  In the JSON answer, a
        position contains the index of the xacro file in the list of files.
        """
        x = self.xacro
        resolve = x.Table._resolve_
        patches = self.patches()
        originals = {name: getattr(x, name) for name in patches}
        try:
            for name, value in patches.items():
                setattr(x, name, value)
            x.Table._resolve_ = self.with_definition(resolve)
            # Expressions in a xacro file can call functions of xacro, as in `xacro.warning(...)`.
            functions = x._global_symbols
            dict.update(functions["xacro"], warning=self.warn, error=self.warn, message=_ignore)
            dict.update(functions["python"], sum=xacro_rules.add_all)
            if self.folders is not None:
                dict.update(functions["python"], type=xacro_rules.class_of)
                dict.pop(functions["python"], "vars", None)  # gives all attributes of an object
            answer = self.run()
        except Exception as error:
            answer = {"failure": self.describe(error)}
        finally:
            for name, value in originals.items():
                setattr(x, name, value)
            x.Table._resolve_ = resolve
        trail = [
            (position, text) for position, text in self.trail if position != self.error_position
        ]
        return answer | {
            "files": self.files,
            "warnings": self.warnings,
            "macros": [(name, *macro) for name, macro in self.macros.items()],
            "called": list(self.called),
            "packages": self.packages,
            "trail": trail[:6] if "failure" in answer else [],
        }

    def describe(self, error: Exception) -> dict[str, Any]:
        """Returns the description of a failed xacro expansion for the JSON answer.

        - ``error``: exception that the method ``run`` raised.
        """
        kind, position = "expression", self.error_position
        expansion_error = _find_cause(error, ExpansionError)
        if expansion_error is not None:
            kind, text = expansion_error.kind, str(expansion_error)
            position = expansion_error.position or position
        elif _find_cause(error, MemoryError) is not None:
            kind, text = "limit", f"it needs more than {MEMORY_BYTES / 1e6:.0f} MB of memory"
        elif _find_cause(error, RecursionError) is not None:
            text = "it calls itself without end (a macro, a property or an include)"
        else:
            text = re.sub(r"\s*\n\s*when", ", when", str(error)) or type(error).__name__
            text = " ".join(text.split())
        return {"kind": kind, "text": text, "position": position}


def _ignore(*_: Any, **__: Any) -> str:
    return ""


def _find_cause(error: BaseException | None, type_: type[Any]) -> Any:
    """Searches a Python exception and its causes for an exception of the class ``type_``.

    Returns the first exception of the class ``type_``, or ``None``.
    """
    count = 0
    while error is not None and count < 50:
        if isinstance(error, type_):
            return error
        inner = getattr(error, "exc", None)  # a XacroException stores its cause in `exc`
        error = inner if isinstance(inner, BaseException) else error.__cause__ or error.__context__
        count += 1
    return None


def _walk(node: Any) -> Iterator[Any]:
    for child in node.childNodes:
        if child.nodeType == child.ELEMENT_NODE:
            yield child
            yield from _walk(child)


def _encode(node: Any, root: Any) -> dict[str, Any]:
    """Converts an XML element to a JSON object for the answer to the compiler.

    The JSON object of a URDF extension, such as ``<gazebo>``, contains the XML text of the element
    beside its child elements.
    """
    position, calls = node.getUserData(_KEY) or (None, ())
    element = {
        "tag": node.tagName,
        "attributes": dict(node.attributes.items()),
        "position": position,
        "calls": calls,
    }
    if node.parentNode is root and node.tagName not in ("link", "joint", "material"):
        for name, value in root.attributes.items():
            if name.startswith("xmlns:") and not node.hasAttribute(name):
                prefix = name.removeprefix("xmlns:") + ":"
                if any(
                    used_name.startswith(prefix)
                    for inner in (node, *_walk(node))
                    for used_name in (inner.tagName, *inner.attributes.keys())
                ):
                    node.setAttribute(name, value)
        element["xml"] = node.toxml()
    texts = [
        c.data
        for c in node.childNodes
        if c.nodeType in (c.TEXT_NODE, c.CDATA_SECTION_NODE) and c.data.strip()
    ]
    children = [_encode(c, root) for c in node.childNodes if c.nodeType == c.ELEMENT_NODE]
    return element | {"children": children, "text": " ".join(texts).strip()}


def answer(request: dict[str, Any], _: bytes) -> tuple[dict[str, Any], bytes]:
    """Expands the xacro file of a request, see ``Expansion``."""
    import xacro.substitution_args
    import yaml  # noqa: F401  # imported by xacro in `load_yaml`

    xacro.open = open  # replaced by `Expansion.open`
    os.chdir(os.path.dirname(request["file"]))
    return Expansion(xacro, request, request["folders"]).answer(), b""
