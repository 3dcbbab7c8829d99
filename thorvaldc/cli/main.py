"""The entry point, and the border that no exception crosses."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable

# Exit status.  1 and 2 are the user's to mend, 3 the world's, 70 ours.
DONE, INPUT, USAGE, OUTSIDE, INTERNAL = 0, 1, 2, 3, 70
INTERRUPTED, BROKEN_PIPE = 130, 141

TRACEBACK_VARIABLE = "THORVALDC_TRACEBACK"


class OutsideError(Exception):
    """The world failed (a disk, a display, a bus); the message is one line for the user."""


def protect(work: Callable[[], int]) -> int:
    """Run it; every way it can fail becomes one line on stderr and an exit status."""
    try:
        status = work()
        if sys.stdout is not None:
            sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the second one would find us leaving
        return _fail("interrupted", INTERRUPTED)
    except BrokenPipeError:
        # Whoever read our output has left; say nothing, here and at the interpreter's end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return BROKEN_PIPE
    except OutsideError as fault:
        return _fail(f"error: {fault}", OUTSIDE)
    except OSError as fault:
        return _fail(f"error: {_one_line(fault)}", OUTSIDE)


def run() -> None:
    """The ``thorvaldc`` command."""
    # A command makes a few megabytes, keeps most of them and ends: to look for garbage
    # would take a sixth of its time.  Commands that run for long switch it on again.
    gc.disable()
    for stream in (sys.stdout, sys.stderr):
        # A name in another alphabet must not fail on a terminal that cannot show it.
        if stream is not None and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    try:
        status = protect(_call)
    except Exception as fault:
        status = _internal(fault)
    try:
        sys.exit(status)
    finally:
        # What is still in the buffer goes nowhere if the reader is gone or the disk full.
        if status != DONE:
            _quiet_exit()


def _call() -> int:
    from thorvaldc.cli.app import app

    try:
        app(prog_name="thorvaldc")
    except SystemExit as done:
        return done.code if isinstance(done.code, int) else DONE
    return DONE


def _quiet_exit() -> None:
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def _fail(line: str, status: int) -> int:
    _traceback()
    print(line, file=sys.stderr)
    return status


def _traceback() -> None:
    if os.environ.get(TRACEBACK_VARIABLE):
        import traceback

        traceback.print_exc()


def _one_line(fault: OSError) -> str:
    name = f"{fault.filename}: " if fault.filename is not None else ""
    return f"{name}{fault.strerror or fault}"


def _internal(fault: Exception) -> int:
    from thorvaldc import __version__

    _traceback()
    what = " ".join(f"{type(fault).__name__}: {fault}".split())[:300]
    python = ".".join(str(n) for n in sys.version_info[:3])
    print(
        f"internal error: {what}\n"
        f"This is a fault of thorvaldc {__version__} (Python {python}, {sys.platform}), not of your"
        f" file; please report it.\n{TRACEBACK_VARIABLE}=1 shows where it happened.",
        file=sys.stderr,
    )
    return INTERNAL
