"""Executes the steps of a commissioning plan.

For each step the executor checks a precondition, writes to the node, and reads the result back.
Sequence of an ``AddressStep``, with the records in the journal:

    check      no node answers SDO at the new id
    journal    begin
    LSS        select identity, compare its id with ``before``, configure id
    SDO        device type (0x1000)              only a node that had no id: it uses the id now
    LSS        select identity, store
    NMT        reset node                        the stored id takes effect
    wait       boot-up message with the new id
    check      exactly one node answers at the new id, with this identity
    journal    done

The node is reset to verify that the node id is stored.  After a power cut before the LSS command
"store", the node has the old node id.  After a power cut after the LSS command "store", the node
has the new node id.  The option ``--resume`` can continue after every power cut, because the plan
contains the old and the new node id.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from thorvaldc.can.canopen import NmtCommand
from thorvaldc.can.lss import UNCONFIGURED, Identity
from thorvaldc.commissioning import bus_configuration, scan_result
from thorvaldc.commissioning.bus_master import BusMaster, SdoAborted, SdoClient
from thorvaldc.commissioning.journal import Journal
from thorvaldc.commissioning.lss_master import LssMaster
from thorvaldc.commissioning.plan import AddressStep, AttachStep, ConfigureStep, Plan, PlanStep
from thorvaldc.commissioning.scanner import DEVICE_TYPE, IDENTITY, Scanner

# -- object dictionary -----------------------------------------------------------------------------

# Objects are written in the order that CiA 301 requires for changes of PDO parameters.

SAVE = 0x65766173
"""Value that starts storing when written to object 0x1010: the ASCII text `save`."""
STORE_PARAMETERS = 0x1010
INVALID = 1 << 31
"""Bit in the COB-ID entry of a PDO that disables the PDO."""
PDOS = range(0x1400, 0x1C00)
"""Indices of PDO objects: communication (from 0x1400, 0x1800) and mapping (with bit 0x200)."""
MAPPING = 0x200


class ObjectWriter:
    """Writes the object dictionary of nodes by SDO."""

    def __init__(self, sdo: SdoClient) -> None:
        self.sdo = sdo

    def write(
        self,
        node: int,
        values: Sequence[bus_configuration.ParameterValue],
        present: bus_configuration.PresentValues,
    ) -> None:
        """Writes all object values that differ from ``present`` to a node, and reads each written
        value back.

        A PDO is disabled while the parameters of the PDO are written.  The number of mapped objects
        of a PDO is set to 0 while the PDO mapping is written.  Raises ``SdoAborted`` if the node
        refuses a value that is written.  Raises ``SdoTimeout`` if no node responds, or
        ``SdoMultipleResponses`` if more than one node responds.
        """
        differing = bus_configuration.differing_values(values, present)
        for value in differing:
            if value.index not in PDOS:
                self._write(node, value)
        pdos = dict.fromkeys(value.index & ~MAPPING for value in differing if value.index in PDOS)
        for base in pdos:
            changed = [value for value in differing if value.index in (base, base | MAPPING)]
            self._write_pdo(node, base, changed, present)

    def save(self, node: int) -> None:
        """Stores the parameters of a node in non-volatile memory (object 0x1010).

        Raises the same exceptions as the method ``write``.
        """
        timeout = self.sdo.master.timing.store
        self.sdo.write_number(node, STORE_PARAMETERS, 1, "unsigned32", SAVE, timeout)

    def _write_pdo(
        self,
        node: int,
        base: int,
        changed: Sequence[bus_configuration.ParameterValue],
        present: bus_configuration.PresentValues,
    ) -> None:
        """Writes the mapping and the communication parameters of a PDO.

        The PDO is disabled before the first parameter is written.  The COB-ID of the PDO is written
        last, because writing the COB-ID enables the PDO again.
        """
        cob_id = self._final_value(node, base, 1, "unsigned32", changed, present)
        present_id = present.get((base, 1))
        off = (cob_id.value if present_id is None else present_id) | INVALID
        self._write(node, replace(cob_id, value=off))
        mapping = [value for value in changed if value.index == base | MAPPING]
        if mapping:
            count = self._final_value(node, base | MAPPING, 0, "unsigned8", changed, present)
            self.sdo.write_number(node, base | MAPPING, 0, "unsigned8", 0)
            for value in mapping:
                if value.subindex:
                    self._write(node, value)
            self._write(node, count)
        for value in changed:
            if value.index == base and value.subindex != 1:
                self._write(node, value)
        self._write(node, cob_id)

    def _final_value(
        self,
        node: int,
        index: int,
        subindex: int,
        type_name: str,
        changed: Sequence[bus_configuration.ParameterValue],
        present: bus_configuration.PresentValues,
    ) -> bus_configuration.ParameterValue:
        """Returns the value that an object has after all ``changed`` values are written.

        The present value is returned for an object that is not in ``changed``.
        """
        for value in changed:
            if value.key == (index, subindex):
                return value
        number = present.get((index, subindex))
        if number is None:
            number = self.sdo.read_number(node, index, subindex, type_name)
        return bus_configuration.ParameterValue("", index, subindex, type_name, number)

    def _write(self, node: int, value: bus_configuration.ParameterValue) -> None:
        self.sdo.write_number(node, *value.key, value.type, value.value)
        read_back = self.sdo.read_number(node, *value.key, value.type)
        if read_back != value.value:
            raise WriteIgnored(value, read_back)


class WriteIgnored(SdoAborted):
    """Error: a node has accepted a write request, but the object has another value afterwards."""

    def __init__(self, value: bus_configuration.ParameterValue, read_back: int) -> None:
        Exception.__init__(
            self, f"{value.label} was written as {value.value:#x} and reads {read_back:#x}"
        )
        self.code = 0


class Operator(Protocol):
    """Operator: the person who switches the power of modules and sets node ids with the tool of the
    manufacturer."""

    def attach(self, step: AttachStep, instructions: str) -> bool:
        """Asks the operator to execute a step of the plan, and waits until the operator has
        finished.

        Returns ``False`` if the operator declines the step.
        """

    def power_all(self, instructions: str) -> bool:
        """Asks the operator to power all modules.

        Returns ``False`` if the operator declines to power the modules.
        """


class StepFailed(Exception):
    """Error: a step of a commissioning plan failed.

    The message of the exception describes the detected difference.
    """


class StepExecutor:
    """Executes the steps of a commissioning plan, and records each step in the journal.

    ``nodes_at``: number of nodes at each node id.
    """

    def __init__(self, master: BusMaster, journal: Journal, operator: Operator | None) -> None:
        self.master = master
        self.journal = journal
        self.operator = operator
        self.sdo = SdoClient(master)
        self.lss = LssMaster(master)
        self.writer = ObjectWriter(self.sdo)
        self.nodes_at: Counter[int] = Counter()

    def run(
        self, number: int, step: PlanStep, configuration: bus_configuration.BusConfiguration
    ) -> None:
        """Executes the step with the index ``number`` in the commissioning plan.

        Raises ``StepFailed`` if a check of the step fails.  Raises ``LssError``, ``SdoAborted``,
        ``SdoTimeout`` or ``SdoMultipleResponses`` if a node does not respond as required.
        """
        if isinstance(step, AddressStep):
            self._check_free(step.after)
            self.journal.begin(number, step.node, step.description)
            self._set_address(step, configuration)
            self.journal.done(number, step.node, {"id": step.after})
        elif isinstance(step, ConfigureStep):
            self._configure(number, step)
        else:
            self._attach(number, step, configuration)
        for node_id in sorted(self.master.surplus):
            raise StepFailed(f"more answers than requests came from id {node_id}")

    def reset(self, ids: list[int], count: int) -> None:
        """Resets the nodes with the given node ids, so that each node loads its stored values.

        ``count``: number of nodes with the given node ids, and therefore of expected boot-up
        messages.
        """
        self.master.boots.clear()
        for node in ids:
            self.master.nmt(NmtCommand.RESET_NODE, node)
        # A node without node id sends no boot-up message, so the wait may end with the time-out.
        self.master.wait_for_count(count, self.master.timing.boot)
        self.master.listen(self.master.timing.absent / 4)

    # -- addresses ---------------------------------------------------------------------------

    def _check_free(self, node_id: int) -> None:
        if node_id == UNCONFIGURED:
            return
        if self.sdo.upload_all(node_id, DEVICE_TYPE, 0, timeout=self.master.timing.absent):
            raise StepFailed(f"another device already has the id {node_id}")

    def _set_address(
        self, step: AddressStep, configuration: bus_configuration.BusConfiguration
    ) -> None:
        lss = self.lss
        self._select(step.identity)
        present_id = lss.node_id()
        if present_id != step.before:
            raise StepFailed(f"it has the id {present_id}, not {step.before}")
        lss.configure_id(step.after)
        if step.before == UNCONFIGURED:
            # A node without node id uses a new node id immediately, without a reset.  Its type can
            # be read only now; the id is not stored yet.  The node is reset to verify that the new
            # node id is stored.
            self.master.boots.clear()
            lss.switch_to_waiting()
            self._wait_for_boots([step.after])
            self._check_type(step, configuration.node(step.node))
            self._select(step.identity)
            lss.store()
            lss.switch_to_waiting()
            self._restart(step.after, step.after)
        else:
            lss.store()
            lss.switch_to_waiting()
            self._restart(step.before, step.after)
        self.nodes_at[step.before] -= 1
        self.nodes_at[step.after] += 1
        if step.after == UNCONFIGURED:
            self._check_without_id(step.identity)
        else:
            self._check_identity(step.after, step.identity)

    def _select(self, identity: Identity) -> None:
        """Selects the only device with an identity by LSS."""
        self.lss.switch_to_waiting()
        count = self.lss.select(identity)
        if count != 1:
            devices = "no device answers" if count == 0 else f"{count} devices answer"
            raise StepFailed(f"{devices} as {scan_result.identity_text(identity)}")

    def _check_type(self, step: AddressStep, node: bus_configuration.NodeConfiguration) -> None:
        """Checks the type of a device whose node id is not stored, and takes the id away again if
        the type is wrong."""
        if node.device_type is None:
            return
        actual = self.sdo.read_number(step.after, DEVICE_TYPE, 0, "unsigned32")
        if actual != node.device_type:
            self._restart(step.after, UNCONFIGURED)
            self._check_without_id(step.identity)
            raise StepFailed(
                f"its device type is {actual:#x}, not {node.device_type:#x}; it gets no id"
            )

    def _restart(self, node: int, after: int) -> None:
        """Resets the node with the node id ``node`` and waits for its boot-up message.

        ``after``: node id that the node has after the reset.
        """
        self.master.boots.clear()
        self.master.nmt(NmtCommand.RESET_NODE, node)
        if after != UNCONFIGURED:
            # The reset also restarts all other nodes that have the old node id.
            others = [node] * (self.nodes_at[node] - 1) if node != after else []
            self._wait_for_boots([after, *others])

    def _wait_for_boots(self, ids: list[int]) -> None:
        missing = self.master.wait_for_boots(ids, self.master.timing.boot)
        if missing:
            raise StepFailed(f"no node has started with the id {missing[0]}")

    def _check_identity(self, node: int, identity: Identity | None) -> None:
        """Checks that exactly one node responds at a node id, and that the node has the required
        identity."""
        for subindex in (1, 2, 3, 4):
            required = None if identity is None else identity[subindex - 1]
            timeout = self.master.timing.sdo
            responses = self.sdo.upload_all(node, IDENTITY, subindex, timeout=timeout)
            if not responses:
                raise StepFailed(f"no node answers at id {node}")
            if len(responses) > 1:
                raise StepFailed(f"{len(responses)} nodes answer at id {node}")
            response = responses[0]
            if response.abort is None and required is not None:
                actual = int.from_bytes(response.data, "little")
                if actual != required:
                    raise StepFailed(
                        f"the device at id {node} has {actual:#x} in {IDENTITY:#x}:{subindex}, "
                        f"not {required:#x}"
                    )
            elif response.abort is not None and required:
                raise StepFailed(f"the device at id {node} does not report its identity")

    def _check_without_id(self, identity: Identity) -> None:
        """Checks by LSS that a device has no node id.

        A device without node id sends no boot-up message, so the device is polled by LSS.
        """
        limit = self.master.now + self.master.timing.boot
        while True:
            self.lss.switch_to_waiting()
            if self.lss.select(identity) == 1:
                break
            if self.master.now >= limit:
                raise StepFailed(f"no device answers as {scan_result.identity_text(identity)}")
        node_id = self.lss.node_id()
        self.lss.switch_to_waiting()
        if node_id != UNCONFIGURED:
            raise StepFailed(f"it still has the id {node_id}")

    # -- values ------------------------------------------------------------------------------

    def _configure(self, number: int, step: ConfigureStep) -> None:
        self._check_identity(step.id, step.identity)
        writer = self.writer
        present = self.sdo.read_values(step.id, step.values)
        differing = bus_configuration.differing_values(step.values, present)
        if not differing:
            self.journal.begin(number, step.node, step.description)
            self.journal.done(number, step.node, {"written": 0})
            return
        unreadable = [value.label for value in differing if present.get(value.key) is None]
        if unreadable:
            raise StepFailed(f"it has no object {', '.join(unreadable)}")
        previous = [dataclasses.replace(v, value=present[v.key] or 0) for v in differing]
        self.journal.begin(number, step.node, step.description, previous)
        writer.write(step.id, step.values, present)
        writer.save(step.id)
        self._restart(step.id, step.id)
        self._check_identity(step.id, step.identity)
        present = self.sdo.read_values(step.id, step.values)
        wrong = [value.label for value in bus_configuration.differing_values(step.values, present)]
        if wrong:
            raise StepFailed(f"after a reset {', '.join(wrong)} differs from the written value")
        self.journal.done(number, step.node, {"written": len(differing)})

    # -- steps of the operator ---------------------------------------------------------------

    def _attach(
        self, number: int, step: AttachStep, configuration: bus_configuration.BusConfiguration
    ) -> None:
        node = configuration.node(step.node)
        if self.operator is None:
            raise StepFailed("this step needs an operator")
        instructions = (
            f"Switch the power of all modules off, then power {node.module} alone. Set its node "
            f"id to {step.after} with its maker's tool, save it, and switch it off and on."
        )
        self.journal.begin(number, step.node, step.description)
        if not self.operator.attach(step, instructions):
            raise StepFailed("the operator declined the step")
        single_node = dataclasses.replace(configuration, nodes=(node,))
        scan = Scanner(self.master, single_node).active(values=False)
        answering = [entry for entry in scan.entries if entry.device is not None]
        if len(answering) != 1 or scan.duplicates:
            devices = "no device answers" if not answering else "more than one device answers"
            raise StepFailed(f"{devices}; {node.module} alone should")
        entry = answering[0]
        if entry.verdict in (scan_result.MISSING, scan_result.DUPLICATE) or entry.node != node.name:
            raise StepFailed(
                f"a device answers at id {entry.device_id}, not at {step.after} as {node.name}"
            )
        texts = [] if entry.device is None else list(entry.device.texts)
        read = {"id": step.after, "set_by": "the operator", "says": texts}
        self.journal.done(number, step.node, read)

    def power_all(self, plan: Plan, number: int) -> None:
        """Asks the operator to power all modules after the last attach step.

        A scan of the bus then checks that each node has the required node id.  ``number``: index of
        the executed ``AttachStep`` in the plan.
        """
        if any(isinstance(step, AttachStep) for step in plan.steps[number + 1 :]):
            return
        if self.operator is None or not self.operator.power_all("Power all modules again."):
            raise StepFailed("the modules were not powered again")
        scan = Scanner(self.master, plan.configuration).active(values=False, texts=False)
        for step in plan.steps[: number + 1]:
            entry = scan.entry(step.node)
            if isinstance(step, AttachStep) and entry.verdict != scan_result.OK:
                raise StepFailed(f"{step.node} is {entry.verdict}: {entry.detail}")
