"""The entry point of the ``thorvaldc`` command."""

from __future__ import annotations

import gc
import os
import sys

from thorvaldc.cli.exits import DONE, INTERNAL, TRACEBACK_VARIABLE, protect, show_traceback


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


def _internal(fault: Exception) -> int:
    from thorvaldc import __version__

    show_traceback()
    what = " ".join(f"{type(fault).__name__}: {fault}".split())[:300]
    python = ".".join(str(n) for n in sys.version_info[:3])
    print(
        f"internal error: {what}\n"
        f"This is a fault of thorvaldc {__version__} (Python {python}, {sys.platform}), not of your"
        f" file; please report it.\n{TRACEBACK_VARIABLE}=1 shows where it happened.",
        file=sys.stderr,
    )
    return INTERNAL
