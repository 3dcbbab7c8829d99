"""The command ``thorvaldc targets``: lists the targets of ``thorvaldc build``."""

from __future__ import annotations

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE


def targets(json: options.Json = False) -> int:
    from thorvaldc import backends
    from thorvaldc.cli.diagnostic_output import print_json, print_table

    summaries: dict[str, str] = {}
    for name in backends.names():
        try:
            summaries[name] = backends.load(name).summary
        except backends.TargetError as error:
            summaries[name] = str(error)
    if json:
        print_json(summaries)
    else:
        print_table(
            (name, summary if name in backends.DEFAULT_TARGETS else f"{summary} (not by default)")
            for name, summary in summaries.items()
        )
    return DONE
