"""Writes values to the object dictionary of a node.

Objects are written in the order that CiA 301 requires for changes of PDO parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from thorvaldc.commissioning.bus_configuration import ParameterValue
from thorvaldc.commissioning.sdo_client import SdoAborted, SdoClient

SAVE = 0x65766173
"""Value that starts storing when written to object 0x1010: the ASCII text `save`."""
STORE_PARAMETERS = 0x1010
INVALID = 1 << 31
"""Bit in the COB-ID entry of a PDO that disables the PDO."""
PDOS = range(0x1400, 0x1C00)
"""Indices of PDO objects: communication (from 0x1400, 0x1800) and mapping (with bit 0x200)."""
MAPPING = 0x200

PresentValues = Mapping[tuple[int, int], int | None]
"""Values of objects by index and subindex; ``None`` if the node refuses to read an object."""


class ObjectWriter:
    """Reads and writes the object dictionary of nodes by SDO."""

    def __init__(self, sdo: SdoClient) -> None:
        self.sdo = sdo

    def read(
        self, node: int, values: Sequence[ParameterValue]
    ) -> dict[tuple[int, int], int | None]:
        """Reads the present values of the objects in ``values`` from a node.

        The returned value is ``None`` if the node refuses to read the object.  Raises
        ``SdoTimeout`` if no node responds, or ``SdoMultipleResponses`` if more than one node
        responds.
        """
        present: dict[tuple[int, int], int | None] = {}
        for value in values:
            try:
                present[value.key] = self.sdo.read_number(node, *value.key, value.type)
            except SdoAborted:
                present[value.key] = None
        return present

    def write(self, node: int, values: Sequence[ParameterValue], present: PresentValues) -> None:
        """Writes all object values that differ from ``present`` to a node, and reads each written
        value back.

        A PDO is disabled while the parameters of the PDO are written.  The number of mapped objects
        of a PDO is set to 0 while the PDO mapping is written.  Raises ``SdoAborted`` if the node
        refuses a value that is written.  Raises ``SdoTimeout`` if no node responds, or
        ``SdoMultipleResponses`` if more than one node responds.
        """
        differing = [value for value in values if present.get(value.key) != value.value]
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
        changed: Sequence[ParameterValue],
        present: PresentValues,
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
        changed: Sequence[ParameterValue],
        present: PresentValues,
    ) -> ParameterValue:
        """Returns the value that an object has after all ``changed`` values are written.

        The present value is returned for an object that is not in ``changed``.
        """
        for value in changed:
            if value.key == (index, subindex):
                return value
        number = present.get((index, subindex))
        if number is None:
            number = self.sdo.read_number(node, index, subindex, type_name)
        return ParameterValue("", index, subindex, type_name, number)

    def _write(self, node: int, value: ParameterValue) -> None:
        self.sdo.write_number(node, *value.key, value.type, value.value)
        read_back = self.sdo.read_number(node, *value.key, value.type)
        if read_back != value.value:
            raise WriteIgnored(value, read_back)


class WriteIgnored(SdoAborted):
    """Error: a node has accepted a write request, but the object has another value afterwards."""

    def __init__(self, value: ParameterValue, read_back: int) -> None:
        Exception.__init__(
            self, f"{value.label} was written as {value.value:#x} and reads {read_back:#x}"
        )
        self.code = 0
