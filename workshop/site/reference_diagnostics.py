"""The index of all diagnostic codes."""

from __future__ import annotations

import re
from itertools import groupby

from thorvaldc.diagnostics import codes


def page() -> str:
    table = sorted(codes.CODES.values(), key=lambda code: code.number)
    lines = [
        "# Diagnostics",
        "",
        f"All {len(table)} codes. `thorvaldc explain CODE` prints the page of a code. A code never"
        " changes its meaning; the number of a removed code is not used again. In the examples of a"
        " page, the lines with `-` raise the diagnostic, and those with `+` do not.",
    ]
    for digit, group in groupby(table, key=lambda code: re.sub(r"\D", "", code.number)[0]):
        lines += ["", f"## {codes.SUBJECTS[digit]}", ""]
        lines += ["| code | severity | name | what it reports |", "| --- | --- | --- | --- |"]
        for code in group:
            cells = (f"[{code.number}]({code.number}.md)", code.severity, f"`{code.name}`")
            lines.append("| " + " | ".join((*cells, code.summary.replace("|", "\\|"))) + " |")
    return "\n".join(lines) + "\n"
