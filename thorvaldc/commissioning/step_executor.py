"""One step of a plan: its precondition, what it writes, and the proof by reading back."""

from __future__ import annotations

import dataclasses
from collections import Counter
from typing import Protocol

from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.commissioning.bus_configuration import BusConfiguration
from thorvaldc.commissioning.bus_master import BusMaster
from thorvaldc.commissioning.journal import Journal
from thorvaldc.commissioning.lss_master import LssMaster
from thorvaldc.commissioning.object_writer import ParameterWriter
from thorvaldc.commissioning.plan import AddressStep, AttachStep, ConfigureStep, Plan, PlanStep
from thorvaldc.commissioning.scan_result import DUPLICATE, MISSING, OK, identity_text
from thorvaldc.commissioning.scanner import Scanner
from thorvaldc.commissioning.sdo_client import SdoClient

RESET_NODE = 129


class Operator(Protocol):
    """Who does by hand what the bus cannot do."""

    def attach(self, step: AttachStep, words: str) -> bool:
        """Ask for the step to be done, and wait for it; ``False``: not now."""

    def power_all(self, words: str) -> bool:
        """Ask for all modules to be powered again."""


class StepFailed(Exception):
    """A step did not have its effect; the message says what was seen."""


class StepExecutor:
    """Carries steps out and has them in the journal.  ``at``: how many nodes have which id."""

    def __init__(self, master: BusMaster, journal: Journal, operator: Operator | None) -> None:
        self.master = master
        self.journal = journal
        self.operator = operator
        self.sdo = SdoClient(master)
        self.lss = LssMaster(master)
        self.writer = ParameterWriter(self.sdo)
        self.at: Counter[int] = Counter()

    def run(self, number: int, step: PlanStep, target: BusConfiguration) -> None:
        """Raises ``StepFailed``, ``LssError`` or an error of the SDO client."""
        if isinstance(step, AddressStep):
            self._check_alone(step)
            self.journal.begin(number, step.node, step.description)
            self._move(step)
            self.journal.done(number, step.node, {"id": step.after})
        elif isinstance(step, ConfigureStep):
            self._check_identity(step.id, step.identity)
            writer = self.writer
            read = writer.read(step.id, step.values)
            old = [v for v in step.values if (now := read.get(v.place)) is None or now != v.value]
            if not old:
                self.journal.begin(number, step.node, step.description)
                self.journal.done(number, step.node, {"written": 0})
                return
            unreadable = [v.shown for v in old if read.get(v.place) is None]
            if unreadable:
                raise StepFailed(f"it has no object {', '.join(unreadable)}")
            before = [dataclasses.replace(v, value=read[v.place] or 0) for v in old]
            self.journal.begin(number, step.node, step.description, before)
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
        for where in sorted(self.master.surplus):
            raise StepFailed(f"more answers than requests came from id {where}")

    def _check_alone(self, step: AddressStep) -> None:
        """The precondition: nobody has the new id."""
        if step.after == UNCONFIGURED:
            return
        answers = self.sdo.every(step.after, 0x1000, 0, timeout=self.master.timing.absent)
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
        self.master.boots.clear()
        lss.waiting()
        if step.before == UNCONFIGURED:
            # It takes a first id on at once; what it has stored shows after a reset.
            self._await([step.after])
            self._restart(step.after, step.after)
        else:
            self._restart(step.before, step.after)
        self.at[step.before] -= 1
        self.at[step.after] += 1
        if step.after == UNCONFIGURED:
            self._check_bare(step.identity)
        else:
            self._check_identity(step.after, step.identity)

    def _restart(self, node: int, after: int) -> None:
        self.master.boots.clear()
        self.master.nmt(RESET_NODE, node)
        if after != UNCONFIGURED:
            # Others of the same id, which are still to get their own, start again with it.
            others = [node] * (self.at[node] - 1) if node != after else []
            self._await([after, *others])

    def reset(self, ids: list[int], count: int) -> None:
        """What these ``count`` nodes have stored is what they show afterwards."""
        self.master.boots.clear()
        for node in ids:
            self.master.nmt(RESET_NODE, node)
        # One that has lost its id does not say when it has started.
        self.master.wait_for_count(count, self.master.timing.boot)
        self.master.listen(self.master.timing.absent / 4)

    def _await(self, ids: list[int]) -> None:
        missing = self.master.wait_for_boots(ids, self.master.timing.boot)
        if missing:
            raise StepFailed(f"no node has started with the id {missing[0]}")

    def _check_identity(self, node: int, identity: Identity | None) -> None:
        """Exactly one answers there, and it is the one."""
        for subindex in (1, 2, 3, 4):
            wanted = None if identity is None else identity[subindex - 1]
            answers = self.sdo.every(node, 0x1018, subindex, timeout=self.master.timing.sdo)
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
        limit = self.master.now + self.master.timing.boot
        while True:
            self.lss.waiting()
            if self.lss.select(identity) == 1:
                break
            if self.master.now >= limit:
                raise StepFailed(f"nobody answers as {identity_text(identity)}")
        where = self.lss.node_id()
        self.lss.waiting()
        if where != UNCONFIGURED:
            raise StepFailed(f"it still has the id {where}")

    # -- what is done by hand ------------------------------------------------------------------

    def _attach(self, number: int, step: AttachStep, target: BusConfiguration) -> None:
        node = target.node(step.node)
        if self.operator is None:
            raise StepFailed("there is nobody to do it")
        words = (
            f"Switch the power of all modules off, then power {node.module} alone. Set its node "
            f"id to {step.after} with its maker's tool, save it, and switch it off and on."
        )
        self.journal.begin(number, step.node, step.description)
        if not self.operator.attach(step, words):
            raise StepFailed("it was put off by the operator")
        one = dataclasses.replace(target, nodes=(node,))
        scan = Scanner(self.master, one).active(values=False)
        answering = [e for e in scan.entries if e.found is not None]
        if len(answering) != 1 or scan.duplicates:
            many = "nobody answers" if not answering else "more than one device answers"
            raise StepFailed(f"{many}, where {node.module} alone should")
        entry = answering[0]
        if entry.verdict in (MISSING, DUPLICATE) or entry.node != node.name:
            where = None if entry.found is None else entry.found.id
            raise StepFailed(f"a device answers at id {where}, not at {step.after} as {node.name}")
        texts = [] if entry.found is None else list(entry.found.texts)
        read = {"id": step.after, "set_by": "the operator", "says": texts}
        self.journal.done(number, step.node, read)

    def bring_back(self, plan: Plan, number: int) -> None:
        """After the last module that was powered alone: all of them, each at its own id."""
        if any(isinstance(step, AttachStep) for step in plan.steps[number + 1 :]):
            return
        if self.operator is None or not self.operator.power_all("Power all modules again."):
            raise StepFailed("the modules were not powered again")
        scan = Scanner(self.master, plan.configuration).active(values=False, texts=False)
        for step in plan.steps[: number + 1]:
            entry = scan.entry(step.node)
            if isinstance(step, AttachStep) and entry.verdict != OK:
                raise StepFailed(f"{step.node} is {entry.verdict}: {entry.detail}")
