"""A DBC file of a CAN bus, for tools that read the DBC format."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Iterator
from typing import Any

from thorvaldc.diagnostics import CODES, Diagnostic
from thorvaldc.model.robot import Bus, FrameDefinition, Signal

ENCODING = "cp1252"  # the encoding that readers of DBC files assume


def lost_texts(bus: Bus) -> Iterator[Diagnostic]:
    """Yield a diagnostic for each CAN frame whose texts a DBC file cannot encode."""
    for frame in bus.frames:
        texts = [frame.description]
        for signal in frame.signals:
            texts += (signal.description, signal.unit)
        text = "".join(texts)
        missing = [] if text.isascii() else [c for c in dict.fromkeys(text) if not _in_dbc(c)]
        if missing:
            yield Diagnostic(
                CODES["dbc-text"],
                f"the texts of `{frame.name}` have characters that a DBC file cannot "
                f"hold: {' '.join(missing[:8])}",
                frame.span,
                "they are `?` there; the CAN map has them all",
            )


def _in_dbc(character: str) -> bool:
    try:
        character.encode(ENCODING)
    except UnicodeEncodeError:
        return False
    return True


def dbc_text(bus: Bus) -> str:
    """Return the DBC file of a CAN bus as text. The Python package cantools generates the text of
    the DBC file."""
    db = _cantools_database()
    can = db.can

    class Message(can.Message):  # type: ignore[misc,name-defined]
        """A cantools message that is only written to a DBC file and never decoded.

        The class skips the steps of a cantools message that are only needed to decode CAN frames.
        The decoding steps would take two thirds of the time to build the DBC file.
        """

        def __deepcopy__(self, memo: dict[int, Any]) -> Message:
            return self  # cantools copies a message to change names; the copy is not needed

        def refresh(self, strict: bool | None = None) -> None:
            """Skip the creation of the codecs and the check of the signal layout.

            The compiler has already checked that the signals of a CAN frame do not overlap.
            """

    nodes = [can.Node("master", "Master of the bus: the base driver.")] + [
        can.Node(
            node.name,
            _plain(f"{node.module}: {node.protocol}, id {node.id} of {node.id_space}"),
        )
        for node in bus.nodes
    ]
    messages = [
        Message(
            frame.cob_id,
            frame.name,
            frame.length,
            _dbc_signals(db, frame),
            comment=_plain(frame.description) or None,
            senders=[frame.producer],
            # The DBC attribute for the period of a CAN frame can only contain whole milliseconds.
            # The file canmap.json contains the exact period of the CAN frame.
            cycle_time=max(1, min(round(frame.period * 1000), 0xFFFF)) if frame.period else None,
            strict=True,
            sort_signals=None,
        )
        for frame in bus.frames
    ]
    dbc = importlib.import_module(f"{can.__name__}.formats.dbc")
    database = can.Database(
        messages=messages,
        nodes=nodes,
        buses=[can.Bus(bus.name, None, bus.bitrate)],
        version="",
        dbc_specifics=dbc.DbcSpecifics(),
        sort_signals=None,
    )
    text: str = database.as_dbc_string(sort_signals=None)
    return text


def _dbc_signals(db: Any, frame: FrameDefinition) -> list[Any]:
    selector = next((s.name for s in frame.signals if s.multiplexer), None)
    signals = []
    for signal in frame.signals:
        low, high = _limits(signal)
        comment = signal.description
        if signal.joint is not None:
            comment = f"{comment} Joint {signal.joint}.".strip()
        signals.append(
            db.can.Signal(
                signal.name,
                signal.start,
                signal.length,
                is_signed=signal.signed,
                conversion=db.conversion.BaseConversion.factory(
                    _number(signal.scale),
                    _number(signal.offset),
                    {raw: _plain(name) for raw, name in signal.choices} or None,
                    signal.floating_point,
                ),
                minimum=low,
                maximum=high,
                unit=_plain(signal.unit) or None,
                comment=_plain(comment) or None,
                receivers=list(frame.consumers),
                is_multiplexer=signal.multiplexer,
                multiplexer_ids=list(signal.selected_by) or None,
                multiplexer_signal=selector if signal.selected_by else None,
            )
        )
    return signals


def _limits(signal: Signal) -> tuple[float | None, float | None]:
    """Return the minimum and maximum of a CAN signal, or ``None`` for both if the signal has no
    limits.

    The DBC format cannot omit only one limit of a signal: a missing limit would be written as 0. A
    missing limit of a signal is therefore computed from the length of the signal in bits.
    """
    if signal.minimum is None and signal.maximum is None:
        return None, None
    ends = sorted(raw * signal.scale + signal.offset for raw in signal.raw_range)
    return (
        ends[0] if signal.minimum is None else signal.minimum,
        ends[1] if signal.maximum is None else signal.maximum,
    )


def _number(value: float) -> float | int:
    return int(value) if value.is_integer() else value


def _plain(text: str) -> str:
    """Return the text on one line, without quotes and backslashes, which DBC strings cannot
    contain."""
    return " ".join(text.replace("\\", "/").replace('"', "'").split())


def _cantools_database() -> Any:
    """Import and return ``cantools.database`` without the other modules of the package
    ``cantools``.

    The import of the package ``cantools`` also imports the CAN tester of cantools. The CAN tester
    imports python-can, asyncio and ssl, which takes two thirds of the import time, and the compiler
    needs none of them. This function therefore registers ``cantools`` in ``sys.modules`` without
    executing the package. Python executes the package ``cantools`` when another name of the package
    is used for the first time.
    """
    spec = importlib.util.find_spec("cantools") if "cantools" not in sys.modules else None
    if spec is not None and spec.loader is not None:
        loader, package = spec.loader, importlib.util.module_from_spec(spec)

        def load_the_rest(name: str) -> Any:
            vars(package).pop("__getattr__", None)
            loader.exec_module(package)
            return getattr(package, name)

        vars(package)["__getattr__"] = load_the_rest
        sys.modules["cantools"] = package
    return importlib.import_module("cantools.database")
