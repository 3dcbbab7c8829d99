"""Runs the program ``base_driver`` in this process with wrong parameters.

``python -m tests.ros.wrong_parameters CASES`` prints the exit status and the errors of each case;
``CASES`` is a JSON array of parameters.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
from typing import Any

from thorvaldc.ros.base_driver import main


def answer(parameters: dict[str, Any]) -> tuple[int, str]:
    """Returns the exit status and what the program writes to stderr."""
    arguments = ["--ros-args"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={json.dumps(value)}"]
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors):
        status = main(["base_driver", *arguments])
    return status, errors.getvalue()


if __name__ == "__main__":
    print(json.dumps([answer(parameters) for parameters in json.loads(sys.argv[1])]))
