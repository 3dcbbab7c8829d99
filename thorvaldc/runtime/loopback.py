"""Web servers for the browser of this computer alone: which requests come from their own page.

Any page of the internet can send requests to this computer.  ``Origin`` shows where it is from; if
a name of the internet points to this computer (DNS rebinding), ``Host`` shows that.
"""

from __future__ import annotations

import os
import socket

from thorvaldc.diagnostics import OutsideError

HOST = "127.0.0.1"
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline';"
    " style-src 'unsafe-inline'; connect-src 'self'; frame-ancestors 'none'; base-uri 'none';"
    " form-action 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Headers of each page: it loads nothing from elsewhere, and no other page may contain it."""


def refusal(host: str | None, origin: str | None, port: int) -> str:
    """Returns why a request with these headers is refused by the server at ``port``, or no text."""
    hosts = {f"{name}:{port}" for name in (HOST, "localhost")}
    if host not in hosts:
        return "the host is not this computer"
    if origin is not None and origin.removeprefix("http://") not in hosts:
        return "the page comes from another server"
    return ""


def listen(port: int, option: str) -> socket.socket:
    """Returns a socket that listens on the loopback interface at ``port`` (0: any free port).

    ``option``: option of the command line that states the port.  Raises ``OutsideError``.
    """
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        # The text of Python's error repeats the address.
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise OutsideError(
            f"port {port} of {HOST} cannot be used: {reason}; {option} names another one"
        ) from None
