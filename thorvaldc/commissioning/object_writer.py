"""Writing the values of a node, in the order in which CiA 301 lets PDOs be changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from thorvaldc.commissioning.bus_configuration import ParameterValue
from thorvaldc.commissioning.sdo_client import SdoAborted, SdoClient

SAVE = 0x65766173
STORE_PARAMETERS = 0x1010
INVALID = 1 << 31
PDOS = range(0x1400, 0x1C00)
MAPPING = 0x200

Read = Mapping[tuple[int, int], int | None]


class ParameterWriter:
    def __init__(self, sdo: SdoClient) -> None:
        self.sdo = sdo

    def read(
        self, node: int, values: Sequence[ParameterValue]
    ) -> dict[tuple[int, int], int | None]:
        """Present values, ``None`` where reading is refused.

        Raises ``SdoTimeout``, ``SdoMultipleResponses``.
        """
        found: dict[tuple[int, int], int | None] = {}
        for value in values:
            try:
                found[value.place] = self.sdo.number(node, *value.place, value.type)
            except SdoAborted:
                found[value.place] = None
        return found

    def write(self, node: int, values: Sequence[ParameterValue], read: Read) -> None:
        """Write those that differ and read each back.

        A PDO is switched off while its parameters change, a mapping emptied while its entries
        do.  Raises ``SdoAborted``, ``SdoTimeout``, ``SdoMultipleResponses``.
        """
        differing = [v for v in values if read.get(v.place) != v.value]
        plain = [v for v in differing if v.index not in PDOS]
        for value in plain:
            self._write(node, value)
        pdos = dict.fromkeys(v.index & ~MAPPING for v in differing if v.index in PDOS)
        for base in pdos:
            changed = [v for v in differing if v.index in (base, base | MAPPING)]
            self._write_pdo(node, base, changed, read)

    def save(self, node: int) -> None:
        """Raises as ``write`` does, with a time-out for slow memories."""
        timeout = self.sdo.master.timing.store
        self.sdo.write(node, STORE_PARAMETERS, 1, "unsigned32", SAVE, timeout)

    def _write_pdo(
        self,
        node: int,
        base: int,
        changed: Sequence[ParameterValue],
        read: Read,
    ) -> None:
        switch = self._whole(node, base, 1, "unsigned32", changed, read)
        now = read.get((base, 1))
        self._write(node, replace(switch, value=(switch.value if now is None else now) | INVALID))
        mapping = [v for v in changed if v.index == base | MAPPING]
        if mapping:
            count = self._whole(node, base | MAPPING, 0, "unsigned8", changed, read)
            self.sdo.write(node, base | MAPPING, 0, "unsigned8", 0)
            for value in mapping:
                if value.subindex:
                    self._write(node, value)
            self._write(node, count)
        for value in changed:
            if value.index == base and value.subindex != 1:
                self._write(node, value)
        self._write(node, switch)

    def _whole(
        self,
        node: int,
        index: int,
        subindex: int,
        type_name: str,
        changed: Sequence[ParameterValue],
        read: Read,
    ) -> ParameterValue:
        """The entry as it is to be: changed, or as it is."""
        for value in changed:
            if value.place == (index, subindex):
                return value
        now = read.get((index, subindex))
        if now is None:
            now = self.sdo.number(node, index, subindex, type_name)
        return ParameterValue("", index, subindex, type_name, now)

    def _write(self, node: int, value: ParameterValue) -> None:
        self.sdo.write(node, *value.place, value.type, value.value)
        back = self.sdo.number(node, *value.place, value.type)
        if back != value.value:
            raise WriteIgnored(value, back)


class WriteIgnored(SdoAborted):
    """The node took the value, and has another."""

    def __init__(self, value: ParameterValue, back: int) -> None:
        Exception.__init__(
            self, f"{value.shown} was written as {value.value:#x} and reads {back:#x}"
        )
        self.code = 0
