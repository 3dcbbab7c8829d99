"""A small double of ``launch`` and ``launch_ros``, which no package registry contains.

The classes have the names and the keyword arguments of the real ones in Jazzy and Kilted; every
other argument is an error. ``run`` executes a launch file and returns the nodes and processes that
it would start, with all substitutions resolved.

The double also refuses what the started program would refuse: names that are no names of ROS, of
nodes, name spaces, remapped topics, topics in parameters, and of the controllers and the controller
manager of a spawner.
"""

from __future__ import annotations

import abc
import argparse
import re
import runpy
import sys
import tempfile
import types
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

TOPIC_NAME = re.compile(r"(~/|/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
NODE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
TRUTH = {"true": True, "1": True, "false": False, "0": False}


class LaunchError(Exception):
    """The real launch system would stop with an error."""


@dataclass
class Context:
    """State of a launch: its arguments, what it starts, and the folders of installed packages."""

    shares: Mapping[str, Path]
    configurations: dict[str, str] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    started: list[Started] = field(default_factory=list)
    declared: dict[str, str] = field(default_factory=dict)
    included: list[Included] = field(default_factory=list)
    parameters: dict[str, Any] = field(default_factory=dict)

    def text(self, value: Any) -> str:
        """Resolve a substitution, a text, or a list of these."""
        if isinstance(value, str):
            return value
        if isinstance(value, Substitution):
            return value.perform(self)
        if isinstance(value, Path):
            return str(value)
        if isinstance(value, Iterable):
            return "".join(self.text(item) for item in value)
        raise LaunchError(f"expected a text or a substitution, got {value!r}")

    def space(self, value: Any) -> str:
        """Resolve the name space of a node in that of its group; it begins with a slash."""
        text = self.text(value)
        if not text.startswith("/"):
            text = f"{self.configurations.get('ros_namespace', '').rstrip('/')}/{text}"
        if not re.fullmatch(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+", text := text.rstrip("/") or "/"):
            raise LaunchError(f"{text!r} is no name space of ROS")
        return text

    def name(self, value: Any, pattern: re.Pattern[str] = TOPIC_NAME) -> str:
        """Resolve the name of a topic, a node or a name space."""
        text = self.text(value)
        if not pattern.fullmatch(text):
            raise LaunchError(f"{text!r} is no name of ROS")
        return text


@dataclass
class Included:
    """A launch file that another one has included, with what it was given."""

    path: Path
    configurations: dict[str, str]
    environment: dict[str, str]


@dataclass
class Started:
    """A node or process that the launch starts; a process has an empty ``package``.

    - ``namespace``: name space without the first slash;
    - ``files``: parameter files as the node gets them, with all substitutions resolved;
    - ``sources``: the files that they were made of;
    - ``on_exit``: what the launch does when it has ended;
    - ``respawn_delay``: time in s after which it is started again, or ``None`` if it is not.
    """

    package: str
    executable: str
    name: str
    namespace: str
    parameters: dict[str, Any]
    files: list[Path]
    sources: list[Path]
    remappings: dict[str, str]
    arguments: list[str]
    on_exit: Any
    respawn_delay: float | None = None

    def status_of_launch(self, status: int) -> int | None:
        """Return the exit status of the launch that the end of the process ends, or ``None``."""
        if self.on_exit is None:
            return None
        entity = self.on_exit
        if callable(entity):
            event = types.SimpleNamespace(process_name=f"{self.name}-1", returncode=status)
            try:
                entity = entity(event, None)
            except Exception:  # as the real launch
                return 1
        return 0 if isinstance(entity, Shutdown) else None


# -- substitutions ----------------------------------------------------------------


class Substitution(abc.ABC):
    def __str__(self) -> str:
        raise LaunchError(f"{type(self).__name__} is used as a text before the launch resolves it")

    @abc.abstractmethod
    def perform(self, context: Context) -> str: ...


class LaunchConfiguration(Substitution):
    def __init__(self, variable_name: Any, *, default: Any = None) -> None:
        self.name, self.default = variable_name, default

    def perform(self, context: Context) -> str:
        if self.name in context.configurations:
            return context.configurations[self.name]
        if self.default is None:
            raise LaunchError(f"launch configuration '{self.name}' does not exist")
        return context.text(self.default)


class EqualsSubstitution(Substitution):
    def __init__(self, left: Any, right: Any) -> None:
        self.left, self.right = left, right

    def perform(self, context: Context) -> str:
        return str(context.text(self.left) == context.text(self.right)).lower()


class NotEqualsSubstitution(EqualsSubstitution):
    def perform(self, context: Context) -> str:
        return str(context.text(self.left) != context.text(self.right)).lower()


# -- conditions -------------------------------------------------------------------


class IfCondition:
    def __init__(self, predicate_expression: Any) -> None:
        self.expression = predicate_expression

    def holds(self, context: Context) -> bool:
        text = context.text(self.expression).strip().lower()
        if text not in TRUTH:
            raise LaunchError(f"condition expression evaluated to '{text}'")
        return TRUTH[text]


class UnlessCondition(IfCondition):
    def holds(self, context: Context) -> bool:
        return not super().holds(context)


# -- actions ------------------------------------------------------------------------


class Action(abc.ABC):
    def __init__(self, *, condition: IfCondition | None = None) -> None:
        self.condition = condition

    def visit(self, context: Context) -> None:
        if self.condition is None or self.condition.holds(context):
            self.execute(context)

    @abc.abstractmethod
    def execute(self, context: Context) -> None: ...


class LaunchDescription:
    def __init__(
        self, initial_entities: Iterable[Any] | None = None, *, deprecated_reason: Any = None
    ) -> None:
        self.entities = list(initial_entities or [])


class DeclareLaunchArgument(Action):
    def __init__(
        self,
        name: str,
        *,
        default_value: Any = None,
        description: str | None = None,
        choices: Iterable[str] | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(**kwargs)
        self.name, self.default = name, default_value
        self.choices = list(choices) if choices is not None else None
        if not description:
            raise LaunchError(f"the argument {name} has no description")

    def execute(self, context: Context) -> None:
        if self.name not in context.configurations:
            if self.default is None:
                raise LaunchError(f"the argument {self.name} is required")
            context.configurations[self.name] = context.text(self.default)
        value = context.configurations[self.name]
        context.declared[self.name] = value
        if self.choices is not None and value not in self.choices:
            raise LaunchError(f"argument {self.name} is {value}; choices are {self.choices}")


class PythonLaunchDescriptionSource:
    def __init__(self, launch_file_path: Any) -> None:
        self.path = launch_file_path


class IncludeLaunchDescription(Action):
    def __init__(
        self, launch_description_source: Any, *, launch_arguments: Any = None, **kwargs: Any
    ) -> None:
        super().__init__(**kwargs)
        self.source = launch_description_source
        self.arguments = list(launch_arguments or [])

    def execute(self, context: Context) -> None:
        path = Path(context.text(self.source.path))
        if not path.is_file():
            raise LaunchError(f"there is no launch file {path}")
        for name, value in self.arguments:
            context.configurations[name] = context.text(value)
        seen = Included(path, dict(context.configurations), dict(context.environment))
        context.included.append(seen)
        before = dict(context.declared)
        context.declared.clear()
        visit_file(path, context)
        unknown = [name for name, _ in self.arguments if name not in context.declared]
        if unknown:
            raise LaunchError(f"{path.name} declares no argument {', '.join(unknown)}")
        context.declared = {**before, **context.declared}


class GroupAction(Action):
    def __init__(
        self,
        actions: Iterable[Any],
        *,
        scoped: bool = True,
        forwarding: bool = True,
        launch_configurations: Mapping[str, Any] | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(**kwargs)
        self.actions, self.scoped = list(actions), scoped

    def execute(self, context: Context) -> None:
        outer, parameters = dict(context.configurations), context.parameters
        environment = dict(context.environment)
        for action in self.actions:
            action.visit(context)
        if self.scoped:
            context.configurations, context.parameters = outer, parameters
            context.environment = environment


class OpaqueFunction(Action):
    def __init__(self, *, function: Any, args: Any = None, kwargs: Any = None) -> None:
        super().__init__()
        self.function, self.args = function, list(args or [])

    def execute(self, context: Context) -> None:
        for entity in self.function(context, *self.args) or []:
            entity.visit(context)


class SetLaunchConfiguration(Action):
    def __init__(self, name: Any, value: Any, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.name, self.value = name, value

    def execute(self, context: Context) -> None:
        context.configurations[context.text(self.name)] = context.text(self.value)


class Shutdown(Action):
    """Ends the launch."""

    def __init__(self, *, reason: str = "reason not given", **kwargs: Any) -> None:
        super().__init__(**kwargs)

    def execute(self, context: Context) -> None:
        raise LaunchError("the launch ends at its start")


class PushRosNamespace(Action):
    """Puts the nodes that start later in the group into a name space."""

    def __init__(self, namespace: Any, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.namespace = namespace

    def execute(self, context: Context) -> None:
        context.configurations["ros_namespace"] = context.space(self.namespace)


class SetParameter(Action):
    """Sets a parameter of all nodes that start later in the group."""

    def __init__(self, name: Any, value: Any, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.name, self.value = name, value

    def execute(self, context: Context) -> None:
        name = context.text(self.name)
        context.parameters = {**context.parameters, name: yaml.safe_load(context.text(self.value))}


class AppendEnvironmentVariable(Action):
    def __init__(
        self,
        name: Any,
        value: Any,
        prepend: Any = False,
        separator: Any = ":",
        **kwargs: Any,
    ) -> None:
        super().__init__(**kwargs)
        self.name, self.value, self.separator = name, value, separator

    def execute(self, context: Context) -> None:
        old = context.environment.get(self.name, "")
        new = context.text(self.value)
        context.environment[self.name] = f"{old}{self.separator}{new}" if old else new


class _Process(Action):
    def __init__(
        self,
        *,
        arguments: Iterable[Any] = (),
        condition: IfCondition | None = None,
        output: str = "log",
        respawn: bool = False,
        respawn_delay: float | None = None,
        on_exit: Any = None,
        additional_env: Any = None,
    ) -> None:
        super().__init__(condition=condition)
        if output not in ("log", "screen", "both", "own_log", "full"):
            raise LaunchError(f"{output} is no output")
        self.arguments, self.on_exit = list(arguments), on_exit
        self.respawn_delay = (respawn_delay or 0.0) if respawn else None


class Node(_Process):
    def __init__(
        self,
        *,
        executable: Any,
        package: Any = None,
        name: Any = None,
        namespace: Any = None,
        exec_name: Any = None,
        parameters: Iterable[Any] | None = None,
        remappings: Iterable[tuple[Any, Any]] | None = None,
        ros_arguments: Iterable[Any] | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(**kwargs)
        self.package, self.executable, self.name = package, executable, name
        self.namespace = namespace
        self.parameters, self.remappings = list(parameters or []), list(remappings or [])

    def execute(self, context: Context) -> None:
        files: list[Path] = []
        sources: list[Path] = []
        parameters = dict(context.parameters)
        for given in self.parameters:
            if isinstance(given, Mapping):
                parameters.update({key: _value(value, context) for key, value in given.items()})
                continue
            file = given if isinstance(given, ParameterFile) else ParameterFile(given)
            sources.append(file.path(context))
            files.append(file.evaluate(context))
        context.started.append(
            Started(
                context.name(self.package, NODE_NAME),
                context.name(self.executable, NODE_NAME),
                context.name(self.name, NODE_NAME) if self.name else "",
                context.space(self.namespace or "").strip("/"),
                parameters,
                files,
                sources,
                {context.name(a): context.name(b) for a, b in self.remappings},
                [context.text(item) for item in self.arguments],
                self.on_exit,
                self.respawn_delay,
            )
        )
        for key, value in parameters.items():
            if key.endswith("_topic"):
                context.name(value)
        if context.started[-1].executable == "spawner":
            spawned_controllers(context.started[-1])


def spawned_controllers(spawner: Started) -> tuple[str, list[str]]:
    """Return the controller manager of a node `spawner`, and the controllers that it loads."""
    options = argparse.ArgumentParser(prog="spawner", exit_on_error=False)
    options.add_argument("controllers", nargs="+")
    options.add_argument("--controller-manager", "-c", default="controller_manager")
    try:
        values, unknown = options.parse_known_args(spawner.arguments)
    except (argparse.ArgumentError, SystemExit) as error:
        raise LaunchError(f"spawner cannot use the arguments {spawner.arguments}") from error
    names = [values.controller_manager, *values.controllers]
    if unknown or not all(map(TOPIC_NAME.fullmatch, names)):
        raise LaunchError(f"spawner cannot use the arguments {spawner.arguments}")
    return values.controller_manager, values.controllers


def _value(value: Any, context: Context) -> Any:
    if isinstance(value, ParameterValue):
        return value.evaluate(context)
    if isinstance(value, Substitution | list | tuple) and not isinstance(value, str):
        if isinstance(value, list | tuple) and not any(isinstance(v, Substitution) for v in value):
            return list(value)
        return yaml.safe_load(context.text(value))
    if isinstance(value, str):
        # launch_ros reads such a text as YAML too, so that "1" would become a number.
        try:
            read = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise LaunchError(f"the text {value!r} is no YAML; use ParameterValue") from error
        if read != value:
            raise LaunchError(f"the text {value!r} would become {read!r}; use ParameterValue")
    return value


class ParameterValue:
    def __init__(self, value: Any, *, value_type: type | None = None) -> None:
        self.value, self.value_type = value, value_type

    def evaluate(self, context: Context) -> Any:
        text = context.text(self.value)
        if self.value_type is str:
            return text
        value = yaml.safe_load(text)
        if type(value) is not self.value_type and self.value_type is not None:
            raise LaunchError(f"expected {self.value_type.__name__}, got {text!r}")
        return value


class ParameterFile:
    """A parameter file; with ``allow_substs``, the node gets a copy without substitutions."""

    def __init__(self, param_file: Any, *, allow_substs: bool = False) -> None:
        self.param_file, self.allow_substs = param_file, allow_substs

    def path(self, context: Context) -> Path:
        path = Path(context.text(self.param_file))
        if not path.is_file():
            raise LaunchError(f"there is no parameter file {path}")
        return path

    def evaluate(self, context: Context) -> Path:
        path = self.path(context)
        text = path.read_text(encoding="utf-8")
        if not self.allow_substs:
            if "$(" in text:
                raise LaunchError(f"{path} has substitutions that are not allowed")
            return path
        copy = Path(tempfile.mkdtemp()) / path.name
        copy.write_text(substituted(text, context), encoding="utf-8")
        return copy


def substituted(text: str, context: Context) -> str:
    """Resolve the substitutions ``$(var NAME)`` of a text; a backslash keeps what follows."""

    def value(match: re.Match[str]) -> str:
        if match["kept"] is not None:
            return match["kept"]
        kind, _, name = match["content"].partition(" ")
        if kind != "var":
            raise LaunchError(f"unknown substitution {match[0]}")
        return LaunchConfiguration(name).perform(context)

    return re.sub(r"\\(?P<kept>.)|\$\((?P<content>[^)]*)\)", value, text)


# -- running ------------------------------------------------------------------------


def visit_file(path: Path, context: Context) -> None:
    names = runpy.run_path(str(path))
    description = names["generate_launch_description"]()
    if not isinstance(description, LaunchDescription):
        raise LaunchError(f"{path.name} returns no LaunchDescription")
    for entity in description.entities:
        entity.visit(context)


@contextmanager
def _modules(context: Context) -> Iterator[None]:
    def share(package: str) -> str:
        if package not in context.shares:
            raise LaunchError(f"package '{package}' not found")
        return str(context.shares[package])

    contents: dict[str, dict[str, Any]] = {
        "launch": {"LaunchDescription": LaunchDescription},
        "launch.actions": {
            "AppendEnvironmentVariable": AppendEnvironmentVariable,
            "DeclareLaunchArgument": DeclareLaunchArgument,
            "GroupAction": GroupAction,
            "IncludeLaunchDescription": IncludeLaunchDescription,
            "OpaqueFunction": OpaqueFunction,
            "SetLaunchConfiguration": SetLaunchConfiguration,
            "Shutdown": Shutdown,
        },
        "launch.conditions": {"IfCondition": IfCondition, "UnlessCondition": UnlessCondition},
        "launch.launch_description_sources": {
            "AnyLaunchDescriptionSource": PythonLaunchDescriptionSource,  # of Python files
            "PythonLaunchDescriptionSource": PythonLaunchDescriptionSource,
        },
        "launch.substitutions": {
            "EqualsSubstitution": EqualsSubstitution,
            "LaunchConfiguration": LaunchConfiguration,
            "NotEqualsSubstitution": NotEqualsSubstitution,
        },
        "launch_ros": {},
        "launch_ros.actions": {
            "Node": Node,
            "PushRosNamespace": PushRosNamespace,
            "SetParameter": SetParameter,
        },
        "launch_ros.parameter_descriptions": {
            "ParameterFile": ParameterFile,
            "ParameterValue": ParameterValue,
        },
        "ament_index_python": {},
        "ament_index_python.packages": {"get_package_share_directory": share},
    }
    saved = {name: sys.modules.get(name) for name in contents}
    for name, members in contents.items():
        module = types.ModuleType(name)
        vars(module).update(members)
        sys.modules[name] = module
    try:
        yield
    finally:
        for name, old in saved.items():
            if old is None:
                del sys.modules[name]
            else:
                sys.modules[name] = old


def run(path: Path, shares: Mapping[str, Path], **arguments: str) -> Context:
    """Execute a launch file with command-line arguments.

    ``shares`` maps each installed package to its shared folder.
    """
    context = Context(shares, dict(arguments))
    # Beside the package, which pytest deletes: a worker process of xdist ends without `atexit`.
    previous, tempfile.tempdir = tempfile.tempdir, str(path.parents[2])
    try:
        with _modules(context):
            visit_file(path, context)
    finally:
        tempfile.tempdir = previous
    unknown = [name for name in arguments if name not in context.declared]
    if unknown:
        raise LaunchError(f"{path.name} declares no argument {', '.join(unknown)}")
    return context
