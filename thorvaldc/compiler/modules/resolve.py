"""Resolves a robot document to a tree of module instances.

A robot document and an assembly document both list modules with names.  Each module of a robot has
a module type and is mounted on a port of another module.  The leaves of the tree of module
instances are modules with links, joints or devices.  The resolver finds the link and the pose where
each leaf module is mounted.
"""

from __future__ import annotations

from collections.abc import Iterable

from thorvaldc.compiler.modules.library import Library, ModuleType
from thorvaldc.compiler.modules.module_parameters import NONE, ModuleChoice, Scope, hint_of_known
from thorvaldc.compiler.modules.module_tree import Instance, References, used_by
from thorvaldc.compiler.modules.mounting import Mounting
from thorvaldc.compiler.source.node import Node, removal
from thorvaldc.compiler.values.value_reader import INVALID, entries
from thorvaldc.diagnostics import Report, Span

MAX_DEPTH = 12  # Greatest depth of nested assemblies.
MAX_MODULES = 5000  # Greatest number of modules in a robot.


class Resolver:
    """Builds the tree of module instances of one robot document."""

    def __init__(self, library: Library, report: Report) -> None:
        self.library = library
        self.report = report
        self.references = References(report)
        self._mounting = Mounting(self.references, report)
        self._defaults: dict[str, dict[str, Node]] = {}
        self._used_defaults: set[tuple[str, str]] = set()
        self._module_count = 0

    def resolve(self, document: Node, invalid_modules: Iterable[str] = ()) -> Instance:
        """Returns the root of the tree of module instances.

        A module with an invalid `mount` entry is not mounted on another module.

        ``invalid_modules``: names of the modules that were removed from the document because of
        invalid values.  The schema check has already reported the invalid values.
        """
        scope = Scope(None, {}, self.library, self.report, None)
        robot = Instance("", None, scope, document, document.span, None)
        robot.failed.update(invalid_modules)
        for category, node in entries(document.get("defaults")).items():
            self._defaults[category] = entries(node)
        for name, entry in entries(document.get("modules")).items():
            with used_by(self.report, name, entry.where, scope):
                self._add_part(robot, name, entry, entry.where, ())
        self._check_defaults(robot)
        self._mounting.root_of(robot, document.get("modules") or document)
        self._mounting.mount_parts(robot)
        self._check_devices(robot)
        self._mounting.check_no_cycle(robot)
        self._mounting.check_places(robot)
        self._mounting.check_sides(robot)
        return robot

    def expand(self, parent: Instance, name: str, entry: Node) -> None:
        """Adds a module to ``parent``, including all modules of an assembly.

        ``name``: name of the module in the document.  ``entry``: entry of the section `modules`
        that defines the module.
        """
        self._add_part(parent, name, entry, entry.where, ())
        part = parent.children.get(name)
        if part is not None and not part.is_leaf:
            self._mounting.root_of(part, entry)
            self._mounting.mount_parts(part)
            self._check_devices(part)

    # -- expansion ------------------------------------------------------------------

    def _add_part(
        self, parent: Instance, name: str, entry: Node, span: Span, types: tuple[str, ...]
    ) -> None:
        """Adds the module that an entry of the section `modules` defines.

        ``types``: names of the module types of the assemblies that contain the module.
        """
        if not parent.scope.boolean(entry.get("when"), True):
            parent.left_out.add(name)
            return
        type_node = entry.get("type")
        value = parent.scope.value(type_node) if type_node is not None else INVALID
        if value is None or value == NONE:
            parent.left_out.add(name)
            return
        module: ModuleType | None = None
        chosen_arguments: dict[str, tuple[Node, Scope]] = {}
        if isinstance(value, ModuleChoice):
            module = value.module
            chosen_arguments = {k: (node, value.written_in) for k, node in value.params.items()}
        elif value is not INVALID and type_node is not None:
            module = self.library.load(str(value), type_node, self.report)
        if (
            module is None
            or type_node is None
            or not self._is_within_limits(module, type_node, span, types)
        ):
            parent.failed.add(name)
            return
        arguments = self._arguments(parent, entry, module, chosen_arguments)
        scope = Scope(module, arguments, self.library, self.report, entry)
        path = f"{parent.path}.{name}" if parent.path else name
        with used_by(self.report, path, span, scope):
            scope.check_arguments()
            scope.parameter_values()
        instance = Instance(path, module, scope, entry, span, parent, entry.get("can"))
        parent.children[name] = instance
        for child, child_entry in module.section("modules").items():
            self._add_part(instance, child, child_entry, span, (*types, module.name))
        if module.is_assembly:
            self._pass_can_on(instance)

    def _is_within_limits(
        self, module: ModuleType, type_node: Node, span: Span, types: tuple[str, ...]
    ) -> bool:
        """Checks the depth of nested assemblies and the number of modules.

        Without a limit of the depth, the expansion of an assembly that contains itself would never
        end.
        """
        if module.name in types or len(types) >= MAX_DEPTH:
            problem = f"assemblies are nested more than {MAX_DEPTH} deep"
            if module.name in types:
                problem = f"`{module.name}` contains itself"
            chain = " -> ".join([*types, module.name])
            self.report.add("assembly-recursive", f"{problem}: {chain}", type_node.span)
            return False
        self._module_count += 1
        if self._module_count > MAX_MODULES:
            self.report.add(
                "too-many-parts",
                f"the robot has more than {MAX_MODULES} modules; no more are read",
                span,
            )
            return False
        return True

    def _arguments(
        self,
        parent: Instance,
        entry: Node,
        module: ModuleType,
        chosen_arguments: dict[str, tuple[Node, Scope]],
    ) -> dict[str, tuple[Node, Scope]]:
        """Returns the parameter values of a module, each with the names that expressions may use.

        Sources of the parameter values, by priority:

        - The first priority is the value of a `module` parameter that chooses the module.
        - The second priority is the section `params` of the entry.
        - The third priority is the section `defaults` of the robot document.  The section applies
          only to modules that are not in an assembly.
        - The last priority is the section `suggests` of the port that the module is mounted on.
        """
        arguments = {k: (node, parent.scope) for k, node in entries(entry.get("params")).items()}
        arguments.update(chosen_arguments)
        if not parent.path:
            for key, node in self._defaults.get(module.category, {}).items():
                if key in module.section("params"):
                    self._used_defaults.add((module.category, key))
                    arguments.setdefault(key, (node, parent.scope))
        for key, node in self._suggestions(parent, entry).items():
            if key in module.section("params"):
                arguments.setdefault(key, (node, parent.scope))
        return arguments

    def _suggestions(self, parent: Instance, entry: Node) -> dict[str, Node]:
        """Returns the parameter values that a port suggests for the module mounted on the port.

        The carrying module is searched in the document, because the instance of the carrying module
        may not exist yet.
        """
        mount = entry.get("mount")
        port = mount.get("port") if mount is not None and isinstance(mount.value, dict) else mount
        if port is None or not isinstance(port.value, str) or port.value.count(".") != 1:
            return {}
        carrier, port_name = port.value.split(".")
        document = parent.type.document if parent.type is not None else parent.entry
        carrier_entry = entries(document.get("modules")).get(carrier)
        type_node = carrier_entry.get("type") if carrier_entry is not None else None
        if type_node is None or not isinstance(type_node.value, str):
            return {}
        module = self.library.load(type_node.value, type_node, self.report)
        port_section = module.section("ports").get(port_name) if module is not None else None
        return entries(port_section.get("suggests")) if port_section is not None else {}

    def _pass_can_on(self, assembly: Instance) -> None:
        """Passes the `can` section of an assembly to the CAN device in the assembly.

        The key `can` in the document of the assembly names the module of the CAN device.
        """
        if assembly.type is None or assembly.can is None:
            return
        part_node = assembly.type.document.get("can")
        name = str(part_node.value) if part_node is not None else ""
        child = assembly.children.get(name)
        if child is None and name in assembly.failed:
            return
        if child is None:
            self.report.add(
                "can-without-device",
                f"`{assembly.path}` has no controller that could take this address",
                assembly.can.where,
                hint=removal("leave `can` out, or choose a controller", assembly.entry, "can"),
            )
            return
        child.can = assembly.can
        if not child.is_leaf:
            self._pass_can_on(child)

    def _check_defaults(self, robot: Instance) -> None:
        """Reports each default parameter in the section `defaults` that applies to no module of the
        robot.
        """
        types = [c.type for c in robot.children.values() if c.type is not None]
        categories = [module.category for module in types]
        for category, params in self._defaults.items():
            for key, node in params.items():
                if (category, key) in self._used_defaults:
                    continue
                if category in categories:
                    known = [
                        p for t in types if t.category == category for p in t.section("params")
                    ]
                    self.report.add(
                        "param-unknown",
                        f"no `{category}` module of this robot has a parameter `{key}`",
                        node.where,
                        hint=hint_of_known(key, list(dict.fromkeys(known))),
                    )
                else:
                    self.report.add(
                        "default-unused",
                        f"this robot has no module of the category `{category}`",
                        node.where,
                        hint=hint_of_known(category, list(dict.fromkeys(categories))),
                    )

    def _check_devices(self, inside: Instance) -> None:
        """Checks the sections `can` and `channels` of the modules.

        Only a CAN device may have the sections `can` and `channels`.  Each channel of a CAN device
        must name an existing motor.
        """
        for leaf in inside.leaves():
            if leaf.type is None:
                continue
            channels = leaf.entry.get("channels")
            if leaf.type.document.get("can") is None:
                for key, node in (("can", leaf.can), ("channels", channels)):
                    if node is not None:
                        self.report.add(
                            "can-without-device",
                            f"`{leaf.path}` is not a device on a bus",
                            node.where,
                            hint=removal(f"leave `{key}` out", leaf.entry, key),
                        )
                continue
            assembly = leaf.parent or leaf
            for node in leaf.wiring.values():
                reference = assembly.scope.text(node)
                if reference:
                    self.references.find_motor(assembly, reference, node)
