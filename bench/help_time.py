"""Time of ``thorvaldc --help`` relative to the smallest typer program.

The help needs only the command table, so it should cost little more than typer itself.
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
    ours, bare, without_rich = side_by_side(
        [
            python("-m", "thorvaldc", "--help"),
            python("-c", BARE, "--help"),
            python("-c", plain, "--help"),
        ],
        rounds=21,
    )
    yield Figure(
        "--help over bare typer",
        ours / bare,
        "",
        1.15,
        "lower",
        f"{ours * 1e3:.0f} ms, a typer program of one command {bare * 1e3:.0f} ms"
        f" (with rich's help off {without_rich * 1e3:.0f} ms); whole processes in turns,"
        " medians of 21",
    )
