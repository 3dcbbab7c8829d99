"""The result of the compilation of one file for the command ``check``, and that of many files."""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from thorvaldc.diagnostics import Report
    from thorvaldc.model import Fleet, Robot

FILES_OF_PROCESSES = 20
"""Least number of files that are checked in several processes."""


class CheckedFile(NamedTuple):
    """What ``check`` prints about a file.

    - ``file``: path as the user wrote it.
    - ``report``: diagnostics, and accepted warnings.
    - ``sources``: path of the input file for each path in ``report``.
    - ``summary``: name of the model and its size, or empty if the file has errors.
    - ``missing_limits``: limits that this system does not give to the readers of xacro and meshes.
    """

    file: str
    report: Report
    sources: dict[str, Path]
    summary: str
    missing_limits: tuple[str, ...]


def check_file(file: str, library: Sequence[Path], trust: bool) -> CheckedFile:
    """Compiles a file; the parameters are those of ``compile_file``."""
    from thorvaldc.compiler.pipeline import compile_file
    from thorvaldc.compiler.sandbox import missing_limits

    compilation = compile_file(file, library=library, trust=trust)
    model = compilation.model
    summary = "" if model is None else f"{model.name}, {_summary(model)}"
    return CheckedFile(
        file, compilation.report, compilation.sources, summary, tuple(missing_limits)
    )


def check_files(
    files: Sequence[str], library: Sequence[Path], trust: bool
) -> Iterator[CheckedFile]:
    """Yields the result of each file in the given order.

    ``FILES_OF_PROCESSES`` files or more are compiled in one process per processor.  If such a
    process ends early, for example because the computer has no memory left, this process compiles
    the remaining files.
    """
    number = 0
    if len(files) >= FILES_OF_PROCESSES:
        from concurrent.futures.process import BrokenProcessPool

        try:
            for checked in _of_processes(files, library, trust):
                yield checked
                number += 1
        except BrokenProcessPool:
            pass
    with ExitStack() as stack:
        if len(files) - number > 1:
            from thorvaldc.compiler.pipeline import many_compilations

            stack.enter_context(many_compilations())
        for file in files[number:]:
            yield check_file(file, library, trust)


def _of_processes(
    files: Sequence[str], library: Sequence[Path], trust: bool
) -> Iterator[CheckedFile]:
    from thorvaldc.simulation.worker_processes import ignored_interrupts, processors, worker_pool

    count = processors()
    if count == 1:
        return
    check = partial(check_file, library=library, trust=trust)
    yield check(files[0])  # which loads the modules of the compiler for all forked processes
    batch = min(20, 1 + len(files) // (8 * count))
    with worker_pool(count, _prepare, may_fork=True) as pool:
        with ignored_interrupts():
            results = pool.map(check, files[1:], chunksize=batch)
        yield from results


_open = ExitStack()


def _prepare() -> None:
    from thorvaldc.compiler.pipeline import many_compilations

    gc.disable()  # as in the process of the command
    _open.enter_context(many_compilations())


def _summary(model: Robot | Fleet) -> str:
    """Returns a summary of a robot, such as ``4 wheels (4 driven, 4 steered), 213.4 kg``."""
    from thorvaldc.cli.diagnostic_output import count
    from thorvaldc.model import Fleet

    if isinstance(model, Fleet):
        return count(len(model.placements), "robot")
    driven = sum(1 for wheel in model.wheels if wheel.driven)
    steered = sum(1 for wheel in model.wheels if wheel.steered)
    wheels = count(len(model.wheels), "wheel")
    return f"{wheels} ({driven} driven, {steered} steered), {model.inertial.mass:.1f} kg"
