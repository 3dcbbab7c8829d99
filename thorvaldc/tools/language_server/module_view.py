"""The modules of a robot document or assembly that is open, resolved as far as it is valid."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from thorvaldc.compiler.modules.library import Library, ModuleType, module_library
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.modules.module_tree import Instance, Mount, References
from thorvaldc.compiler.modules.mounting import mount_kinds
from thorvaldc.compiler.modules.resolve import Resolver
from thorvaldc.compiler.pipeline import library_folders_of
from thorvaldc.compiler.source.node import KeyPath, Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.compiler.validation.document_check import check, without_invalid_values
from thorvaldc.compiler.values.document_section import read_pose
from thorvaldc.compiler.values.unit_file import with_design
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import Report, Span
from thorvaldc.model import Pose
from thorvaldc.schema import Kind, inlined
from thorvaldc.tools.language_server.open_document import Place, node_at, place_at

CANOPEN_IDS = (1, 127)
CANOPEN = "canopen"


@dataclass(frozen=True)
class Port:
    """A port of a module of the document.

    - ``reference``: reference in the document, such as ``frame.front_left``.
    - ``kind``: kind of the port.
    - ``pose``: pose in the frame of the link that carries the port.
    - ``link``: name of the link, as ``<module>_<link>``.
    - ``declaration``: entry of the port in the module document.
    - ``occupant``: path of the module that is mounted there, or an empty text.
    """

    reference: str
    kind: str
    pose: Pose
    link: str
    declaration: Node
    occupant: str


@dataclass(frozen=True)
class Parameter:
    """A parameter of a module type, with its declaration in the module document."""

    name: str
    module: ModuleType
    declaration: Node

    def get(self, key: str) -> object:
        """Returns a scalar of the declaration, or ``None``."""
        node = self.declaration.get(key)
        return node.value if node is not None else None

    @property
    def quantity(self) -> str:
        """Kind of quantity, or an empty text for other types."""
        if self.get("type") in (None, "quantity", "list"):
            return str(self.get("quantity") or "ratio")
        return ""


class ModuleView:
    """The library, modules, ports and parameters that a document can refer to.

    ``tree`` is the document as it is written, ``document`` that of a unit with the entries of its
    design.  ``named_folders`` are the library folders that a robot names.
    """

    def __init__(
        self, kind: Kind, path: Path, tree: Node | None, folders: tuple[Path, ...]
    ) -> None:
        self.kind = kind
        self.path = path
        self.tree = tree if tree is not None else Node({}, Span(path.name))
        self.document = self.tree
        self.named_folders: tuple[Path, ...] = ()
        if kind == "module":
            self.type_name, self.library = module_library(path, folders)
        else:
            self.type_name = ""
            files: dict[str, Path] = {}
            if self.is_unit:
                self.document = with_design(self.tree, files, path, Report()) or self.tree
            named = library_folders_of(self.document, path.parent, (), Report(), files)
            self.named_folders = tuple(folder for folder, _ in named)
            self.library = Library([(folder, str(folder)) for folder in self.named_folders])

    @property
    def is_unit(self) -> bool:
        """Whether the document is that of a unit of a design."""
        return self.kind == "robot" and self.tree.get("extends") is not None

    def place_at(self, line: int, column: int) -> Place | None:
        """Returns the innermost node at a line and column, see ``open_document.place_at``."""
        place = place_at(self.tree, line, column)
        return replace(place, path=self.full_path(place.path)) if place is not None else None

    def full_path(self, path: KeyPath) -> KeyPath:
        """Returns a path with all its keys: the first key of a unit can be a dotted path."""
        return (*str(path[0]).split("."), *path[1:]) if path and self.is_unit else path

    @cached_property
    def root(self) -> Instance:
        """The root of the tree of module instances; its children are the modules that resolve."""
        report = Report()
        check(self.document, self.kind, report)
        document = without_invalid_values(self.document, report)
        if document.value is None:
            document = Node({}, self.tree.span)
        return Resolver(self.library, Report()).resolve(document)

    @cached_property
    def scope(self) -> Scope:
        """Parameters of a module document with their defaults, for its expressions."""
        module = None
        if self.kind == "module":
            module = ModuleType(self.type_name, self.path.parent, str(self.path), self.tree)
        return Scope(module, {}, self.library, Report(), None)

    def load(self, name: object) -> ModuleType | None:
        """Returns the module type with a name, or ``None``."""
        if not isinstance(name, str) or not self.library.exists(name):
            return None
        return self.library.load(name, Node(name, self.tree.span), Report())

    # -- module types and parameters ----------------------------------------------------

    def type_of(self, path: KeyPath) -> ModuleType | None:
        """Returns the module type of the mapping at a path, which has a key ``type``.

        An expression such as ``${wheel}`` is the default value of the parameter.
        """
        mapping = node_at(self.document, path)
        type_node = mapping.get("type") if mapping is not None else None
        if mapping is not None and isinstance(mapping.value, str):
            type_node = mapping
        value = type_node.value if type_node is not None else None
        if isinstance(value, str) and value.startswith("${") and value.endswith("}"):
            declaration = node_at(self.tree, ("params", value[2:-1].strip(), "default"))
            value = declaration.value if declaration is not None else None
        return self.load(value)

    def parameter_at(self, path: KeyPath) -> Parameter | None:
        """Returns the parameter that the entry at a path sets."""
        if len(path) == 3 and path[0] == "defaults":
            for module in self._types_of(path[1]):
                if path[2] in module.section("params"):
                    return Parameter(str(path[2]), module, module.section("params")[str(path[2])])
            return None
        if len(path) < 2 or path[-2] != "params" or not isinstance(path[-1], str):
            return None
        own = self.type_of(path[:-2])
        declaration = own.section("params").get(path[-1]) if own is not None else None
        return Parameter(path[-1], own, declaration) if own and declaration is not None else None

    def parameters_at(self, path: KeyPath) -> list[Parameter]:
        """Returns the parameters that the mapping ``params`` or ``defaults`` at a path can set."""
        modules: list[ModuleType] = []
        if len(path) == 2 and path[0] == "defaults":
            modules = self._types_of(path[1])
        elif path and path[-1] == "params" and (own := self.type_of(path[:-1])) is not None:
            modules = [own]
        return [
            Parameter(name, module, declaration)
            for module in modules
            for name, declaration in module.section("params").items()
        ]

    def _types_of(self, category: object) -> list[ModuleType]:
        types = {c.type.name: c.type for c in self.root.children.values() if c.type is not None}
        return [module for module in types.values() if module.category == category]

    def categories(self) -> list[str]:
        """Returns the categories of the modules of a robot, for the section ``defaults``."""
        types = (child.type for child in self.root.children.values())
        return sorted({module.category for module in types if module is not None})

    def schemas(self, path: KeyPath) -> Schemas:
        """Returns the schemas of the value at a path."""
        schemas = [inlined(self.kind)]
        for key in path:
            schemas = [inner for schema in schemas for inner in _inner(schema, key)]
        return Schemas(branch for schema in schemas for branch in _branches(schema))

    # -- ports --------------------------------------------------------------------------

    def port(self, reference: str) -> Port | None:
        """Returns the port that a reference such as ``frame.front_left`` names, or ``None``."""
        return self._port(reference, self._occupants())

    def ports(self) -> list[Port]:
        """Returns the ports of all modules of the document."""
        occupants = self._occupants()
        references = (
            f"{name}.{port}"
            for name, child in self.root.children.items()
            if child.type is not None
            for port in child.type.section("ports")
        )
        ports = (self._port(reference, occupants) for reference in references)
        return [port for port in ports if port is not None]

    def _port(self, reference: str, occupants: Mapping[object, str]) -> Port | None:
        node = Node(reference, self.tree.span)
        leaf_and_name = References(Report()).find_port(self.root, reference, node)
        if leaf_and_name is None or leaf_and_name[0].type is None:
            return None
        leaf, name = leaf_and_name
        section = leaf.type.section("ports")[name] if leaf.type is not None else node
        pose, link = read_pose(section, leaf.scope), leaf.scope.text(section.get("link"))
        place = Mount(leaf, link, pose, section.span).place
        first = next(iter(leaf.type.section("links")), "") if leaf.type is not None else ""
        return Port(
            reference,
            leaf.scope.text(section.get("kind")),
            pose,
            f"{leaf.path.replace('.', '_')}_{link or first}",
            section,
            occupants.get(place, ""),
        )

    def _occupants(self) -> dict[object, str]:
        mounted = ((leaf, leaf.mount) for leaf in self.root.leaves())
        return {mount.place: leaf.path for leaf, mount in mounted if mount is not None}

    def fitting_kinds(self, module: str) -> list[str] | None:
        """Returns the kinds of ports that a module of the document fits, or ``None``."""
        instance = self.root.children.get(module)
        leaf = _carrier(instance) if instance is not None else None
        return mount_kinds(leaf.type) if leaf is not None else None

    def motors(self) -> list[str]:
        """Returns the references to the motors of the modules of the document."""
        return [
            f"{name}.{motor}"
            for name, child in self.root.children.items()
            if child.type is not None
            for motor in child.type.section("motors")
        ]

    # -- addresses ----------------------------------------------------------------------

    def free_ids(self, module: str) -> list[int]:
        """Returns the free ids of the CAN device in a module of the document."""
        instance = self.root.children.get(module)
        device = next(_devices(instance), None) if instance is not None else None
        if device is None or device.type is None:
            return []
        space = _id_space(device)
        address = device.can
        taken = {
            _id(leaf.can)
            for leaf in _devices(self.root)
            if _id_space(leaf) == space and leaf.can is not address
        }
        if space == CANOPEN:
            foreign = entries(self.document.get("foreign_devices")).values()
            taken |= {_id(node) for node in foreign}
        can = device.type.document.get("can")
        bounds = can.get("auto_ids") or can.get("ids") if can is not None else None
        ids = bounds.plain() if bounds is not None else CANOPEN_IDS
        low, high = (i if isinstance(i, int) else CANOPEN_IDS[k] for k, i in enumerate(ids[:2]))
        return [number for number in range(low, min(high, low + 1000) + 1) if number not in taken]


def _id(address: Node | None) -> object:
    node = address.get("id") if address is not None and isinstance(address.value, dict) else address
    return node.value if node is not None else None


def _id_space(device: Instance) -> str:
    can = device.type.document.get("can") if device.type is not None else None
    space = can.get("id_space") if can is not None else None
    return str(space.value) if space is not None else CANOPEN


def _devices(instance: Instance) -> Iterator[Instance]:
    for leaf in instance.leaves():
        can = leaf.type.document.get("can") if leaf.type is not None else None
        if can is not None and isinstance(can.value, dict):
            yield leaf


def _carrier(instance: Instance) -> Instance | None:
    """Returns the module of an assembly that is mounted on the port, or the module itself."""
    if instance.is_leaf:
        return instance
    for child in instance.children.values():
        if child.is_mechanical and child.entry.get("mount") is None:
            return _carrier(child)
    return None


# -- schemas ----------------------------------------------------------------------------

Schema = dict[str, Any]


class Schemas:
    """The parts of a JSON Schema that describe a value of a document, the most specific first."""

    def __init__(self, schemas: Iterable[Schema]) -> None:
        self.schemas = list(schemas)

    def all(self, keyword: str) -> list[Any]:
        """Returns the items of all lists or mappings under a keyword, such as ``examples``."""
        return [item for schema in self.schemas for item in schema.get(keyword, ())]

    def first(self, keyword: str) -> Any:
        """Returns the first value of a keyword that is not empty, or ``None``."""
        return next((s[keyword] for s in self.schemas if s.get(keyword) not in (None, "")), None)

    @property
    def keys(self) -> dict[str, Schema]:
        """The keys that a mapping can have, with their schemas."""
        keys: dict[str, Schema] = {}
        for schema in self.schemas:
            for key, inner in schema.get("properties", {}).items():
                if isinstance(inner, dict):
                    keys.setdefault(key, inner)
        return keys

    @property
    def values(self) -> list[Any]:
        """The values that the schemas list: enumerations, constants and words."""
        values: list[Any] = []
        for schema in self.schemas:
            listed = [*schema.get("enum", ()), *schema.get("x-words", ())]
            if "const" in schema:
                listed.append(schema["const"])
            if "boolean" in _types(schema):
                listed += [True, False]
            if schema.get("pattern") == "^auto$":
                listed.append("auto")
            values += [value for value in listed if value not in values]
        return values

    @property
    def quantities(self) -> list[str]:
        """The kinds of quantity that the value can have."""
        names: list[str] = []
        for schema in self.schemas:
            quantity = schema.get("x-quantity", [])
            listed = [quantity] if isinstance(quantity, str) else quantity
            names += [name for name in listed if name in QUANTITIES and name not in names]
        return names


def is_nested(schema: Schema) -> bool:
    """Returns whether a value can only be a mapping, or only a list."""
    return _types(schema) in (["object"], ["array"])


def _types(schema: Schema) -> list[str]:
    types = schema.get("type", [])
    return [types] if isinstance(types, str) else list(types)


def _branches(schema: Schema) -> Iterator[Schema]:
    """Yields a schema and the alternatives of which it consists."""
    yield schema
    for keyword in ("anyOf", "oneOf", "allOf"):
        for inner in schema.get(keyword, ()):
            if isinstance(inner, dict):
                yield from _branches(inner)
    for keyword in ("then", "else"):
        if isinstance(schema.get(keyword), dict):
            yield from _branches(schema[keyword])


def _inner(schema: Schema, key: str | int) -> Iterator[Schema]:
    for branch in _branches(schema):
        if isinstance(key, int):
            if isinstance(branch.get("items"), dict):
                yield branch["items"]
            continue
        properties = branch.get("properties", {})
        if key in properties:
            yield properties[key]
        elif isinstance(branch.get("additionalProperties"), dict):
            yield branch["additionalProperties"]
