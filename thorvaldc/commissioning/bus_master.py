"""The one master's place on a bus: what it sends, and a judgement of every frame it sees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import CanFrame, worst_case_bits
from thorvaldc.can.interface import CanInterface
from thorvaldc.can.nanoseconds import NANOSECONDS
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.bus import Bus

MASTER = "master"
NMT, SYNC, TIME_STAMP, LSS_REQUEST, LSS_RESPONSE = 0x000, 0x080, 0x100, 0x7E5, 0x7E4
SDO_RESPONSE, SDO_REQUEST, HEARTBEAT = 0x580, 0x600, 0x700
OPERATIONAL = 5
HIGHEST_ID = 127


@dataclass(frozen=True, slots=True)
class Timing:
    """How long (s) answers are waited for.

    ``settle`` is how long after a first answer others are waited for, ``absent`` how long for
    an answer that should not come; ``probe_gap`` is the time between two probes of ids that may
    belong to nobody, ``probe_tail`` that for late answers after the last.
    """

    sdo: float = 0.5
    lss: float = 0.1
    fastscan: float = 0.02
    store: float = 5.0
    boot: float = 5.0
    settle: float = 0.005
    absent: float = 0.1
    probe_gap: float = 0.004
    probe_tail: float = 0.25


class BusMaster:
    """Sends for the master, and sorts what comes.

    While it is ``exclusive``, a frame that only a master sends stops everything, as does an
    error state of the own controller.

    Raises ``DiagnosticError`` (``bus-error``, ``bus-other-master``) from all that waits.
    """

    def __init__(self, port: CanInterface, bus: Bus, timing: Timing | None = None) -> None:
        self.port = port
        self.bus = bus
        self.timing = timing or Timing()
        self.exclusive = False
        self.masters: dict[str, int] = {}
        self.heard: dict[int, list[float]] = {}
        self.states: dict[int, int] = {}
        self.boots: list[int] = []
        self.frames = 0
        self.bits = 0
        self.surplus: dict[int, int] = {}
        """By node: answers to SDO requests beyond one for each."""
        self._open_requests: dict[int, int] = {}
        self._from_master: dict[int, str] = {}
        self._from_nodes: dict[int, str] = {}
        for frame in bus.frames:
            who = self._from_master if frame.producer == MASTER else self._from_nodes
            who[frame.cob_id] = frame.name
        self._foreign = {f.cob_id for f in bus.frames if f.kind != "sdo"}

    @property
    def now(self) -> float:
        return self.port.now

    # -- sending ----------------------------------------------------------------------------

    def send(self, identifier: int, data: bytes) -> None:
        """Raises ``DiagnosticError`` where the frame cannot be sent; nothing is tried again."""
        self._check_state()
        try:
            sent = self.port.send(CanFrame(identifier, data), timeout=0.1)
        except ConnectionError as fault:
            raise lost(fault) from None
        self._check_state()
        if not sent:
            raise DiagnosticError(
                "bus-error",
                f"the frame {identifier:#05x} could not be sent: the queue stays full",
                hint="are the devices under power, and is the bitrate theirs?",
            )

        if SDO_REQUEST < identifier <= SDO_REQUEST + HIGHEST_ID:
            self._open_requests[identifier - SDO_REQUEST] = 1

    def nmt(self, command: int, node: int) -> None:
        self.send(NMT, bytes([command, node]))

    # -- waiting ----------------------------------------------------------------------------

    def collect(
        self, wanted: Callable[[CanFrame], bool], timeout: float, settle: float | None = None
    ) -> list[CanFrame]:
        """Every frame that is ``wanted``: until ``settle`` s after the first, ``timeout`` without.

        ``settle`` ``None``: all of the time-out, for those who may be late.
        """
        found: list[CanFrame] = []
        limit = self.now + timeout
        while True:
            frame = self._next(limit - self.now)
            if frame is None:
                return found
            if wanted(frame):
                if not found and settle is not None:
                    limit = min(limit, self.now + settle)
                found.append(frame)

    def ask(
        self,
        identifier: int,
        data: bytes,
        wanted: Callable[[CanFrame], bool],
        timeout: float,
        settle: float | None,
    ) -> list[CanFrame]:
        """Send a request and collect every answer."""
        self._drain()
        self.send(identifier, data)
        return self.collect(wanted, timeout, settle)

    def listen(self, seconds: float) -> None:
        """Only watch."""
        self.collect(lambda frame: False, seconds)

    def wait_for_boots(self, ids: list[int], timeout: float) -> list[int]:
        """Those of ``ids`` that have not said that they have started; each must do so once."""
        missing = list(ids)
        limit = self.now + timeout
        while missing:
            for node in self.boots:
                if node in missing:
                    missing.remove(node)
            self.boots.clear()
            if not missing or self._next(limit - self.now) is None:
                break
        return missing

    def wait_for_count(self, count: int, timeout: float) -> None:
        """Until so many nodes have said that they have started, at whatever ids."""
        limit = self.now + timeout
        while len(self.boots) < count and self._next(limit - self.now) is not None:
            pass

    def forget(self) -> None:
        """What was heard so far; what waits in the queue with it."""
        self._drain()
        self.heard.clear()
        self.states.clear()
        self.boots.clear()
        self.masters.clear()
        self.surplus.clear()

    # -- inside -----------------------------------------------------------------------------

    def _next(self, timeout: float) -> CanFrame | None:
        try:
            received = self.port.receive(max(timeout, 0.0))
        except ConnectionError as fault:
            raise lost(fault) from None
        self._check_state()
        if received is None:
            return None
        if received.own:
            return CanFrame(0x7FF)
        self._judge(received.frame, received.time / NANOSECONDS)
        return received.frame

    def _drain(self) -> None:
        while self._next(0.0) is not None:
            pass

    def _judge(self, frame: CanFrame, time: float) -> None:
        self.frames += 1
        self.bits += worst_case_bits(frame.length, frame.extended)
        if frame.extended:
            return
        self.heard.setdefault(frame.id, []).append(time)
        if HEARTBEAT < frame.id <= HEARTBEAT + HIGHEST_ID and len(frame.data) == 1:
            node = frame.id - HEARTBEAT
            self.states[node] = frame.data[0] & 0x7F
            if frame.data[0] == 0:
                self.boots.append(node)
        elif SDO_RESPONSE < frame.id <= SDO_RESPONSE + HIGHEST_ID:
            node = frame.id - SDO_RESPONSE
            if not self._open_requests.get(node, 0) and frame.id not in self._foreign:
                self.surplus[node] = self.surplus.get(node, 0) + 1
            self._open_requests[node] = 0
        sign = self._sign_of_master(frame)
        if sign:
            self.masters[sign] = self.masters.get(sign, 0) + 1
            if self.exclusive:
                raise other_master_error([sign])

    def _sign_of_master(self, frame: CanFrame) -> str:
        """What of a frame only a master sends; empty for others' frames."""
        identifier = frame.id
        if identifier in self._from_nodes:
            return ""
        if identifier in self._from_master:
            return self._from_master[identifier]
        if identifier in (NMT, SYNC, TIME_STAMP, LSS_REQUEST):
            return f"{identifier:#05x}"
        if SDO_REQUEST < identifier <= SDO_REQUEST + HIGHEST_ID:
            return f"an SDO request to node {identifier - SDO_REQUEST}"
        if identifier == HEARTBEAT + self.bus.master_id:
            return "a master's heartbeat"
        return ""

    def _check_state(self) -> None:
        state = self.port.state
        if state is not ErrorState.ACTIVE:
            raise DiagnosticError(
                "bus-error",
                f"the interface is {state.value}: frames do not get through",
                hint="is the bus under power and terminated, and is the bitrate "
                f"{self.bus.bitrate // 1000} kbit/s that of all devices? Nothing was tried again",
            )


def lost(fault: ConnectionError) -> DiagnosticError:
    return DiagnosticError(
        "bus-error", f"the bus is gone: {fault}", hint="nothing more was sent; look at the bus"
    )


def other_master_error(signs: list[str]) -> DiagnosticError:
    return DiagnosticError(
        "bus-other-master",
        f"another master is on the bus: {', '.join(signs)} was seen",
        hint="stop the driver, or whatever program uses the bus, and begin again",
    )
