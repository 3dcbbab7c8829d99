"""Carrying a plan out: guards first, then step by step, each verified and in the journal.

The bus is the truth.  Before anything is decided the robot's own nodes are reset, so that what
they have stored is what they show; a step counts as done when a node that was reset again
shows it.  After a stop at any place, ``resume`` makes a new plan from what it then finds.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from typing import Protocol

from thorvaldc.runtime.bus.lss import UNCONFIGURED, Identity
from thorvaldc.runtime.commissioning.journal import APPLY, RESUME, ROLLBACK, Journal
from thorvaldc.runtime.commissioning.lss_master import LssFault, LssMaster
from thorvaldc.runtime.commissioning.plan import (
    AddressStep,
    AttachStep,
    ConfigureStep,
    Plan,
    Step,
    make_plan,
)
from thorvaldc.runtime.commissioning.scan import (
    DUPLICATE,
    MISSING,
    OK,
    Scan,
    Scanner,
    identity_text,
)
from thorvaldc.runtime.commissioning.sdo import SdoClient, SdoDoubled, SdoRefused, SdoSilent
from thorvaldc.runtime.commissioning.session import Session, other_master
from thorvaldc.runtime.commissioning.target import Target, Value
from thorvaldc.runtime.commissioning.writing import ParameterWriter
from thorvaldc.runtime.faults import RuntimeFault

RESET_NODE = 129

Progress = Callable[[int, int, Step, bool], None]
"""Number of the step (from 0), how many, the step, and whether it is done."""


class Operator(Protocol):
    """Who does by hand what the bus cannot do."""

    def attach(self, step: AttachStep, words: str) -> bool:
        """Ask for the step to be done, and wait for it; ``False``: not now."""

    def all_on(self, words: str) -> bool:
        """Ask for all modules to be powered again."""


class StepFailed(Exception):
    """A step did not have its effect; the message says what was seen."""


class Flash:
    """One bus and its journal.

    All raise ``RuntimeFault``: ``bus-error``, ``bus-other-master``, ``bus-wrong-robot``,
    ``bus-drive-enabled``, ``plan-impossible``, ``plan-changed``, ``journal-mismatch``,
    ``flash-stopped``.  Nothing is written before all guards have passed, nothing after a stop.
    """

    def __init__(
        self,
        session: Session,
        target: Target,
        journal: Journal,
        *,
        operator: Operator | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.session = session
        self.target = target
        self.journal = journal
        self.operator = operator
        self.sdo = SdoClient(session)
        self.lss = LssMaster(session)
        self.writer = ParameterWriter(self.sdo)
        self._at: Counter[int] = Counter()
        self._progress = progress or (lambda number, of, step, done: None)

    # -- the three ways to begin ---------------------------------------------------------------

    def apply(self, expected: str | None = None) -> Plan:
        """Make a plan and carry it out.  ``expected``: the hash that the plan must have."""
        left = self.journal.unfinished
        if left is not None:
            raise RuntimeFault(
                "journal-mismatch",
                f"the journal {self.journal.store.name} has a {left.mode} that was not finished",
                hint="go on with --resume, or undo it with --rollback",
            )
        before, scan = self._look(self.target)
        plan = make_plan(self.target, scan)
        found = (before.ids(), before.entries), (scan.ids(), scan.entries)
        changed = found[0][0] != found[1][0]
        if changed or (expected is not None and plan.hash != expected):
            raise RuntimeFault(
                "plan-changed",
                "what is on the bus is not what the plan was made for",
                hint="look at `thorvaldc can plan` again, and flash that; nothing was written",
            )
        return self._carry_out(APPLY, plan)

    def resume(self) -> Plan:
        """Go on with the run that the journal has, from what is on the bus now."""
        left = self.journal.unfinished
        if left is None:
            raise RuntimeFault(
                "journal-mismatch",
                f"the journal {self.journal.store.name} has nothing to go on with",
                hint="begin with --apply",
            )
        target = left.plan.target
        if left.mode != ROLLBACK:
            self._check_target()
            target = self.target
        mode = left.mode if left.mode == ROLLBACK else RESUME
        return self._go_on(mode, target)

    def rollback(self) -> Plan:
        """Back to what was there before the last run that was begun afresh."""
        chain = self.journal.chain
        if not chain or (chain[-1].mode == ROLLBACK and chain[-1].finished):
            raise RuntimeFault(
                "journal-mismatch",
                f"the journal {self.journal.store.name} has nothing to undo",
                hint="it must hold a flash of this robot",
            )
        self._check_target()
        return self._go_on(ROLLBACK, self._origin())

    def _go_on(self, mode: str, target: Target) -> Plan:
        _, scan = self._look(target)
        self._check_reachable(scan)
        return self._carry_out(mode, make_plan(target, scan))

    def _origin(self) -> Target:
        """The bus as it was: the ids that were found, the values that were changed."""
        chain = self.journal.chain
        first = chain[0].plan
        start, identities = dict(first.start), dict(first.identities)
        old: dict[str, dict[tuple[int, int], Value]] = {}
        for run in chain:
            for name, before in run.old():
                # The first is what was there; a later one may be what a cut left of it.
                old.setdefault(name, {v.place: v for v in before})
        changed = {step.node for step in first.steps} | set(old)
        nodes = []
        for node in first.target.nodes:
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
        return dataclasses.replace(first.target, nodes=tuple(nodes))

    # -- guards --------------------------------------------------------------------------------

    def _look(self, target: Target) -> tuple[Scan, Scan]:
        """The bus as it is, and as it is after a reset of the robot's own nodes."""
        self.session.exclusive = False
        scanner = Scanner(self.session, target)
        before = scanner.active(values=False, texts=False)
        self._check(target, before)
        self.session.exclusive = True
        own = {
            found.id
            for entry in before.entries
            if entry.node
            and (found := entry.found) is not None
            and found.id not in (None, UNCONFIGURED)
            and target.node(entry.node).sdo
        }
        ids = sorted(node for node in own if node is not None)
        self._at = Counter(before.ids().values())
        self._reset(ids, sum(self._at[node] for node in ids))
        scan = Scanner(self.session, target).again(before)
        self._check(target, scan)
        return before, scan

    def _check(self, target: Target, scan: Scan) -> None:
        if scan.masters:
            raise other_master(list(scan.masters))
        plan = make_plan(target, scan)
        if plan.strangers:
            raise RuntimeFault(
                "bus-wrong-robot",
                f"this is not the bus of {target.robot}: {'; '.join(plan.strangers)}",
                hint="nothing was written; is it the right file, and are only this robot's "
                "modules on the bus?",
            )
        if scan.enabled:
            name, why = scan.enabled[0]
            raise RuntimeFault(
                "bus-drive-enabled",
                f"{name} may move: {why}",
                hint="stop the driver and let the robot come to rest; nothing was written",
            )
        if plan.problems:
            raise impossible(plan)

    def _check_target(self) -> None:
        first = self.journal.chain[0].plan.target if self.journal.chain else None
        if first is None or first.hash != self.target.hash:
            name = "nothing" if first is None else f"{first.robot}, bus {first.bus}"
            raise RuntimeFault(
                "journal-mismatch",
                f"the journal {self.journal.store.name} is of another plan: {name}",
                hint="the robot's file must be the one that the flash was begun with; nothing "
                "was written",
            )

    def _check_reachable(self, scan: Scan) -> None:
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
        self.session.exclusive = True
        self.session.surplus.clear()  # what the scan has seen is in the plan
        self.journal.start(mode, plan)
        number = 0
        try:
            for number, step in enumerate(plan.steps):
                self._progress(number, len(plan.steps), step, False)
                self._step(number, step, plan.target)
                self._progress(number, len(plan.steps), step, True)
                if isinstance(step, AttachStep):
                    self._bring_back(plan, number)
        except KeyboardInterrupt:
            self.journal.stop("interrupted")
            raise
        except (StepFailed, SdoSilent, SdoRefused, SdoDoubled, LssFault) as fault:
            step = plan.steps[number]
            self.journal.stop(f"{step.words}: {fault}")
            raise RuntimeFault(
                "flash-stopped",
                f"step {number + 1} of {len(plan.steps)} ({step.words}) did not succeed: {fault}",
                hint="nothing was tried again; look at the device, then go on with --resume or "
                "undo with --rollback",
            ) from None
        except RuntimeFault as fault:
            self.journal.stop(str(fault))
            raise
        self.journal.end()
        return plan

    def _step(self, number: int, step: Step, target: Target) -> None:
        if isinstance(step, AddressStep):
            self._check_alone(step)
            self.journal.begin(number, step.node, step.words)
            self._move(step)
            self.journal.done(number, step.node, {"id": step.after})
        elif isinstance(step, ConfigureStep):
            self._check_identity(step.id, step.identity)
            writer = self.writer
            read = writer.read(step.id, step.values)
            old = [v for v in step.values if (now := read.get(v.place)) is None or now != v.value]
            if not old:
                self.journal.begin(number, step.node, step.words)
                self.journal.done(number, step.node, {"written": 0})
                return
            unreadable = [v.shown for v in old if read.get(v.place) is None]
            if unreadable:
                raise StepFailed(f"it has no object {', '.join(unreadable)}")
            before = [dataclasses.replace(v, value=read[v.place] or 0) for v in old]
            self.journal.begin(number, step.node, step.words, before)
            writer.write(step.id, step.values, read)
            writer.save(step.id)
            self._restart(step.id, step.id)
            self._check_identity(step.id, step.identity)
            read = writer.read(step.id, step.values)
            wrong = [v.shown for v in step.values if read.get(v.place) != v.value]
            if wrong:
                raise StepFailed(f"after a reset it does not hold {', '.join(wrong)} as written")
            self.journal.done(number, step.node, {"written": len(old)})
        else:
            self._attach(number, step, target)
        for where in sorted(self.session.surplus):
            raise StepFailed(f"more answers than requests came from id {where}")

    def _check_alone(self, step: AddressStep) -> None:
        """The precondition: nobody has the new id."""
        if step.after == UNCONFIGURED:
            return
        answers = self.sdo.every(step.after, 0x1000, 0, timeout=self.session.timing.absent)
        if answers:
            raise StepFailed(f"somebody has the id {step.after} already")

    def _move(self, step: AddressStep) -> None:
        lss = self.lss
        lss.waiting()
        count = lss.select(step.identity)
        if count != 1:
            who = "nobody answers" if count == 0 else f"{count} devices answer"
            raise StepFailed(f"{who} as {identity_text(step.identity)}")
        where = lss.node_id()
        if where != step.before:
            raise StepFailed(f"it has the id {where}, not {step.before}")
        lss.configure_id(step.after)
        lss.store()
        self.session.boots.clear()
        lss.waiting()
        if step.before == UNCONFIGURED:
            # It takes a first id on at once; what it has stored shows after a reset.
            self._await([step.after])
            self._restart(step.after, step.after)
        else:
            self._restart(step.before, step.after)
        self._at[step.before] -= 1
        self._at[step.after] += 1
        if step.after == UNCONFIGURED:
            self._check_bare(step.identity)
        else:
            self._check_identity(step.after, step.identity)

    def _restart(self, node: int, after: int) -> None:
        self.session.boots.clear()
        self.session.nmt(RESET_NODE, node)
        if after != UNCONFIGURED:
            # Others of the same id, which are still to get their own, start again with it.
            others = [node] * (self._at[node] - 1) if node != after else []
            self._await([after, *others])

    def _reset(self, ids: list[int], count: int) -> None:
        """What nodes have stored is what they show afterwards."""
        self.session.boots.clear()
        for node in ids:
            self.session.nmt(RESET_NODE, node)
        # One that has lost its id does not say when it has started.
        self.session.wait_for_count(count, self.session.timing.boot)
        self.session.listen(self.session.timing.absent / 4)

    def _await(self, ids: list[int]) -> None:
        missing = self.session.wait_for_boots(ids, self.session.timing.boot)
        if missing:
            raise StepFailed(f"no node has started with the id {missing[0]}")

    def _check_identity(self, node: int, identity: Identity | None) -> None:
        """Exactly one answers there, and it is the one."""
        for subindex in (1, 2, 3, 4):
            wanted = None if identity is None else identity[subindex - 1]
            answers = self.sdo.every(node, 0x1018, subindex, timeout=self.session.timing.sdo)
            if not answers:
                raise StepFailed(f"nobody answers at id {node}")
            if len(answers) > 1:
                raise StepFailed(f"{len(answers)} nodes answer at id {node}")
            answer = answers[0]
            if answer.abort is None and wanted is not None:
                found = int.from_bytes(answer.data, "little")
                if found != wanted:
                    raise StepFailed(
                        f"at id {node} stands a device with {found:#x} for {wanted:#x}"
                    )
            elif answer.abort is not None and wanted:
                raise StepFailed(f"the device at id {node} does not say who it is")

    def _check_bare(self, identity: Identity) -> None:
        """It has no id any more.  Who has none does not say when it has started: it is asked."""
        limit = self.session.now + self.session.timing.boot
        while True:
            self.lss.waiting()
            if self.lss.select(identity) == 1:
                break
            if self.session.now >= limit:
                raise StepFailed(f"nobody answers as {identity_text(identity)}")
        where = self.lss.node_id()
        self.lss.waiting()
        if where != UNCONFIGURED:
            raise StepFailed(f"it still has the id {where}")

    # -- what is done by hand ------------------------------------------------------------------

    def _attach(self, number: int, step: AttachStep, target: Target) -> None:
        node = target.node(step.node)
        if self.operator is None:
            raise StepFailed("there is nobody to do it")
        words = (
            f"Switch the power of all modules off, then power {node.module} alone. Set its node "
            f"id to {step.after} with its maker's tool, save it, and switch it off and on."
        )
        self.journal.begin(number, step.node, step.words)
        if not self.operator.attach(step, words):
            raise StepFailed("it was put off by the operator")
        one = dataclasses.replace(target, nodes=(node,))
        scan = Scanner(self.session, one).active(values=False, texts=False)
        answering = [e for e in scan.entries if e.found is not None]
        if len(answering) != 1 or scan.duplicates:
            many = "nobody answers" if not answering else "more than one device answers"
            raise StepFailed(f"{many}, where {node.module} alone should")
        entry = answering[0]
        if entry.verdict in (MISSING, DUPLICATE) or entry.node != node.name:
            where = None if entry.found is None else entry.found.id
            raise StepFailed(f"a device answers at id {where}, not at {step.after} as {node.name}")
        read = {
            "id": step.after,
            "seen": "by its answers; set by the operator, not by this program",
        }
        self.journal.done(number, step.node, read)

    def _bring_back(self, plan: Plan, number: int) -> None:
        """After the last module that was powered alone: all of them, each at its own id."""
        if any(isinstance(step, AttachStep) for step in plan.steps[number + 1 :]):
            return
        if self.operator is None or not self.operator.all_on("Power all modules again."):
            raise StepFailed("the modules were not powered again")
        scan = Scanner(self.session, plan.target).active(values=False, texts=False)
        for step in plan.steps[: number + 1]:
            entry = scan.entry(step.node)
            if isinstance(step, AttachStep) and entry.verdict != OK:
                raise StepFailed(f"{step.node} is {entry.verdict}: {entry.detail}")


def impossible(plan: Plan) -> RuntimeFault:
    return RuntimeFault(
        "plan-impossible",
        f"there is no safe way to {plan.target.robot}: {'; '.join(plan.problems)}",
        hint="nothing was written; `thorvaldc can scan --active` shows what is on the bus",
    )


def ambiguous(what: str) -> RuntimeFault:
    return RuntimeFault(
        "flash-ambiguous",
        f"{what}; somebody else has changed the bus since",
        hint="nothing was written; look at `thorvaldc can scan --active`, then begin afresh "
        "with another --journal",
    )
