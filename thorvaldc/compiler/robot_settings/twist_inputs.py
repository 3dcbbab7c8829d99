"""Reads the sources of commanded twists and the twist locks of a robot document.

Each twist source and each twist lock has a priority.  An active twist lock stops all twist sources
of the same or a lower priority.  The ROS node twist_mux stops only the twist sources of a lower
priority.  A twist source must therefore not have the priority of a twist lock, so that the base
driver and twist_mux stop the same twist sources.

A stop lock is a twist lock that stops every twist source: ``safety_stop``, and a twist lock of the
priority 255.  Every twist source must have a lower priority than every stop lock.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from thorvaldc.compiler.values.document_section import Section
from thorvaldc.diagnostics import Label, Report
from thorvaldc.model import TwistInput
from thorvaldc.model.robot import SAFETY_STOP, STOP_PRIORITY

# The default twist sources and twist locks have the same names, priorities and ROS topics as in the
# twist multiplexer of the original system.  Commanded twists of the joystick have a higher priority
# than commanded twists of the navigation.
DEFAULT_SOURCES = {"teleop_joy": 100, "auto_nav": 10}
DEFAULT_LOCKS = {
    SAFETY_STOP: (STOP_PRIORITY, "safety_stop/lock"),
    "auto_nav_pause": (50, "auto_nav/pause"),
}


class TwistInputReader:
    """Reads the sections ``driver.twist_sources`` and ``driver.twist_locks`` of a robot document.

    Each entry of the two sections changes a default twist source or twist lock, or adds a new twist
    source or twist lock.
    """

    def __init__(self, driver: Section, report: Report) -> None:
        self._sources = dict(driver["twist_sources"].items())
        self._locks = dict(driver["twist_locks"].items())
        self._report = report

    def sources(self, command_timeout: float) -> tuple[TwistInput, ...]:
        """Returns the sources of commanded twists, such as the joystick and the navigation.

        ``command_timeout``: default time-out of a twist source (s).
        """
        sources = {
            name: TwistInput(name, _topic(name), priority, command_timeout)
            for name, priority in DEFAULT_SOURCES.items()
        }
        for name, section in self._sources.items():
            default = sources.get(name) or TwistInput(name, _topic(name), 0, command_timeout)
            sources[name] = _changed(default, section)
        self._check_priorities(sources)
        return tuple(sources.values())

    def locks(self, sources: Sequence[TwistInput]) -> tuple[TwistInput, ...]:
        """Returns the twist locks, which stop the ``sources`` of commanded twists.

        A twist lock with the time-out 0 s never times out.
        """
        locks = {
            name: TwistInput(name, topic, priority, 0.0)
            for name, (priority, topic) in DEFAULT_LOCKS.items()
        }
        for name, section in self._locks.items():
            default = locks.get(name) or TwistInput(name, f"{name}/lock", 0, 0.0)
            locks[name] = _changed(default, section)
        for source in sources:
            self._check_locks(source, locks.values())
        return tuple(locks.values())

    def _check_priorities(self, sources: dict[str, TwistInput]) -> None:
        """Reports two twist sources with the same priority.

        With equal priorities, the order of the twist sources in the document would decide which
        twist source drives the robot.
        """
        first_names: dict[int, str] = {}
        # Default twist sources are checked first.  An error is then reported at a twist source in
        # the robot file, where the user can correct the error.
        stated = self._sources
        for name in [*(name for name in sources if name not in stated), *stated]:
            priority = sources[name].priority
            first = first_names.setdefault(priority, name)
            if first != name and priority > 0:
                self._report.add(
                    "twist-priority-duplicate",
                    f"`{name}` has the priority {priority}, as `{first}` has",
                    stated[name].entry("priority").span,
                    hint="give each source its own priority",
                )

    def _check_locks(self, source: TwistInput, locks: Iterable[TwistInput]) -> None:
        """Reports a twist source that is not below a stop lock, or has the priority of another
        twist lock.
        """
        for lock in locks:
            if source.priority < lock.priority or source.priority <= 0 or lock.priority <= 0:
                continue
            if lock.is_stop_lock:
                message = (
                    f"`{source.name}` has the priority {source.priority}; the stop lock"
                    f" `{lock.name}` of the priority {lock.priority} would not stop it"
                )
                hint = f"a source has a lower priority than `{lock.name}`: at most %d"
            elif source.priority == lock.priority:
                message = (
                    f"`{source.name}` has the priority {source.priority}, as the lock"
                    f" `{lock.name}` has"
                )
                hint = f"give the source at most the priority %d, if `{lock.name}` shall stop it"
            else:
                continue
            # The values of the robot file can be corrected; the default values cannot.
            sections = (self._sources.get(source.name), self._locks.get(lock.name))
            stated = [s.entry("priority") for s in sections if s is not None]
            labels = [Label(node.where, "the lock") for node in stated[1:]]
            span = stated[0].span if stated else None
            self._report.add(
                "twist-priority-lock",
                message,
                span,
                hint=hint % (lock.priority - 1),
                labels=labels,
            )


def _changed(default: TwistInput, section: Section) -> TwistInput:
    """Returns a twist source or twist lock with the values of a robot document."""
    # The schema check has already reported a missing priority.
    return replace(default, **{"priority": 0, **dict(section.items())})


def _topic(source: str) -> str:
    return f"{source}/cmd_vel"
