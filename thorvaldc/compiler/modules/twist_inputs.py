"""Who may drive the robot: sources of twists, their priorities, and locks."""

from __future__ import annotations

from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Report
from thorvaldc.model.robot import TwistInput

# The original's two sources, and the locks of its multiplexer: a person comes before the
# navigation, and a lock stops all that is not above it.
USUAL_SOURCES = {"teleop_joy": 100, "auto_nav": 10}
USUAL_LOCKS = {"safety_stop": (255, "safety_stop/lock"), "auto_nav_pause": (50, "auto_nav/pause")}


def usual_sources(command_timeout: float) -> tuple[TwistInput, ...]:
    """Those of a robot whose file names none."""
    return tuple(
        TwistInput(name, _topic(name), priority, command_timeout)
        for name, priority in USUAL_SOURCES.items()
    )


def usual_locks() -> tuple[TwistInput, ...]:
    return tuple(
        TwistInput(name, topic, priority, 0.0) for name, (priority, topic) in USUAL_LOCKS.items()
    )


def _topic(source: str) -> str:
    return f"{source}/cmd_vel"


class TwistInputs:
    """Reads ``driver.twist_sources`` and ``driver.twist_locks`` of a robot document."""

    def __init__(self, document: Node, scope: Scope, report: Report) -> None:
        self._driver = document.get("driver")
        self._scope = scope
        self._report = report

    def sources(self, command_timeout: float) -> tuple[TwistInput, ...]:
        """The usual ones as the file changes them, then its own; each has its own priority."""
        usual = {source.name: source for source in usual_sources(command_timeout)}
        found = dict(usual)
        places: dict[str, Node] = {}
        for name, node in self._entries("twist_sources").items():
            made = TwistInput(name, _topic(name), 0, command_timeout)
            found[name] = self._read(node, usual.get(name, made), silent=False)
            places[name] = node
        self._check_priorities(found, places)
        return tuple(found.values())

    def locks(self) -> tuple[TwistInput, ...]:
        found = {lock.name: lock for lock in usual_locks()}
        for name, node in self._entries("twist_locks").items():
            made = TwistInput(name, f"{name}/lock", 0, 0.0)
            found[name] = self._read(node, found.get(name, made), silent=True)
        return tuple(found.values())

    def _entries(self, key: str) -> dict[str, Node]:
        node = self._driver.get(key) if self._driver is not None else None
        return node.value if node is not None and isinstance(node.value, dict) else {}

    def _read(self, node: Node, default: TwistInput, *, silent: bool) -> TwistInput:
        priority, topic = node.get("priority"), node.get("topic")
        # Without one the schema has said so; zero is nobody's.
        number = 0
        if priority is not None and isinstance(priority.value, int):
            number = priority.value
        timeout = self._scope.quantity(node.get("timeout"), "time", default.timeout)
        if timeout < 0.0 or (timeout == 0.0 and not silent):
            place = node.get("timeout") or node
            self._report.add(
                "size-not-positive", f"`timeout` is {timeout:g}; it must be positive", place.span
            )
        name = self._scope.text(topic) if topic is not None else default.topic
        return TwistInput(default.name, name, number, timeout)

    def _check_priorities(self, found: dict[str, TwistInput], places: dict[str, Node]) -> None:
        """Which of two equal ones drives would depend on the order in which they are listed."""
        holders: dict[int, str] = {}
        # What the file does not name has its priority for sure.
        for name in [*(n for n in found if n not in places), *places]:
            priority = found[name].priority
            first = holders.setdefault(priority, name)
            if first != name and priority > 0:
                self._report.add(
                    "twist-priority-duplicate",
                    f"`{name}` has the priority {priority}, as `{first}` has",
                    (places[name].get("priority") or places[name]).span,
                    hint="give each source of twists its own",
                )
