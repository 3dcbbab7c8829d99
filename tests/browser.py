"""Chromium without a display, as the tests of pages start it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from tests.outside_tools import path_of

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

OPTIONS = (
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
WAIT = 300_000
"""Time (ms) for what a page does on a busy machine."""


@contextlib.contextmanager
def chromium(*options: str) -> Iterator[Browser]:
    """Starts a browser.  Skips the test if it is not installed."""
    from playwright.sync_api import sync_playwright

    program = path_of("chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=[*OPTIONS, *options])
        yield browser
        browser.close()


def wait_until(page: Page, condition: Callable[[], bool]) -> None:
    """Waits in Python, because the policy of a page may let no text become a script."""
    for _ in range(WAIT // 50):
        if condition():
            return
        page.wait_for_timeout(50)
    raise AssertionError("the page did not change")
