"""Expands xacro files in a process of its own, under limits.

A xacro file is code: it evaluates Python and reads what it likes.  So the compiler
never expands one itself; it starts this file with an empty environment, limits
on time and memory and no right to write files, hands over the work as JSON on
stdin and reads one line of JSON per file.  The module stands alone (standard
library and xacro), because it runs without the package on its path.

xacro keeps no line numbers.  Here every element of a source file carries its place
as DOM user data, which cloning hands on, so that whatever comes out of macros,
blocks and includes still knows the line that it was written on and the calls that
it came through.
"""

from __future__ import annotations

import json
import os
import re
import sys
import xml.dom.minidom
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.dom import expatbuilder
from xml.parsers.expat import ExpatError

Place = tuple[int, int, int]  # number of the file, line, column

CPU_SECONDS = 10
MEMORY_BYTES = 1 << 30
MAX_SOURCE_BYTES = 8 << 20
MAX_ELEMENTS = 100_000
_KEY = "place"


class Refused(Exception):
    """Why an expansion ends: ``kind`` selects the diagnostic."""

    def __init__(self, kind: str, text: str, place: Place | None = None) -> None:
        super().__init__(text)
        self.kind = kind
        self.place = place


def find_package(
    name: str,
    packages: dict[str, str],
    search: dict[str, Sequence[str]],
    near: str,
) -> str | None:
    """The folder of a ROS package, or ``None``.

    Looks in the entry's own ``packages``, then under ``search["ament"]`` (prefixes,
    ``share/<name>``), ``search["ros"]`` (folders of packages, or packages), then at
    the folders above ``near`` and beside them: one that is called so, or whose
    ``package.xml`` says so.
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


class _PlaceKeeper:
    """The DOM's handler of user data: a clone stands where its original stood."""

    def handle(self, operation: int, key: str, data: Any, source: Any, clone: Any) -> None:
        clone.setUserData(key, data, self)


_KEEPER = _PlaceKeeper()


class _Builder(expatbuilder.ExpatBuilderNS):
    """minidom's own builder, which notes where each element starts."""

    def __init__(self, file: int) -> None:
        super().__init__()
        self.file = file

    def start_element_handler(self, name: str, attributes: Any) -> None:
        super().start_element_handler(name, attributes)
        parser = self.getParser()
        place = (self.file, parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)
        self.curNode.setUserData(_KEY, (place, ()), _KEEPER)


class _Arguments(dict[str, str]):
    """xacro's arguments; remembers which were asked for."""

    def __init__(self, given: dict[str, str]) -> None:
        super().__init__(given)
        self.asked: dict[str, None] = {}

    def __getitem__(self, name: str) -> str:
        self.asked[name] = None
        return super().__getitem__(name)

    def __contains__(self, name: object) -> bool:
        self.asked[str(name)] = None
        return super().__contains__(name)


def _place(node: Any) -> Place | None:
    data = node.getUserData(_KEY) if node.nodeType == node.ELEMENT_NODE else None
    return data[0] if data is not None else None


class Expansion:
    """One file's expansion: patches the places xacro offers, runs it, collects."""

    def __init__(self, xacro: Any, entry: dict[str, Any]) -> None:
        self.xacro = xacro
        self.entry = entry
        self.files: list[str] = []
        self.warnings: list[tuple[str, Place | None]] = []
        self.macros: dict[str, tuple[list[str], Place | None]] = {}
        self.called: dict[str, None] = {}
        self.properties: dict[str, Place | None] = {}
        self.packages: dict[str, str] = {}
        self.fault: Place | None = None
        self.trail: list[tuple[Place, str]] = []
        self.visited: Any = None

    # -- what replaces xacro's own functions -----------------------------------

    def parse(self, inp: Any, filename: str | None = None) -> Any:
        if inp is not None or filename is None:
            return inp
        try:
            with open(filename, "rb") as file:
                data = file.read(MAX_SOURCE_BYTES + 1)
        except OSError as fault:
            self.xacro.filestack.pop()  # as xacro does: the fault is the includer's
            text = f"file `{filename}` cannot be read: {fault.strerror}"
            # xacro looks for an OSError (an include may be optional) and prints it.
            raise self.xacro.XacroException(exc=OSError(text)) from fault
        if len(data) > MAX_SOURCE_BYTES:
            raise Refused("limit", f"file `{filename}` has over {MAX_SOURCE_BYTES >> 20} MB")
        if filename not in self.files:
            self.files.append(filename)
        number = self.files.index(filename)
        try:
            return _Builder(number).parseString(data)
        except ExpatError as fault:
            text = str(fault).partition(": line")[0]
            raise Refused("xml", text, (number, fault.lineno, fault.offset + 1)) from fault

    def located(self, function: Callable[..., Any], label: str = "") -> Callable[..., Any]:
        """``function`` (of an element first), noting the element at which it failed."""

        def call(node: Any, *rest: Any) -> Any:
            try:
                result = function(node, *rest)
            except Exception:
                place = _place(node)
                if self.fault is None:
                    last = self.visited
                    inner = last is not None and last.parentNode is node
                    self.fault = (_place(last) if inner else None) or place
                elif label and place is not None and place != self.fault:
                    self.trail.append((place, label))
                raise
            self.fault = None  # an optional include swallows its fault
            self.trail.clear()
            return result

        return call

    def required(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(node: Any, names: Any) -> Any:
            self.visited = node
            return function(node, names)

        return call

    def replaced(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """``replace_node``, which tells the inserted elements of the call they came by."""

        def call(node: Any, by: Any, content_only: bool = False) -> None:
            called = _place(node)
            if isinstance(by, xml.dom.minidom.Element) and by.tagName == "xacro:macro":
                for element in by.getElementsByTagName("*"):
                    data = element.getUserData(_KEY)
                    if data is not None and called is not None:
                        element.setUserData(_KEY, (data[0], (*data[1], called)), _KEEPER)
            function(node, by, content_only)

        return call

    def grab_property(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(node: Any, table: Any) -> Any:
            self.properties[node.getAttribute("name")] = _place(node)
            return function(node, table)

        return self.located(call)

    def grab_macro(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(node: Any, macros: Any) -> Any:
            name = node.getAttribute("name").removeprefix("xacro:")
            result = function(node, macros)
            macro = macros[name]
            needed = [p for p in macro.params if p not in macro.defaultmap]
            self.macros[name] = (needed, _place(node))
            return result

        return self.located(call)

    def macro_call(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(node: Any, *rest: Any) -> Any:
            self.called[node.tagName.rpartition(":")[2].rpartition(".")[2]] = None
            return function(node, *rest)

        return self.located(call, "called here")

    def resolved(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(table: Any, key: str) -> Any:
            try:
                return function(table, key)
            except Exception:
                place = self.properties.get(key)
                if place is not None:
                    self.trail.append((place, f"property `{key}` is defined here"))
                raise

        return call

    def find(self, name: str) -> str:
        near = self.xacro.filestack[-1] or self.entry["file"]
        folder = find_package(name, self.entry["packages"], self.entry["search"], near)
        if folder is None:
            raise Refused("package", name)
        self.packages[name] = folder
        return folder

    def absolute(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(spec: str) -> Any:
            if spec.startswith("package://"):
                name, _, rest = spec.removeprefix("package://").partition("/")
                return os.path.join(self.find(name), rest)
            return function(spec.removeprefix("file://"))

        return call

    def extension(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def environment(name: str) -> str:
            raise Refused("expression", f"$(env {name}): the environment is not passed on")

        def call(text: str) -> Any:
            from xacro import substitution_args

            substitution_args._eval_find = self.find
            substitution_args._eval_env = environment
            substitution_args._eval_dict.update(find=self.find, env=environment)
            try:
                return function(text)
            except self.xacro.XacroException as fault:
                if isinstance(fault.exc, Refused):
                    raise fault.exc from fault
                if isinstance(fault.exc, substitution_args.ArgException):
                    raise Refused("argument", str(fault.exc)) from fault
                raise

        return call

    def warn(self, *words: Any, **_: Any) -> str:
        text = " ".join(str(w) for w in words)
        if "deprecated" not in text:
            self.warnings.append((text, _place(self.visited) if self.visited else None))
        return ""

    # -- the run -----------------------------------------------------------------

    def patches(self) -> dict[str, Any]:
        x = self.xacro
        return {
            "parse": self.parse,
            "eval_all": self.located(x.eval_all),
            "process_include": self.located(x.process_include, "included here"),
            "grab_property": self.grab_property(x.grab_property),
            "grab_macro": self.grab_macro(x.grab_macro),
            "handle_macro_call": self.macro_call(x.handle_macro_call),
            "reqd_attrs": self.required(x.reqd_attrs),
            "replace_node": self.replaced(x.replace_node),
            "abs_filename_spec": self.absolute(x.abs_filename_spec),
            "eval_extension": self.extension(x.eval_extension),
            "warning": self.warn,
            "error": self.warn,
        }

    def run(self) -> dict[str, Any]:
        path = self.entry["file"]
        arguments = _Arguments(self.entry["args"])
        self.xacro.init_stacks(path)
        document = self.parse(None, path)
        root = document.documentElement
        if root.tagName != "robot":
            raise Refused("root", f"<{root.tagName}>", _place(root))
        plain = path.lower().endswith(".urdf") and not root.hasAttribute("xmlns:xacro")
        if not plain:
            self.xacro.process_doc(document, mappings=arguments)
        children = [c for c in root.childNodes if c.nodeType == c.ELEMENT_NODE]
        if sum(1 for _ in _walk(root)) > MAX_ELEMENTS:
            raise Refused("limit", f"the expanded file has over {MAX_ELEMENTS} elements")
        return {
            "elements": [_encode(child, root) for child in children],
            "unused": [name for name in self.entry["args"] if name not in arguments.asked],
            "asked": list(arguments.asked),
        }

    def answer(self) -> dict[str, Any]:
        """The expansion or its fault, with the files that places refer to."""
        x = self.xacro
        resolve, evaluate = x.Table._resolve_, x.safe_eval
        patches = self.patches()
        kept = {name: getattr(x, name) for name in patches}
        try:
            for name, value in patches.items():
                setattr(x, name, value)
            x.Table._resolve_ = self.resolved(resolve)
            x.safe_eval = _evaluate(evaluate)
            tools = x._global_symbols["xacro"]
            for name in ("warning", "error", "message"):
                dict.__setitem__(tools, name, self.warn if name != "message" else _silent)
            answer = self.run()
        except Exception as fault:
            answer = {"fault": self.describe(fault)}
        finally:
            for name, value in kept.items():
                setattr(x, name, value)
            x.Table._resolve_, x.safe_eval = resolve, evaluate
        trail = [(place, text) for place, text in self.trail if place != self.fault]
        return answer | {
            "files": self.files,
            "warnings": self.warnings,
            "macros": [(name, *about) for name, about in self.macros.items()],
            "called": list(self.called),
            "packages": self.packages,
            "trail": trail[:6] if "fault" in answer else [],
        }

    def describe(self, fault: Exception) -> dict[str, Any]:
        refused = _first(fault, Refused)
        if refused is not None:
            return {
                "kind": refused.kind,
                "text": str(refused),
                "place": refused.place or self.fault,
            }
        if _first(fault, MemoryError) is not None:
            text = f"it needs over {MEMORY_BYTES >> 30} GB of memory"
            return {"kind": "limit", "text": text, "place": self.fault}
        if _first(fault, RecursionError) is not None:
            text = "it calls itself without an end (a macro, a property or an include)"
            return {"kind": "expression", "text": text, "place": self.fault}
        text = re.sub(r"\s*\n\s*when", ", when", str(fault)) or type(fault).__name__
        return {"kind": "expression", "text": " ".join(text.split()), "place": self.fault}


def _silent(*_: Any, **__: Any) -> str:
    return ""


def _evaluate(function: Callable[..., Any]) -> Callable[..., Any]:
    """xacro's ``safe_eval``; a power or a repetition too large for memory stays a fault."""

    def call(expression: str, symbols: Any, more: Any = None) -> Any:
        try:
            return function(expression, symbols, more)
        except SyntaxError as fault:
            raise ValueError(f"`{expression}` is not an expression: {fault.msg}") from fault

    return call


def _first(fault: BaseException | None, kind: type[Any]) -> Any:
    """The exception of that kind in the chain of causes and contexts, if any."""
    seen = 0
    while fault is not None and seen < 50:
        if isinstance(fault, kind):
            return fault
        inner = getattr(fault, "exc", None)
        fault = inner if isinstance(inner, BaseException) else fault.__cause__ or fault.__context__
        seen += 1
    return None


def _walk(node: Any) -> Iterator[Any]:
    for child in node.childNodes:
        if child.nodeType == child.ELEMENT_NODE:
            yield child
            yield from _walk(child)


def _encode(node: Any, root: Any) -> dict[str, Any]:
    place, calls = node.getUserData(_KEY) or (None, ())
    found = {
        "tag": node.tagName,
        "attributes": dict(node.attributes.items()),
        "place": place,
        "calls": calls,
    }
    if node.parentNode is root and node.tagName not in ("link", "joint", "material"):
        for name, value in root.attributes.items():
            if name.startswith("xmlns:") and not node.hasAttribute(name):
                prefix = name.removeprefix("xmlns:") + ":"
                if any(
                    n.startswith(prefix)
                    for element in (node, *_walk(node))
                    for n in (element.tagName, *element.attributes.keys())
                ):
                    node.setAttribute(name, value)
        return found | {"xml": node.toxml()}
    texts = [
        c.data
        for c in node.childNodes
        if c.nodeType in (c.TEXT_NODE, c.CDATA_SECTION_NODE) and c.data.strip()
    ]
    children = [_encode(c, root) for c in node.childNodes if c.nodeType == c.ELEMENT_NODE]
    return found | {"children": children, "text": " ".join(texts).strip()}


def _limit() -> None:
    """Limits that hold whatever the file does; where the system has none, the caller's clock."""
    try:
        import resource
    except ImportError:
        return
    for name, value in (
        ("RLIMIT_AS", MEMORY_BYTES),
        ("RLIMIT_FSIZE", 0),  # no file can be written
        ("RLIMIT_CORE", 0),
        ("RLIMIT_NOFILE", 128),
    ):
        try:
            resource.setrlimit(getattr(resource, name), (value, value))
        except (AttributeError, ValueError, OSError):
            continue


def _limit_cpu() -> None:
    """``CPU_SECONDS`` more from now on."""
    try:
        import resource

        used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
        hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
        resource.setrlimit(resource.RLIMIT_CPU, (int(used) + CPU_SECONDS, hard))
    except (ImportError, ValueError, OSError):
        return


def main() -> None:
    """One JSON request on stdin, one line of JSON per entry on stdout."""
    answers = os.fdopen(os.dup(1), "wb")
    # What a file prints must not mix with the answers.
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    request = json.load(sys.stdin.buffer)
    sys.path.extend(p for p in request["path"] if p not in sys.path)
    import xacro

    _limit()
    for entry in request["entries"]:
        _limit_cpu()
        os.chdir(os.path.dirname(entry["file"]))
        answer = Expansion(xacro, entry).answer()
        try:
            line = json.dumps(answer, allow_nan=False)
        except (RecursionError, MemoryError, ValueError):
            fault = {"kind": "limit", "text": "the expanded file is nested too deeply"}
            line = json.dumps({"fault": fault, "files": [], "trail": []})
        answers.write(line.encode() + b"\n")
        answers.flush()


if __name__ == "__main__":
    main()
