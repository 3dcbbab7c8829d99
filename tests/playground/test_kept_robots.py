"""What was typed in the playground is kept: random sessions, reloads, and several pages at once."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page

from tests.browser import wait_until
from tests.playground.test_playground_page import address, browser  # noqa: F401
from tests.slow import mostly_slow

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("site"), pytest.mark.timeout(1800)]

ACTIONS = [
    *["type"] * 4,
    *["mine", "page", "back"] * 2,
    *["forward", "undo", "reload", "close", "example", "link", "files"],
]
KEPT = "Object.keys(localStorage).map((key) => localStorage.getItem(key)).join()"


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:  # noqa: F811
    """The pages of a new visitor, without the compiler and pictures, which take seconds."""
    context = browser.new_context()
    context.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    context.route("**/*.packed", lambda route: route.abort())
    context.route(
        "**/worker.js", lambda route: route.fulfill(body="", content_type="text/javascript")
    )
    context.on("dialog", lambda dialog: dialog.accept())
    yield context
    context.close()


def opened(context: BrowserContext, url: str) -> Page:
    page = context.new_page()
    page.goto(url)
    settle(page)
    return page


def settle(page: Page) -> None:
    """Waits until a robot is open, and what the page still does has ended."""
    if page.url == "about:blank":  # before the first entry of the history
        page.go_forward()
    wait_until(page, lambda: bool(page.evaluate("typeof identity === 'string' && identity !== ''")))
    page.wait_for_timeout(60)


def type_at_end(page: Page, text: str) -> None:
    page.evaluate(
        "text => editor.view.dispatch({changes: {from: editor.view.state.doc.length, insert: text},"
        " userEvent: 'input.type'})",
        text,
    )


class Session:
    """Random actions of a visitor, and the lines that were typed and not undone."""

    def __init__(self, context: BrowserContext, url: str, seed: int, folder: Path) -> None:
        self.context, self.url, self.random, self.folder = context, url, random.Random(seed), folder
        self.pages = [opened(context, url)]
        self.typed: set[str] = set()
        self.log: list[str] = []

    def run(self, steps: int) -> None:
        for step in range(steps):
            page, action = self.random.choice(self.pages), self.random.choice(ACTIONS)
            self.log.append(f"{self.pages.index(page)} {action}")
            self.act(page, action, f"# typed {step}.")
            lost = {line for line in self.typed if line not in self.pages[0].evaluate(KEPT)}
            assert not lost, (self.log, lost)

    def act(self, page: Page, action: str, line: str) -> None:
        names = page.eval_on_selector_all("#example option", "all => all.map((o) => o.value)")[1:9]
        if action == "type":
            type_at_end(page, f"{line}\n")
            self.typed.add(line)
            return
        if action == "undo":
            before = page.evaluate("editor.text")
            page.focus(".cm-content")
            page.keyboard.press("Control+z")
            after = page.evaluate("editor.text")
            self.typed = {line for line in self.typed if line in after or line not in before}
            return
        if action == "example":
            page.select_option("#example", self.random.choice(names))
        elif action == "link":
            page.evaluate(
                "name => { location.hash = `example=${name}`; }", self.random.choice(names)
            )
        elif action == "back":
            page.go_back()
        elif action == "forward":
            page.go_forward()
        elif action == "reload":
            page.reload()
        elif action == "page" and len(self.pages) < 3:
            self.pages.append(opened(self.context, self.random.choice([self.url, page.url])))
        elif action == "close" and len(self.pages) > 1:
            self.pages.remove(page)
            page.close()
            return
        elif action == "mine":
            page.click("#mine")
            buttons = page.locator("#dialog-content li button:first-child")
            if buttons.count():
                buttons.nth(self.random.randrange(buttons.count())).click()
            if page.locator("#dialog[open]").count():
                page.keyboard.press("Escape")
        elif action == "files":
            path = self.folder / "robot.yaml"
            path.write_text(f"name: own\n{line}\n")
            page.set_input_files("#chosen-files", path)
            wait_until(page, lambda: line in page.evaluate("editor.text"))
            self.typed.add(line)
        settle(page)


@pytest.mark.parametrize("seed", mostly_slow(range(500), quick=1, slow=3))
def test_no_text_is_lost(context: BrowserContext, address: str, seed: int, tmp_path: Path) -> None:  # noqa: F811
    Session(context, address, seed, tmp_path).run(25)


def test_back_returns_to_the_text_and_its_undo_steps(
    context: BrowserContext,
    address: str,  # noqa: F811
) -> None:
    page = opened(context, address)
    first = page.evaluate("editor.text")
    assert page.input_value("#example") == "car"
    type_at_end(page, "# mine\n")
    assert page.input_value("#example") == ""  # "your own": the example can be chosen again
    page.select_option("#example", "9wd9ws")
    wait_until(page, lambda: "9wd9ws" in page.evaluate("editor.text"))
    page.go_back()
    wait_until(page, lambda: page.evaluate("editor.text").endswith("# mine\n"))
    page.focus(".cm-content")
    page.keyboard.press("Control+z")
    assert page.evaluate("editor.text") == first
    page.keyboard.press("Control+y")
    page.reload()
    settle(page)
    assert page.evaluate("editor.text").endswith("# mine\n")
    page.select_option("#example", "car")
    wait_until(page, lambda: page.evaluate("editor.text") == first)
    page.click("#mine")
    assert page.locator("#dialog-content li").count() == 1
    page.click("#dialog-content li button:has-text('remove')")
    assert page.locator("#dialog-content li").count() == 0
    assert "typed" not in page.evaluate(KEPT)


def test_a_robot_that_another_page_has_open_is_copied(
    context: BrowserContext,
    address: str,  # noqa: F811
) -> None:
    first = opened(context, address)
    type_at_end(first, "# both\n")
    second = opened(context, address)
    second.click("#mine")
    second.click("#dialog-content li button:first-child")
    wait_until(second, lambda: second.evaluate("editor.text").endswith("# both\n"))
    assert "copy" in second.inner_text("#note")
    type_at_end(second, "# second\n")
    type_at_end(first, "# first\n")
    kept = first.evaluate(KEPT)
    assert "# second" in kept
    assert "# first" in kept
