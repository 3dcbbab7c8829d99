"""The command ``thorvaldc diff``: compares two robots or fleets."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT


def diff(
    before: Annotated[
        str,
        typer.Argument(
            metavar="A",
            help=options.ANY_MODEL,
        ),
    ],
    after: Annotated[str, typer.Argument(metavar="B", help="The robot to compare with A.")],
    format: options.ResultFormat = "text",
    json: options.Json = False,
    everything: Annotated[
        bool, typer.Option("--all", help="List derived values as well, such as poses and shapes.")
    ] = False,
    html: Annotated[
        str,
        typer.Option("--html", metavar="OUT.html", help="Write a page that shows both robots."),
    ] = "",
    exit_code: Annotated[
        bool, typer.Option("--exit-code", help="End with the exit status 1 if A and B differ.")
    ] = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.diagnostic_output import (
        RESULT_FORMATS,
        check_format,
        message,
        print_json,
        show_report,
    )
    from thorvaldc.cli.run_pictures import check_output
    from thorvaldc.comparison.difference_text import (
        difference_document,
        difference_markdown,
        difference_text,
    )
    from thorvaldc.diagnostics.atomic_file import write_file
    from thorvaldc.tools.comparison.compared_inputs import (
        InputKindError,
        compare,
        read_input,
        revision_hint,
    )

    check_format(format, RESULT_FORMATS)
    if html:
        check_output(html, ["html", "htm"], "--html")
    folders = options.library_folders(library)
    inputs = []
    models = []
    with ExitStack() as temporary:
        for name in (before, after):
            compared = read_input(name, temporary, folders, trust=trust)
            status = show_report(compared.report, compared.sources)
            if compared.model is None and (hint := revision_hint(before, after)) is not None:
                message(f"hint: {hint}")
            if compared.model is None:
                return status or INPUT
            inputs.append(compared)
            models.append(compared.model)
    try:
        difference = compare(*inputs)
    except InputKindError as error:
        raise typer.BadParameter(str(error), param_hint="'A' / 'B'") from None
    if html:
        # The page is imported only when it is used, because it imports numpy.
        from thorvaldc.tools.comparison.difference_page import difference_page

        page = difference_page(difference, *models)
        write_file(Path(html), page)
        message(html)
    if json or format == "json":
        print_json(difference_document(difference))
    elif format == "markdown":
        sys.stdout.write(difference_markdown(difference, everything=everything))
    else:
        sys.stdout.write(difference_text(difference, everything=everything))
    return INPUT if exit_code and not difference.is_equal else DONE
