"""Time of ``thorvaldc --help`` relative to the smallest typer program.

The help imports all commands, so it takes the time of typer and of their signatures.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator

from bench.figure import Figure, in_turns, process, python

BARE = """
import typer
app = typer.Typer()
@app.command()
def hello(name: str = "world"):
    "Say hello."
app()
"""


def figures() -> Iterator[Figure]:
    plain = BARE.replace("Typer()", "Typer(rich_markup_mode=None)")
    times = in_turns(
        process(python("-m", "thorvaldc", "--help")),
        process(python("-c", BARE, "--help")),
        process(python("-c", plain, "--help")),
        rounds=21,
    )
    thorvaldc_time, bare, without_rich = (1e3 * statistics.median(t) for t in times)
    yield Figure.ratio(
        "--help over bare typer",
        1.15,
        zip(times[0], times[1], strict=True),
        f"{thorvaldc_time:.0f} ms, a typer program of one command {bare:.0f} ms (without the help"
        f" of rich {without_rich:.0f} ms); processor times of whole processes",
    )
