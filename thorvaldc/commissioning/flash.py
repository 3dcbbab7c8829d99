"""Executes a commissioning plan, which writes the required configuration to the nodes (flash).

Before the first step of a flash, the program checks that writing to the nodes is safe.  Each step
of the commissioning plan is verified and recorded in a journal file.  The present node ids and
object values are always read from the devices, never from the journal.  The journal file contains
the planned steps and the previous object values.  Sequence of a flash:

    scan        check: only devices of this robot, no other master, no drive enabled
    reset       the nodes of the robot, so that each node loads its stored values
    scan        check: same node ids as before; the plan is made from this scan
    journal     run (the plan with its hash)
    step 0      journal begin (previous values) - write - reset - read back - journal done
    step 1      ...
    journal     end

``resume`` continues a flash after a power cut or a stop at any point.  At the beginning ``resume``
scans the CAN bus and resets the nodes.  For each device, a plan in the journal must contain the
node id that the device has.  From the result of the scan, ``resume`` makes a new commissioning
plan.  The new commissioning plan contains only steps whose results are not stored in the devices
yet.

``rollback`` works like ``resume``, but restores the node ids and object values from before the
first step of the flash.  The journal contains the node ids and object values from before the first
step of the flash.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable

from thorvaldc.can.lss import UNCONFIGURED
from thorvaldc.commissioning.bus_configuration import BusConfiguration, ParameterValue
from thorvaldc.commissioning.bus_master import BusMaster, SdoError, other_master_error
from thorvaldc.commissioning.journal import APPLY, RESUME, ROLLBACK, Journal
from thorvaldc.commissioning.lss_master import LssError
from thorvaldc.commissioning.plan import AttachStep, Plan, PlanStep
from thorvaldc.commissioning.planner import make_plan
from thorvaldc.commissioning.scan_result import ScanResult
from thorvaldc.commissioning.scanner import Progress as ScanProgress
from thorvaldc.commissioning.scanner import Scanner
from thorvaldc.commissioning.step_executor import Operator, StepExecutor, StepFailed
from thorvaldc.diagnostics import DiagnosticError

Progress = Callable[[int, int, PlanStep, bool], None]
"""Called before and after each step.

The arguments are the index of the step (from 0), the number of steps, the step, and ``True`` if the
step is completed."""


class Flash:
    """Writes the required configuration to the nodes on a CAN bus.

    ``apply``, ``resume`` and ``rollback`` raise ``DiagnosticError`` with one of these names:
    ``bus-error``, ``bus-other-master``, ``bus-wrong-robot``, ``bus-drive-enabled``,
    ``plan-impossible``, ``plan-changed``, ``journal-mismatch``, ``flash-ambiguous``,
    ``flash-stopped``.  A flash writes to the devices only after all checks have passed.  A flash
    stops after a failed step and does not write to any other device.
    """

    def __init__(
        self,
        master: BusMaster,
        configuration: BusConfiguration,
        journal: Journal,
        *,
        operator: Operator | None = None,
        progress: Progress | None = None,
        scanning: ScanProgress | None = None,
    ) -> None:
        self.master = master
        self.configuration = configuration
        self.journal = journal
        self.executor = StepExecutor(master, journal, operator)
        self._scanning = scanning
        self._progress = progress or (lambda number, total, step, completed: None)

    # -- the three modes -----------------------------------------------------------------------

    def apply(self, expected: str | None = None) -> Plan:
        """Makes a commissioning plan from a scan of the CAN bus, and executes the plan.

        ``expected``: required hash of the commissioning plan.  Every plan is accepted if
        ``expected`` is ``None``.
        """
        self.journal.refuse_unfinished()
        first, scan = self._scan_and_reset(self.configuration)
        plan = make_plan(self.configuration, scan)
        changed = first.ids() != scan.ids()
        if changed or (expected is not None and plan.hash != expected):
            raise DiagnosticError(
                "plan-changed",
                "the devices on the bus differ from those the plan was made for",
                hint="nothing was written; look at `thorvaldc can plan` again, and flash that",
            )
        return self._execute(APPLY, plan)

    def resume(self) -> Plan:
        """Continues the unfinished flash that is recorded in the journal."""
        unfinished = self.journal.unfinished
        if unfinished is None:
            raise DiagnosticError(
                "journal-mismatch",
                f"the journal {self.journal.storage.name} contains no unfinished flash",
                hint="start one with --apply",
            )
        if unfinished.mode == ROLLBACK:
            return self._continue(ROLLBACK, unfinished.plan.configuration)
        self._check_configuration()
        return self._continue(RESUME, self.configuration)

    def rollback(self) -> Plan:
        """Restores the node ids and object values that the nodes had before the last ``apply``."""
        chain = self.journal.chain
        if not chain or (chain[-1].mode == ROLLBACK and chain[-1].finished):
            raise DiagnosticError(
                "journal-mismatch",
                f"the journal {self.journal.storage.name} contains nothing to undo",
                hint="it must contain a flash of this robot",
            )
        self._check_configuration()
        return self._continue(ROLLBACK, self._previous_configuration())

    def _continue(self, mode: str, configuration: BusConfiguration) -> Plan:
        _, scan = self._scan_and_reset(configuration)
        self._check_reachable(scan)
        return self._execute(mode, make_plan(configuration, scan))

    def _previous_configuration(self) -> BusConfiguration:
        """Returns the configuration of the nodes before the first step of the flash.

        The node ids are taken from the scan, and the object values are the previous values in the
        journal.
        """
        chain = self.journal.chain
        first = chain[0].plan
        start, identities = dict(first.start), dict(first.identities)
        previous: dict[str, dict[tuple[int, int], ParameterValue]] = {}
        for run in chain:
            for name, values_before in run.previous_values():
                # The rollback uses only the first journal record of each node.  A later journal
                # record may contain values that an incomplete step has written.
                previous.setdefault(name, {value.key: value for value in values_before})
        changed = {step.node for step in first.steps} | set(previous)
        nodes = []
        for node in first.configuration.nodes:
            values = tuple(previous.get(node.name, {}).values())
            known = identities.get(node.name) if node.lss else None
            node_id = start.get(node.name, node.id) if node.name in changed else node.id
            node = dataclasses.replace(node, id=node_id, values=values)
            if known is not None:
                # The scanned identity ensures that the rollback uses the same device, even if the
                # robot file contains no serial number.
                vendor, product, revision, serial = known
                node = dataclasses.replace(
                    node, vendor=vendor, product=product, revision=revision, serial=serial
                )
            nodes.append(node)
        return dataclasses.replace(first.configuration, nodes=tuple(nodes))

    # -- guards --------------------------------------------------------------------------------

    def _scan_and_reset(self, configuration: BusConfiguration) -> tuple[ScanResult, ScanResult]:
        """Scans the CAN bus, resets the nodes of the robot, and scans the CAN bus again.

        Returns the results of the first and the second scan of the CAN bus.  Raises
        ``DiagnosticError`` if a scan result does not pass the checks before a flash.
        """
        self.master.exclusive = False
        scanner = Scanner(self.master, configuration, self._scanning)
        first = scanner.active(values=False, texts=False)
        self._check(configuration, first)
        self.master.exclusive = True
        ids = sorted(
            {
                node_id
                for name, node_id in first.ids().items()
                if node_id != UNCONFIGURED and configuration.node(name).sdo
            }
        )
        self.executor.nodes_at = Counter(first.ids().values())
        self.executor.reset(ids, sum(self.executor.nodes_at[node] for node in ids))
        scan = Scanner(self.master, configuration, self._scanning).again(first)
        self._check(configuration, scan)
        return first, scan

    def _check(self, configuration: BusConfiguration, scan: ScanResult) -> None:
        if scan.masters:
            raise other_master_error(list(scan.masters))
        plan = make_plan(configuration, scan)
        if plan.strangers:
            raise DiagnosticError(
                "bus-wrong-robot",
                f"this is not the bus of {configuration.robot}: {'; '.join(plan.strangers)}",
                hint="nothing was written; check that the file is the right one, and that only "
                "modules of this robot are on the bus",
            )
        if scan.enabled:
            name, why = scan.enabled[0]
            raise DiagnosticError(
                "bus-drive-enabled",
                f"{name} may move: {why}",
                hint="nothing was written; stop the driver and wait until the robot is at rest",
            )
        if plan.problems:
            raise impossible(plan)

    def _check_configuration(self) -> None:
        first = self.journal.chain[0].plan.configuration if self.journal.chain else None
        if first is None or first.hash != self.configuration.hash:
            name = "none" if first is None else f"{first.robot}, bus {first.bus}"
            raise DiagnosticError(
                "journal-mismatch",
                f"the journal {self.journal.storage.name} belongs to another configuration: {name}",
                hint="nothing was written; use the robot file with which the flash was started",
            )

    def _check_reachable(self, scan: ScanResult) -> None:
        """Checks that the node id of each device on the bus occurs in a plan of the journal.

        A device without node id is accepted if the journal contains a started commissioning step
        for the device.
        """
        chain = self.journal.chain
        identities = dict(chain[0].plan.identities)
        allowed: dict[str, set[int]] = {}
        started: set[str] = set()
        for run in chain:
            for name, ids in run.plan.ids.items():
                allowed.setdefault(name, set()).update(ids)
            started |= {
                run.plan.steps[i].node for i in run.started_steps if i < len(run.plan.steps)
            }
        for entry in scan.entries:
            if not entry.node or entry.device is None or entry.device.id is None:
                continue
            name, node_id, identity = entry.node, entry.device.id, entry.device.identity
            known = identities.get(name)
            if known is not None and identity is not None and known != identity:
                raise ambiguous(f"{name} is not the device that it was when the flash was started")
            if name in allowed and node_id not in allowed[name]:
                lost = node_id == UNCONFIGURED and name in started
                if not lost:
                    raise ambiguous(
                        f"{name} has {entry.device.id_text}, which no step of the journal sets"
                    )

    # -- steps ---------------------------------------------------------------------------------

    def _execute(self, mode: str, plan: Plan) -> Plan:
        if plan.problems or plan.strangers:
            raise impossible(plan)
        if mode == APPLY and not plan.steps:
            return plan
        self.master.exclusive = True
        self.master.surplus.clear()  # the scan has already reported surplus responses as duplicates
        self.journal.start(mode, plan)
        number = 0
        try:
            for number, step in enumerate(plan.steps):
                self._progress(number, len(plan.steps), step, False)
                self.executor.run(number, step, plan.configuration)
                self._progress(number, len(plan.steps), step, True)
                if isinstance(step, AttachStep):
                    self.executor.power_all(plan, number)
        except KeyboardInterrupt:
            self.journal.stop("interrupted")
            raise
        except (StepFailed, SdoError, LssError) as error:
            step = plan.steps[number]
            self.journal.stop(f"{step.description}: {error}")
            raise DiagnosticError(
                "flash-stopped",
                f"step {number + 1} of {len(plan.steps)} ({step.description}) "
                f"did not succeed: {error}",
                hint="nothing was sent again; check the device, then continue with --resume or "
                "undo with --rollback",
            ) from None
        except DiagnosticError as error:
            self.journal.stop(str(error))
            raise
        self.journal.end()
        return plan


def impossible(plan: Plan) -> DiagnosticError:
    return DiagnosticError(
        "plan-impossible",
        f"there is no safe way to {plan.configuration.robot}: {'; '.join(plan.problems)}",
        hint="nothing was written; `thorvaldc can scan --active` shows what is on the bus",
    )


def ambiguous(observation: str) -> DiagnosticError:
    return DiagnosticError(
        "flash-ambiguous",
        f"{observation}; the bus was changed outside of the flash",
        hint="nothing was written; look at `thorvaldc can scan --active`, then start a new flash "
        "with another --journal",
    )
