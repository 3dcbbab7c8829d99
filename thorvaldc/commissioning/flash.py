"""Carrying a plan out: guards first, then step by step, each verified and in the journal.

The bus is the truth.  Before anything is decided the robot's own nodes are reset, so that what
they have stored is what they show; a step counts as done when a node that was reset again
shows it.  After a stop at any place, ``resume`` makes a new plan from what it then finds.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable

from thorvaldc.can.lss import UNCONFIGURED
from thorvaldc.commissioning.bus_configuration import BusConfiguration, ParameterValue
from thorvaldc.commissioning.bus_master import BusMaster, other_master_error
from thorvaldc.commissioning.journal import APPLY, RESUME, ROLLBACK, Journal
from thorvaldc.commissioning.lss_master import LssError
from thorvaldc.commissioning.plan import AttachStep, Plan, PlanStep, make_plan
from thorvaldc.commissioning.scan_result import ScanResult
from thorvaldc.commissioning.scanner import Progress as Scanning
from thorvaldc.commissioning.scanner import Scanner
from thorvaldc.commissioning.sdo_client import SdoAborted, SdoMultipleResponses, SdoTimeout
from thorvaldc.commissioning.step_executor import Operator, StepExecutor, StepFailed
from thorvaldc.diagnostics.error import DiagnosticError

Progress = Callable[[int, int, PlanStep, bool], None]
"""Number of the step (from 0), how many, the step, and whether it is done."""


class Flash:
    """One bus and its journal.

    All raise ``DiagnosticError``: ``bus-error``, ``bus-other-master``, ``bus-wrong-robot``,
    ``bus-drive-enabled``, ``plan-impossible``, ``plan-changed``, ``journal-mismatch``,
    ``flash-stopped``.  Nothing is written before all guards have passed, nothing after a stop.
    """

    def __init__(
        self,
        master: BusMaster,
        target: BusConfiguration,
        journal: Journal,
        *,
        operator: Operator | None = None,
        progress: Progress | None = None,
        scanning: Scanning | None = None,
    ) -> None:
        self.master = master
        self.target = target
        self.journal = journal
        self.stepper = StepExecutor(master, journal, operator)
        self._scanning = scanning
        self._progress = progress or (lambda number, of, step, done: None)

    # -- the three ways to begin ---------------------------------------------------------------

    def apply(self, expected: str | None = None) -> Plan:
        """Make a plan and carry it out.  ``expected``: the hash that the plan must have."""
        left = self.journal.unfinished
        if left is not None:
            what = "rollback" if left.mode == ROLLBACK else "flash"
            raise DiagnosticError(
                "journal-mismatch",
                f"the journal {self.journal.store.name} has a {what} that was not finished",
                hint="go on with --resume, or undo it with --rollback",
            )
        before, scan = self._look(self.target)
        plan = make_plan(self.target, scan)
        changed = before.ids() != scan.ids()
        if changed or (expected is not None and plan.hash != expected):
            raise DiagnosticError(
                "plan-changed",
                "what is on the bus is not what the plan was made for",
                hint="look at `thorvaldc can plan` again, and flash that; nothing was written",
            )
        return self._carry_out(APPLY, plan)

    def resume(self) -> Plan:
        """Go on with the run that the journal has, from what is on the bus now."""
        left = self.journal.unfinished
        if left is None:
            raise DiagnosticError(
                "journal-mismatch",
                f"the journal {self.journal.store.name} has nothing to go on with",
                hint="begin with --apply",
            )
        target = left.plan.configuration
        if left.mode != ROLLBACK:
            self._check_target()
            target = self.target
        mode = left.mode if left.mode == ROLLBACK else RESUME
        return self._go_on(mode, target)

    def rollback(self) -> Plan:
        """Back to what was there before the last run that was begun afresh."""
        chain = self.journal.chain
        if not chain or (chain[-1].mode == ROLLBACK and chain[-1].finished):
            raise DiagnosticError(
                "journal-mismatch",
                f"the journal {self.journal.store.name} has nothing to undo",
                hint="it must hold a flash of this robot",
            )
        self._check_target()
        return self._go_on(ROLLBACK, self._origin())

    def _go_on(self, mode: str, target: BusConfiguration) -> Plan:
        _, scan = self._look(target)
        self._check_reachable(scan)
        return self._carry_out(mode, make_plan(target, scan))

    def _origin(self) -> BusConfiguration:
        """The bus as it was: the ids that were found, the values that were changed."""
        chain = self.journal.chain
        first = chain[0].plan
        start, identities = dict(first.start), dict(first.identities)
        old: dict[str, dict[tuple[int, int], ParameterValue]] = {}
        for run in chain:
            for name, before in run.old():
                # The first is what was there; a later one may be what a cut left of it.
                old.setdefault(name, {v.place: v for v in before})
        changed = {step.node for step in first.steps} | set(old)
        nodes = []
        for node in first.configuration.nodes:
            values = tuple(old.get(node.name, {}).values())
            known = identities.get(node.name) if node.lss else None
            where = start.get(node.name, node.id) if node.name in changed else node.id
            node = dataclasses.replace(node, id=where, values=values)
            if known is not None:
                # The very devices that were there, whatever the file says of serial numbers.
                vendor, product, revision, serial = known
                node = dataclasses.replace(
                    node, vendor=vendor, product=product, revision=revision, serial=serial
                )
            nodes.append(node)
        return dataclasses.replace(first.configuration, nodes=tuple(nodes))

    # -- guards --------------------------------------------------------------------------------

    def _look(self, target: BusConfiguration) -> tuple[ScanResult, ScanResult]:
        """The bus as it is, and as it is after a reset of the robot's own nodes."""
        self.master.exclusive = False
        scanner = Scanner(self.master, target, self._scanning)
        before = scanner.active(values=False, texts=False)
        self._check(target, before)
        self.master.exclusive = True
        own = {
            found.id
            for entry in before.entries
            if entry.node
            and (found := entry.found) is not None
            and found.id not in (None, UNCONFIGURED)
            and target.node(entry.node).sdo
        }
        ids = sorted(node for node in own if node is not None)
        self.stepper.at = Counter(before.ids().values())
        self.stepper.reset(ids, sum(self.stepper.at[node] for node in ids))
        scan = Scanner(self.master, target, self._scanning).again(before)
        self._check(target, scan)
        return before, scan

    def _check(self, target: BusConfiguration, scan: ScanResult) -> None:
        if scan.masters:
            raise other_master_error(list(scan.masters))
        plan = make_plan(target, scan)
        if plan.strangers:
            raise DiagnosticError(
                "bus-wrong-robot",
                f"this is not the bus of {target.robot}: {'; '.join(plan.strangers)}",
                hint="nothing was written; is it the right file, and are only this robot's "
                "modules on the bus?",
            )
        if scan.enabled:
            name, why = scan.enabled[0]
            raise DiagnosticError(
                "bus-drive-enabled",
                f"{name} may move: {why}",
                hint="stop the driver and let the robot come to rest; nothing was written",
            )
        if plan.problems:
            raise impossible(plan)

    def _check_target(self) -> None:
        first = self.journal.chain[0].plan.configuration if self.journal.chain else None
        if first is None or first.hash != self.target.hash:
            name = "nothing" if first is None else f"{first.robot}, bus {first.bus}"
            raise DiagnosticError(
                "journal-mismatch",
                f"the journal {self.journal.store.name} is of another plan: {name}",
                hint="the robot's file must be the one that the flash was begun with; nothing "
                "was written",
            )

    def _check_reachable(self, scan: ScanResult) -> None:
        """Every device is where the journal's plans had it at some time, or has lost its id."""
        chain = self.journal.chain
        identities = dict(chain[0].plan.identities)
        allowed: dict[str, set[int]] = {}
        begun: set[str] = set()
        for run in chain:
            for name, ids in run.plan.ids.items():
                allowed.setdefault(name, set()).update(ids)
            begun |= {run.plan.steps[i].node for i in run.begun if i < len(run.plan.steps)}
        for entry in scan.entries:
            if not entry.node or entry.found is None or entry.found.id is None:
                continue
            name, where, identity = entry.node, entry.found.id, entry.found.identity
            known = identities.get(name)
            if known is not None and identity is not None and known != identity:
                raise ambiguous(f"{name} is another device than when the flash was begun")
            if name in allowed and where not in allowed[name]:
                lost = where == UNCONFIGURED and name in begun
                if not lost:
                    at = "no id" if where == UNCONFIGURED else f"the id {where}"
                    raise ambiguous(f"{name} has {at}, which no step of the journal gives it")

    # -- steps ---------------------------------------------------------------------------------

    def _carry_out(self, mode: str, plan: Plan) -> Plan:
        if plan.problems or plan.strangers:
            raise impossible(plan)
        if mode == APPLY and not plan.steps:
            return plan
        self.master.exclusive = True
        self.master.surplus.clear()  # what the scan has seen is in the plan
        self.journal.start(mode, plan)
        number = 0
        try:
            for number, step in enumerate(plan.steps):
                self._progress(number, len(plan.steps), step, False)
                self.stepper.run(number, step, plan.configuration)
                self._progress(number, len(plan.steps), step, True)
                if isinstance(step, AttachStep):
                    self.stepper.bring_back(plan, number)
        except KeyboardInterrupt:
            self.journal.stop("interrupted")
            raise
        except (StepFailed, SdoTimeout, SdoAborted, SdoMultipleResponses, LssError) as fault:
            step = plan.steps[number]
            self.journal.stop(f"{step.description}: {fault}")
            raise DiagnosticError(
                "flash-stopped",
                f"step {number + 1} of {len(plan.steps)} ({step.description}) "
                f"did not succeed: {fault}",
                hint="nothing was tried again; look at the device, then go on with --resume or "
                "undo with --rollback",
            ) from None
        except DiagnosticError as fault:
            self.journal.stop(str(fault))
            raise
        self.journal.end()
        return plan


def impossible(plan: Plan) -> DiagnosticError:
    return DiagnosticError(
        "plan-impossible",
        f"there is no safe way to {plan.configuration.robot}: {'; '.join(plan.problems)}",
        hint="nothing was written; `thorvaldc can scan --active` shows what is on the bus",
    )


def ambiguous(what: str) -> DiagnosticError:
    return DiagnosticError(
        "flash-ambiguous",
        f"{what}; somebody else has changed the bus since",
        hint="nothing was written; look at `thorvaldc can scan --active`, then begin afresh "
        "with another --journal",
    )
