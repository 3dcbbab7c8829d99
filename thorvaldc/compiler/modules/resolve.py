"""From the robot's document to a tree of module instances with their connections.

An assembly and the robot are the same thing here: named parts, each of a type,
mounted on one another's ports.  What comes out are the leaves (modules with
hardware of their own), each with the leaf, link and pose that it is mounted on.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from thorvaldc.compiler.library import Library, ModuleType
from thorvaldc.compiler.modules.scope import FAULT, NONE, ModuleChoice, Scope, nearest
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model.spatial import Pose

MAX_DEPTH = 12
MAX_MODULES = 5000


@dataclass(eq=False)
class Instance:
    """A module in its place.  ``path`` is dotted, ``fl.steering``; the robot's is empty.

    ``span`` is the span of the robot file's own entry that it came from.
    ``left_out`` names the parts that were chosen to be ``none``, ``failed`` those
    with a fault that is reported.
    """

    path: str
    type: ModuleType | None
    scope: Scope
    entry: Node
    span: Span
    parent: Instance | None
    can: Node | None = None
    children: dict[str, Instance] = field(default_factory=dict)
    left_out: set[str] = field(default_factory=set)
    failed: set[str] = field(default_factory=set)
    mount: Mount | None = None

    @property
    def is_leaf(self) -> bool:
        return self.type is not None and not self.type.is_assembly

    @property
    def is_mechanical(self) -> bool:
        """Whether it has a body; one whose mount is optional has none unless mounted."""
        if self.type is not None and self.is_leaf:
            mount = self.type.document.get("mount")
            optional = mount is not None and mount.get("optional") is not None
            if optional and self.entry.get("mount") is None:
                return False
            return bool(self.type.section("links"))
        return any(child.is_mechanical for child in self.children.values())

    @property
    def is_whole(self) -> bool:
        """Whether all of its parts could be made."""
        return not self.failed and all(child.is_whole for child in self.children.values())

    def leaves(self) -> Iterator[Instance]:
        """The leaves in model order: file order, depth first."""
        if self.is_leaf:
            yield self
        for child in self.children.values():
            yield from child.leaves()


class Mount(NamedTuple):
    """``leaf`` and its ``link`` that carry a part; ``pose`` of the mount in that link."""

    leaf: Instance
    link: str
    pose: Pose
    span: Span


class Resolver:
    """Builds the instance tree of one robot document."""

    def __init__(self, library: Library, report: Report) -> None:
        self.library = library
        self.report = report
        self._defaults: dict[str, dict[str, Node]] = {}
        self._used_defaults: set[tuple[str, str]] = set()
        self._count = 0

    def resolve(self, document: Node, lost: Iterable[str] = ()) -> Instance:
        """The robot as an instance, with its parts mounted as far as they can be.

        ``lost`` names modules of the file that are at fault already and not in
        ``document``.
        """
        scope = Scope(None, {}, self.library, self.report, None)
        robot = Instance("", None, scope, document, document.span, None)
        robot.failed.update(lost)
        defaults = document.get("defaults")
        for category, node in _entries(defaults).items():
            self._defaults[category] = _entries(node)
        for name, entry in _entries(document.get("modules")).items():
            with self.report.used_by(used_by(name, entry.where)):
                self._expand(robot, name, entry, entry.where, ())
        self._check_defaults(robot)
        self._root_part(robot, document.get("modules") or document)
        self._mount_parts(robot)
        self._check_devices(robot)
        self._check_reached(robot)
        return robot

    # -- expansion ------------------------------------------------------------------

    def expand(self, parent: Instance, name: str, entry: Node) -> None:
        """Make a part of ``parent`` out of its entry, with all that it is made of."""
        self._expand(parent, name, entry, entry.where, ())
        part = parent.children.get(name)
        if part is not None and not part.is_leaf:
            self._root_part(part, entry)
            self._mount_parts(part)
            self._check_devices(part)

    def _expand(
        self, parent: Instance, name: str, entry: Node, span: Span, chain: tuple[str, ...]
    ) -> None:
        report, scope = self.report, parent.scope
        if not scope.boolean(entry.get("when"), True):
            parent.left_out.add(name)
            return
        type_node = entry.get("type")
        if type_node is None:
            parent.failed.add(name)
            return
        value = scope.read(type_node)
        given: dict[str, tuple[Node, Scope]] = {}
        if isinstance(value, ModuleChoice):
            module: ModuleType | None = value.module
            given = {k: (node, value.written_in) for k, node in value.params.items()}
        elif value is None or value == NONE:
            parent.left_out.add(name)
            return
        elif value is FAULT:
            module = None
        else:
            module = self.library.load(str(value), type_node, report)
        if module is None:
            parent.failed.add(name)
            return
        path = f"{parent.path}.{name}" if parent.path else name
        if module.name in chain or len(chain) >= MAX_DEPTH:
            if module.name in chain:
                fault = f"`{module.name}` contains itself"
            else:
                fault = f"assemblies are nested more than {MAX_DEPTH} deep"
            report.add(
                "assembly-recursive",
                f"{fault}: " + " -> ".join([*chain, module.name]),
                type_node.span,
            )
            parent.failed.add(name)
            return
        self._count += 1
        if self._count > MAX_MODULES:
            report.add(
                "too-many-parts",
                f"the robot has more than {MAX_MODULES} modules; no more are read",
                span,
            )
            parent.failed.add(name)
            return
        # An assembly's own word about a part comes before what the chosen module was given.
        params = _entries(entry.get("params"))
        given = {**{k: (node, scope) for k, node in params.items()}, **given}
        if not parent.path:
            for key, node in self._defaults.get(module.category, {}).items():
                if key in module.section("params"):
                    self._used_defaults.add((module.category, key))
                    given.setdefault(key, (node, scope))
        for key, node in self._suggested(parent, entry).items():
            if key in module.section("params"):
                given.setdefault(key, (node, parent.scope))
        inner = Scope(module, given, self.library, report, entry)
        inner.check_given()
        inner.evaluate_all()
        instance = Instance(path, module, inner, entry, span, parent, entry.get("can"))
        parent.children[name] = instance
        for child, child_entry in module.section("modules").items():
            self._expand(instance, child, child_entry, span, (*chain, module.name))
        if module.is_assembly:
            self._pass_can_on(instance)

    def _suggested(self, parent: Instance, entry: Node) -> dict[str, Node]:
        """What the port that an entry is mounted on suggests for its parameters.

        The holder may stand later in the file, so it is looked up in the document.
        """
        mount = entry.get("mount")
        port = mount.get("port") if mount is not None and isinstance(mount.value, dict) else mount
        if port is None or not isinstance(port.value, str) or port.value.count(".") != 1:
            return {}
        holder, name = port.value.split(".")
        document = parent.type.document if parent.type is not None else parent.entry
        found = _entries(document.get("modules")).get(holder)
        type_node = found.get("type") if found is not None else None
        if type_node is None or not isinstance(type_node.value, str):
            return {}
        module = self.library.load(type_node.value, type_node, self.report)
        socket = module.section("ports").get(name) if module is not None else None
        return _entries(socket.get("suggests")) if socket is not None else {}

    def _pass_can_on(self, assembly: Instance) -> None:
        """The assembly's `can` belongs to the part that its type names."""
        if assembly.type is None:
            return
        taker = assembly.type.document.get("can")
        name = str(taker.value) if taker is not None else ""
        if assembly.can is None:
            return
        child = assembly.children.get(name)
        if child is None and name in assembly.failed:
            return
        if child is None:
            self.report.add(
                "can-without-device",
                f"`{assembly.path}` has no controller that could take this address",
                assembly.can.where,
                hint="leave `can` out, or choose a controller",
            )
            return
        child.can = assembly.can
        if not child.is_leaf:
            self._pass_can_on(child)

    def _check_defaults(self, robot: Instance) -> None:
        categories = [c.type.category for c in robot.children.values() if c.type is not None]
        for category, params in self._defaults.items():
            for key, node in params.items():
                if (category, key) in self._used_defaults:
                    continue
                if category in categories:
                    known = [
                        p
                        for c in robot.children.values()
                        if c.type is not None and c.type.category == category
                        for p in c.type.section("params")
                    ]
                    self.report.add(
                        "param-unknown",
                        f"no `{category}` module of this robot has a parameter `{key}`",
                        node.where,
                        hint=nearest(key, list(dict.fromkeys(known))),
                    )
                else:
                    self.report.add(
                        "default-unused",
                        f"this robot has no module of the category `{category}`",
                        node.where,
                        hint=nearest(category, list(dict.fromkeys(categories))),
                    )

    # -- references -----------------------------------------------------------------

    def find(
        self, inside: Instance, reference: str, node: Node, *, optional: bool = False
    ) -> tuple[Instance, list[str]] | None:
        """The part that a dotted reference leads to, and what of it is left over.

        ``None`` where there is no such part; that is reported, but for one that was
        left out where the reference is ``optional``.
        """
        parts = reference.split(".")
        current = inside
        while parts and parts[0] in current.children:
            current = current.children[parts.pop(0)]
        if current is inside:
            where = f" in `{inside.path}`" if inside.path else ""
            if parts[0] in inside.left_out:
                if not optional:
                    self.report.add(
                        "module-unknown",
                        f"`{parts[0]}` is left out{where}",
                        node.span,
                        hint=f"leave out what needs it too, or choose a module for `{parts[0]}`",
                    )
            elif parts[0] not in inside.failed:
                self.report.add(
                    "module-unknown",
                    f"there is no module `{parts[0]}`{where}",
                    node.span,
                    hint=nearest(parts[0], list(inside.children)),
                )
            return None
        return current, parts

    def find_port(
        self, inside: Instance, reference: str, node: Node
    ) -> tuple[Instance, str] | None:
        """The leaf and the name of its port."""
        return self._find_offered(inside, reference, node, "ports", "port")

    def find_motor(
        self, inside: Instance, reference: str, node: Node
    ) -> tuple[Instance, str] | None:
        """The leaf and the name of its motor."""
        return self._find_offered(inside, reference, node, "motors", "motor")

    def _find_offered(
        self, inside: Instance, reference: str, node: Node, section: str, word: str
    ) -> tuple[Instance, str] | None:
        found = self.find(inside, reference, node, optional=section == "motors")
        if found is None:
            return None
        part, rest = found
        if not rest and part.parent is not None and part.parent is not inside:
            # A part may have the name of what its assembly offers: `fl.steering` is a motor.
            name = reference.rpartition(".")[2]
            if part.parent.type is not None and name in part.parent.type.section(section):
                part, rest = part.parent, [name]
        offered = part.type.section(section) if part.type is not None else {}
        if len(rest) != 1:
            if not rest:
                first = next(iter(offered), None)
                message = f"`{reference}` is a module, not a {word}"
                hint = f"name its {word}: `{reference}.{first}`" if first else "it has none"
            elif rest[0] in offered:
                message = f"`{part.path}.{rest[0]}` is a {word}; nothing can follow it"
                hint = f"write `{reference.removesuffix('.' + '.'.join(rest[1:]))}`"
            else:
                message = f"`{part.path}` has no part `{rest[0]}`"
                hint = nearest(rest[0], [*part.children, *offered])
            self.report.add(f"{word}-unknown", message, node.span, hint=hint)
            return None
        name = rest[0]
        if name not in offered:
            self.report.add(
                f"{word}-unknown",
                f"`{part.path}` ({part.type.name if part.type else ''}) has no {word} `{name}`",
                node.span,
                hint=nearest(name, list(offered)),
            )
            return None
        if part.is_leaf:
            if not part.scope.boolean(offered[name].get("when"), True):
                self.report.add(
                    f"{word}-unknown",
                    f"`{part.path}` has no {word} `{name}` with these parameters",
                    node.span,
                )
                return None
            return part, name
        return self._find_offered(part, str(offered[name].value), offered[name], section, word)

    def _check_devices(self, inside: Instance) -> None:
        """Addresses and channels are a device's, and channels lead to motors."""
        for leaf in inside.leaves():
            if leaf.type is None:
                continue
            channels = leaf.entry.get("channels")
            if leaf.type.document.get("can") is None:
                for key, node in (("can", leaf.can), ("channels", channels)):
                    if node is not None:
                        self.report.add(
                            "can-without-device",
                            f"`{leaf.path}` is no device on a bus",
                            node.where,
                            hint=f"leave `{key}` out",
                        )
                continue
            written_in = leaf.parent or leaf
            for node in _entries(channels).values():
                reference = written_in.scope.text(node)
                if reference:
                    self.find_motor(written_in, reference, node)

    # -- mounts -----------------------------------------------------------------------

    def _root_part(self, assembly: Instance, where: Node) -> Instance | None:
        """The part of an assembly that is mounted on nothing within it."""
        roots = [
            c for c in assembly.children.values() if c.is_mechanical and not c.entry.get("mount")
        ]
        if len(roots) == 1:
            root = roots[0]
            return root if root.is_leaf else self._root_part(root, root.entry)
        name = f"`{assembly.path}`" if assembly.path else "the robot"
        if not roots:
            if not assembly.is_whole:
                return None  # one of those may be the root
            self.report.add(
                "root-missing",
                f"{name} has no root: every module is mounted on another, or there is none",
                where.where if assembly.path else where.span,
                hint="the part that carries the others has no `mount`"
                if assembly.path
                else "the frame has no `mount`",
            )
        else:
            first, second = roots[0], roots[1]
            self.report.add(
                "root-ambiguous",
                f"{name} has two modules without `mount`: "
                f"`{_last(first.path)}` and `{_last(second.path)}`",
                second.entry.where,
                labels=[Label(first.entry.where, "the first one")],
                hint=f"mount it: `mount: {_last(first.path)}.<port>`",
            )
        return None

    def _mount_parts(self, assembly: Instance) -> None:
        for child in assembly.children.values():
            if not child.is_leaf:
                self._mount_parts(child)
            node = child.entry.get("mount")
            if node is None:
                continue
            if not child.is_mechanical and child.is_whole:
                self.report.add(
                    "mount-without-hardware",
                    f"`{child.path}` has no body that could be mounted",
                    node.where,
                    hint="leave `mount` out",
                )
                continue
            plug = child if child.is_leaf else self._root_part(child, child.entry)
            if plug is not None:
                plug.mount = self._mount(assembly, plug, node)

    def _mount(self, inside: Instance, plug: Instance, node: Node) -> Mount | None:
        scope = inside.scope
        if isinstance(node.value, dict):
            pose = scope.pose(node)
            parent, port = node.get("parent"), node.get("port")
        else:
            pose, parent, port = Pose(), None, node
        if parent is not None:
            return self._free_mount(inside, plug, parent, pose)
        if port is None:
            return None
        reference = scope.text(port)
        found = self.find_port(inside, reference, port) if reference else None
        if found is None:
            return None
        leaf, name = found
        if leaf.type is None:
            return None
        socket = leaf.type.section("ports")[name]
        kind = leaf.scope.text(socket.get("kind"))
        self._check_kind(plug, kind, reference, port, socket)
        link = leaf.scope.text(socket.get("link"))
        return Mount(leaf, link, leaf.scope.pose(socket) * pose, port.span)

    def _free_mount(
        self, inside: Instance, plug: Instance, parent: Node, pose: Pose
    ) -> Mount | None:
        reference = inside.scope.text(parent)
        found = self.find(inside, reference, parent) if reference else None
        if found is None:
            return None
        part, rest = found
        if rest:
            self.report.add(
                "module-unknown",
                f"`{part.path}` has no part `{rest[0]}`",
                parent.span,
                hint=nearest(rest[0], list(part.children)),
            )
            return None
        leaf = part if part.is_leaf else self._root_part(part, part.entry)
        if leaf is None or leaf.type is None:
            return None
        free = leaf.type.document.get("free_mount")
        if free is None:
            self.report.add(
                "mount-not-free",
                f"`{part.path}` ({leaf.type.name}) offers no free mounting",
                parent.span,
                hint="mount on one of its ports: "
                + ", ".join(f"`{reference}.{p}`" for p in part.type.section("ports"))
                if part.type is not None and part.type.section("ports")
                else "it has no ports either",
            )
            return None
        self._check_kind(plug, leaf.scope.text(free.get("kind")), reference, parent, free)
        return Mount(
            leaf, leaf.scope.text(free.get("link")), leaf.scope.pose(free) * pose, parent.span
        )

    def _check_kind(
        self, plug: Instance, kind: str, reference: str, node: Node, socket: Node
    ) -> None:
        if plug.type is None or not kind:
            return
        own = plug.type.document.get("mount")
        kinds = own.get("kinds") if own is not None else None
        fits = [str(k) for k in kinds.plain()] if kinds is not None else []
        if kind in fits:
            return
        wanted = " or ".join(f"`{k}`" for k in fits) if fits else "no port at all"
        self.report.add(
            "port-kind",
            f"`{reference}` is a `{kind}`; `{plug.path}` ({plug.type.name}) fits {wanted}",
            node.span,
            labels=[Label(socket.where, f"`{kind}` is declared here")],
        )

    def _check_reached(self, robot: Instance) -> None:
        """Modules that hang on one another; one with a mount at fault holds up nothing."""
        hangs: dict[int, bool] = {}  # by leaf: whether its way up ends somewhere
        for leaf in robot.leaves():
            way = [leaf]
            while id(way[-1]) not in hangs and (mount := way[-1].mount) is not None:
                hangs[id(way[-1])] = False  # so that a circle ends
                way.append(mount.leaf)
            ends = hangs.get(id(way[-1]), True)
            hangs.update((id(part), ends) for part in way)
        round_and_round = [leaf for leaf in robot.leaves() if not hangs[id(leaf)]]
        if round_and_round:
            leaf = round_and_round[0]
            self.report.add(
                "mount-cycle",
                "these modules are mounted on one another and not on the frame: "
                + ", ".join(f"`{w.path}`" for w in round_and_round),
                leaf.mount.span if leaf.mount is not None else leaf.span,
            )


def _entries(node: Node | None) -> dict[str, Node]:
    return node.value if node is not None and isinstance(node.value, dict) else {}


def used_by(path: str, span: Span) -> Label:
    """What a fault in a module's document says of the robot's module that uses it."""
    return Label(span, f"`{path.split('.', 1)[0]}` uses it")


def _last(path: str) -> str:
    return path.rsplit(".", 1)[-1]


def flat(path: str) -> str:
    """The module's path as it begins the names of its links and joints."""
    return path.replace(".", "_")
