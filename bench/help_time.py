"""Time of ``thorvaldc --help`` relative to the smallest typer program.

The help needs only the command table, so it should take little more time than typer itself.
"""

from __future__ import annotations

from collections.abc import Iterator

from bench.figure import Figure, python, side_by_side

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
    thorvaldc_time, bare, without_rich = side_by_side(
        [
            python("-m", "thorvaldc", "--help"),
            python("-c", BARE, "--help"),
            python("-c", plain, "--help"),
        ],
        rounds=21,
    )
    yield Figure(
        "--help over bare typer",
        thorvaldc_time / bare,
        "",
        1.15,
        "lower",
        f"{thorvaldc_time * 1e3:.0f} ms, a typer program of one command {bare * 1e3:.0f} ms"
        f" (without the help of rich {without_rich * 1e3:.0f} ms); whole processes in turns,"
        " medians of 21",
        timed=True,
    )
