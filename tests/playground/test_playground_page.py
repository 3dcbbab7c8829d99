"""The page of the playground in a browser, from a static server without special headers."""

from __future__ import annotations

import base64
import functools
import http.server
import io
import json
import re
import sys
import threading
import urllib.request
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest
from playwright.sync_api import Browser, Page

from tests.accessibility import axe_script, violations
from tests.browser import WAIT, chromium, wait_until
from tests.examples import FLEETS, ROBOTS, SAMPLED_ROBOTS, robot_with_meshes, sampled
from tests.outside_tools import path_of
from tests.site_build import built_site
from tests.slow import mostly_slow
from thorvaldc.compiler.pipeline import compile_file, emit

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
SCRIPT = (ROOT / "playground/host.js").read_text(encoding="utf-8")
TARGETS = json.loads(SCRIPT.partition("const TARGETS = ")[2].partition(";")[0])
TEXT = (EXAMPLES / "4wd4ws_wide" / "robot.yaml").read_text(encoding="utf-8")
NO_NETWORK = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
DESK, PHONE = {"width": 1440, "height": 860}, {"width": 390, "height": 844}
LARGEST = 10_000_000  # bytes until the first robot is on the screen

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("site"), pytest.mark.timeout(1800)]


class Handler(http.server.SimpleHTTPRequestHandler):
    """A server of files that counts what it sends, without compression."""

    sent: ClassVar[dict[str, int]] = {}

    def log_message(self, *arguments: Any) -> None:
        pass

    def copyfile(self, source: Any, outputfile: Any) -> None:
        data = source.read()
        self.sent[self.path] = len(data)
        outputfile.write(data)


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    path_of("npm")
    folder = built_site(tmp_path_factory) / "playground"
    handler = functools.partial(Handler, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium(NO_NETWORK) as browser:
        yield browser


Visit = Callable[..., Page]


@pytest.fixture
def visit(address: str, browser: Browser) -> Iterator[Visit]:
    """Opens the page; a request to another host or an error of the page fails the test."""
    pages: list[Page] = []
    errors: list[str] = []

    def open_page(fragment: str = "", robot: bool = True, **options: Any) -> Page:
        page = opened(browser, address, errors, fragment, robot, **options)
        pages.append(page)
        return page

    yield open_page
    for page in pages:
        page.close()
    assert errors == []


def opened(
    browser: Browser,
    address: str,
    errors: list[str],
    fragment: str = "",
    robot: bool = True,
    **options: Any,
) -> Page:
    """Opens the page for a new visitor, and waits for its first robot if ``robot`` is true."""
    page = browser.new_page(**{"viewport": DESK, **options})
    page.on("pageerror", lambda error: errors.append(str(error)))

    def check(request: Any) -> None:
        if not request.url.startswith((address, f"blob:{address}", "data:")):
            errors.append(f"a request to {request.url}")

    page.on("request", check)
    page.goto(f"{address}{fragment}")
    if robot:
        page.wait_for_selector("html[data-version]", timeout=WAIT)
    return page


@pytest.fixture(scope="module")
def desk(address: str, browser: Browser) -> Iterator[tuple[Page, list[str]]]:
    """The page that tests use one after another, and its errors."""
    errors: list[str] = []
    page = opened(browser, address, errors)
    yield page, errors
    page.close()


@pytest.fixture
def page(desk: tuple[Page, list[str]]) -> Iterator[Page]:
    """The page of a visitor who opens the first example.

    Its compiler runs already; to start it takes seconds.
    """
    page, errors = desk
    errors.clear()
    rest(page)  # of the text of the last test
    open_example(page, "4wd4ws_wide")
    rest(page)
    yield page
    assert errors == []


def rest(page: Page) -> None:
    """Waits until the page has compiled what was typed."""
    wait_until(page, lambda: page.evaluate("isReady && !isCompiling && !changed.size"))


def version(page: Page) -> int:
    return int(page.evaluate("Number(document.documentElement.dataset.version)"))


def write(page: Page, text: str) -> None:
    """Replaces the text in the editor, as a user does."""
    page.evaluate(
        "text => editor.view.dispatch({changes: {from: 0, to: editor.view.state.doc.length,"
        " insert: text}, userEvent: 'input'})",
        text,
    )


def ask(page: Page, kind: str, **fields: Any) -> Any:
    return page.evaluate("([kind, fields]) => ask(kind, fields)", [kind, fields])


def built(page: Page) -> dict[str, bytes]:
    ask(page, "build", targets=TARGETS)
    archive = base64.b64decode(ask(page, "archive")["base64"])
    with zipfile.ZipFile(io.BytesIO(archive)) as packed:
        files = {name: packed.read(name) for name in packed.namelist()}
    assert sorted(json.loads(files.pop("manifest.json"))["files"]) == sorted(files)
    return files


def test_the_first_robot_and_its_size(visit: Visit) -> None:
    Handler.sent.clear()
    page = visit()
    assert sum(Handler.sent.values()) < LARGEST, Handler.sent
    assert page.inner_text("#title") == "thorvald_car"
    assert "accept:" not in page.evaluate("editor.text")
    assert page.get_attribute("#licences", "href") == "licences.txt"
    assert "127.6 kg" in page.inner_text("#facts")
    assert page.evaluate("Number(document.documentElement.dataset.triangles)") > 1000
    page.wait_for_selector("#overview table", state="attached", timeout=WAIT)
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    assert not page.evaluate("crossOriginIsolated")  # needs no special headers


@pytest.mark.parametrize("size", [{"width": 1280, "height": 800}, PHONE], ids=["desk", "phone"])
def test_a_picture_is_there_before_the_compiler(visit: Visit, size: dict[str, int]) -> None:
    page = visit(robot=False, viewport=size, service_workers="block")
    page.route("**/python.zip", lambda route: None)  # a network that has stopped
    page.reload()
    page.wait_for_selector("#status progress[value]", timeout=WAIT)
    status = page.inner_text("#status")
    assert re.fullmatch(r"starting the compiler: \d\.\d of [789]\.\d MB", status.strip())
    wait_until(page, lambda: page.evaluate("viewer.robots.length") == 1)
    assert page.evaluate("Number(document.documentElement.dataset.triangles)") > 1000
    assert page.inner_text("#title") == "thorvald_car"
    assert page.locator("#overview tr").count() == 8
    assert "127.58 kg" in page.inner_text("#overview")
    assert not page.evaluate("isReady")
    page.click("#outputs summary")
    page.click("#build")
    assert "when the compiler has started" in page.inner_text("#built-note")
    box = page.locator("#canvas").bounding_box()
    assert box is not None
    assert box["width"] * box["height"] >= 0.5 * size["width"] * size["height"]
    sections = page.locator("aside > details:visible")
    titles = [text.strip() for text in sections.locator("> summary").all_inner_texts()]
    assert titles[:5] == ["Overview", "Checks", "Joints", "Wiring", "Files"]
    opened = page.locator("aside > details[open] > summary").all_inner_texts()
    assert [text.strip() for text in opened] == ["Overview", "Files"]


def test_an_error_while_typing_its_fix_and_the_last_robot(page: Page) -> None:
    page.click(".cm-line:nth-child(9)")
    page.evaluate("window.firstWorker = worker")
    before = version(page)
    write(page, TEXT.replace("tube_inset_y", "tube_inset"))
    page.wait_for_selector("#diagnostics .error", timeout=WAIT)
    # A new worker, as on a busy computer, compiles the last robot first.
    is_same = page.evaluate("window.firstWorker === worker")
    assert version(page) == (before + 1 if is_same else 2)
    assert page.evaluate("viewer.isGrey && viewer.robots.length") == 1
    assert "1 error" in page.inner_text("#status")
    page.hover(".cm-lintRange-error")
    page.click(".cm-diagnosticAction")
    page.wait_for_selector("#diagnostics .error", state="detached", timeout=WAIT)
    assert page.evaluate("editor.text") == TEXT
    assert not page.evaluate("viewer.isGrey")
    write(page, TEXT + "foo: 1\n")  # jsonschema is loaded for the first such error
    page.wait_for_selector("#diagnostics .error", timeout=WAIT)
    page.click("#diagnostics .error div")
    assert page.evaluate("editor.view.state.selection.main.head") == len(TEXT)


def test_the_editor_proposes_keys_and_types(page: Page) -> None:
    page.click(".cm-content")
    page.keyboard.press("Control+End")
    page.keyboard.type("para")
    page.wait_for_selector(".cm-tooltip-autocomplete", timeout=WAIT)
    assert "parameter_sets" in page.inner_text(".cm-tooltip-autocomplete")
    page.wait_for_selector(".cm-completionInfo b", timeout=WAIT)
    assert "`" not in page.inner_text(".cm-completionInfo")
    page.keyboard.press("Escape")
    for _ in "para":
        page.keyboard.press("Backspace")
    write(page, TEXT.replace("type: io/board,", "type: caster/"))
    offset = TEXT.index("io/board,") + len("caster/")
    page.evaluate("at => editor.view.dispatch({selection: {anchor: at}})", offset)
    page.click(".cm-content", position={"x": 1, "y": 1}, trial=True)
    page.evaluate("editor.view.focus()")
    page.keyboard.press("Control+Space")
    page.wait_for_selector(".cm-tooltip-autocomplete", timeout=WAIT)
    page.get_by_text("caster/swivel", exact=False).first.click()
    assert "type: caster/swivel" in page.evaluate("editor.text")


@pytest.mark.parametrize("keys", ["  x: {type: ", "  x:\ntype: "])
def test_the_list_of_types_opens_after_their_key(page: Page, keys: str) -> None:
    write(page, TEXT.partition("accept:")[0])
    page.click(".cm-content")
    page.keyboard.press("Control+End")
    page.keyboard.type(keys)
    page.get_by_role("option", name="assembly/fixed_drive", exact=False).wait_for(timeout=WAIT)
    page.keyboard.press("Escape")


def test_a_line_below_a_key_and_a_wrapped_row_are_indented(page: Page) -> None:
    page.click(".cm-content")
    page.keyboard.press("Control+End")
    page.keyboard.type("\nfirst:\nsecond:\nthird: 1\nfourth: 2")
    assert page.evaluate("editor.text").endswith("\nfirst:\n  second:\n    third: 1\n    fourth: 2")
    indents = page.eval_on_selector_all(
        ".cm-line", "all => all.map((line) => parseFloat(getComputedStyle(line).textIndent))"
    )
    assert min(indents) < max(indents) < 0.0


def test_driving_while_another_part_is_typed(page: Page) -> None:
    page.click("#drive")
    page.wait_for_selector("#drive[aria-pressed=true]", timeout=WAIT)
    text = "document.querySelector('#drive-state').textContent"
    odometry = f"Number(/odometry x (-?[0-9.]+)/.exec({text})?.[1] ?? 'NaN')"
    wait_until(page, lambda: page.evaluate(odometry) == page.evaluate(odometry))
    page.wait_for_timeout(500)
    assert abs(page.evaluate(odometry)) < 0.01  # it does not move unasked
    page.evaluate("window.held = setInterval(() => send({kind: 'motion', x: 1, y: 0, yaw: 0}), 50)")
    page.click(".cm-content")
    page.keyboard.press("Control+End")
    for letter in "# typed w":  # `w` drives only outside of the editor
        page.keyboard.type(letter)
        page.wait_for_timeout(100)
    wait_until(page, lambda: page.evaluate(odometry) > 0.3)
    assert page.evaluate("editor.text").endswith("# typed w")
    assert page.get_attribute("#drive", "aria-pressed") == "true"
    page.evaluate("clearInterval(held)")
    page.wait_for_timeout(2500)
    stopped = page.evaluate(odometry)
    page.wait_for_timeout(500)
    assert page.evaluate(odometry) == pytest.approx(stopped, abs=0.01)
    page.focus("#stick")
    page.keyboard.down("s")
    wait_until(page, lambda: page.evaluate(odometry) < stopped - 0.1)
    page.keyboard.up("s")
    page.keyboard.press("Escape")
    page.wait_for_selector("#drive[aria-pressed=false]", timeout=WAIT)


def test_another_example_is_shown_as_a_whole(page: Page) -> None:
    place = "viewer.camera.position.distanceTo(viewer.controls.target)"
    small = page.evaluate(place)
    open_example(page, "9wd9ws")
    wait_until(page, lambda: page.inner_text("#title") == "thorvald_9wd9ws")
    whole = page.evaluate(place)
    assert whole > 1.2 * small
    page.evaluate("viewer.camera.position.multiplyScalar(0.5)")
    write(page, page.evaluate("editor.text") + "# changed\n")  # the camera stays
    page.wait_for_timeout(1000)
    assert page.evaluate(place) < 0.9 * whole


def open_example(page: Page, name: str) -> None:
    before = version(page)
    page.select_option("#example", name)
    wait_until(page, lambda: page.evaluate("origin") == name and version(page) != before)


def test_examples_have_the_files_of_a_native_build(visit: Visit) -> None:
    page = visit()
    names = page.eval_on_selector_all("#example option", "all => all.map((o) => o.value)")[1:]
    assert {*ROBOTS, *FLEETS} <= set(names)
    for name in (*sampled(SAMPLED_ROBOTS, SAMPLED_ROBOTS[-1:]), FLEETS[0]):
        open_example(page, name)
        main = next(EXAMPLES.glob(f"{name}/*t.yaml"))
        model = compile_file(main).model
        assert model is not None
        native = emit(model, TARGETS)
        files = built(page)
        assert sorted(files) == sorted(native), name
        assert [path for path in native if files[path] != native[path]] == [], name


def open_files(page: Page, files: dict[str, bytes]) -> None:
    before = version(page)
    content = {
        name: [base64.b64encode(data).decode()] if name.endswith(".stl") else data.decode()
        for name, data in files.items()
    }
    page.evaluate("files => openFiles(files, 'robot.yaml', '')", content)
    wait_until(page, lambda: version(page) != before)


def test_own_files_and_a_link_to_them(visit: Visit, tmp_path: Path) -> None:
    page = visit()
    files = robot_with_meshes()
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    before = version(page)
    page.set_input_files("#chosen-files", [tmp_path / name for name in files])
    wait_until(page, lambda: version(page) != before)
    model = compile_file(tmp_path / "robot.yaml").model
    assert model is not None
    native = emit(model, TARGETS)
    assert built(page) == native
    page.click("[role=tab]:has-text('top.xacro')")
    assert page.evaluate("editor.text") == files["top.xacro"].decode()
    page.click("#share")
    wait_until(page, lambda: "#robot=" in page.url)
    other = visit(f"#{page.url.partition('#')[2]}")
    assert other.eval_on_selector_all("[role=tab]", "all => all.length") == 4
    assert built(other) == native


FRAGMENTS = ("#robot=AAAA", "#example=none", "#robot=%", "#robot=", "#x")


@pytest.mark.parametrize("fragment", mostly_slow(FRAGMENTS, quick=2, slow=0))
def test_a_link_that_cannot_be_read_opens_an_example(visit: Visit, fragment: str) -> None:
    page = visit(fragment)
    assert page.inner_text("#title") == "thorvald_car"
    assert ("cannot be read" in page.inner_text("#note")) == fragment.startswith("#robot")


HUNGRY = {
    "hangs": "${len([0 for i in range(10**9) if not i+1])}",
    "needs memory": "${[0] * 10**10}",
    "recursion": '</robot><robot name="b">' + "<a>" * 5000,
}


@pytest.mark.parametrize("fault", mostly_slow(HUNGRY, quick=1, slow=0))
def test_a_file_that_takes_too_much_ends_and_the_page_goes_on(visit: Visit, fault: str) -> None:
    page = visit()
    files = robot_with_meshes()
    open_files(page, files)
    assert page.locator("#diagnostics .error").count() == 0
    name = page.inner_text("#title")
    page.click("[role=tab]:has-text('top.xacro')")
    xacro, robot = (files[name].decode() for name in ("top.xacro", "robot.yaml"))
    write(page, xacro.replace("${0.2 + sin(0.5)}", HUNGRY[fault]))
    wait_until(
        page,
        lambda: (
            "change the file to try again" in page.inner_text("#note")
            or page.locator("#diagnostics .error").count() > 0
        ),
    )
    assert ("took longer than" in page.inner_text("#note")) == (fault == "hangs")
    wait_until(page, lambda: page.evaluate("isReady && !isCompiling"))
    assert page.inner_text("#title") == name
    assert page.evaluate("viewer.robots.length") == 1
    before = page.inner_text("#facts")
    write(page, xacro.replace("0.2", "0.3"))  # the text of the user is still there
    rest(page)
    page.click("[role=tab]:has-text('robot.yaml')")
    write(page, robot.replace("1.60 m", "1.70 m"))
    wait_until(page, lambda: page.inner_text("#facts") != before)
    assert page.locator("#diagnostics .error").count() == 0
    assert not page.evaluate("viewer.isGrey")


def test_modules_are_mounted_by_click_and_by_drag(page: Page) -> None:
    page.click("#library summary")
    page.fill("#filter", "fixed_drive")
    button = page.locator("#modules button:visible")
    wait_until(page, lambda: button.locator("img").evaluate("image => image.naturalWidth") > 0)
    button.first.click()
    page.get_by_role("button", name="frame.mid_left", exact=True).click()
    wait_until(page, lambda: "mount: frame.mid_left}" in page.evaluate("editor.text"))
    place = page.evaluate(
        """() => {
          const box = $("canvas").getBoundingClientRect();
          const frame = viewer.robots[0].frames.find((f) => f.userData.name === "frame.mid_right");
          const point = frame.getWorldPosition(frame.position.clone()).project(viewer.camera);
          return [box.x + (1 + point.x) * box.width / 2, box.y + (1 - point.y) * box.height / 2];
        }"""
    )
    box = button.first.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 20, box["y"] + 10)
    page.mouse.down()
    page.mouse.move(box["x"] + 60, box["y"] + 20, steps=3)
    page.wait_for_timeout(500)  # the free ports come from the worker
    page.mouse.move(place[0] + 5, place[1] + 5, steps=5)
    page.wait_for_selector("#drop", timeout=WAIT)
    page.mouse.up()
    wait_until(page, lambda: "mount: frame.mid_right}" in page.evaluate("editor.text"))


def test_generated_files_are_shown_and_saved(page: Page) -> None:
    page.click("#outputs summary")
    page.click("#build")
    page.wait_for_selector("#built button", timeout=WAIT)
    page.click("#built button:has-text('urdf/robot.urdf')")
    page.wait_for_selector("#dialog[open] pre", timeout=WAIT)
    model = compile_file(EXAMPLES / "4wd4ws_wide" / "robot.yaml").model
    assert model is not None
    text = emit(model, ["urdf"])["urdf/robot.urdf"]
    with page.expect_download() as download:
        page.click("#dialog-content button")
    assert Path(download.value.path()).read_bytes() == text
    page.keyboard.press("Escape")
    with page.expect_download() as download:
        page.click("#download")
    assert download.value.suggested_filename == "thorvald_4wd4ws_wide.zip"
    with zipfile.ZipFile(download.value.path()) as packed:
        assert packed.read("urdf/robot.urdf") == text


def test_each_program_is_listed_with_licence_and_source(address: str) -> None:
    with urllib.request.urlopen(f"{address}licences.txt") as answer:
        text = answer.read().decode()
    for name in ("CPython", "pyodide", "@mujoco/mujoco", "three", "@codemirror/view", "Jinja2"):
        entry = re.search(
            rf"^.*{re.escape(name)} .*\n+.*Source: (\S+)|{name} .*\n.*Source: (\S+)", text, re.M
        )
        assert entry is not None, name
    assert "Permission is hereby granted" in text


def test_a_phone_shows_text_or_robot(visit: Visit) -> None:
    page = visit(viewport=PHONE, has_touch=True)
    assert page.is_visible("#canvas")
    assert not page.is_visible("#workbench")
    page.click("#views button:has-text('Text')")
    assert page.is_visible(".cm-content")
    assert not page.is_visible("#canvas")
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


@pytest.mark.parametrize("size", mostly_slow([DESK, PHONE], slow=0), ids=["desk", "phone"])
def test_the_page_is_accessible(
    visit: Visit, size: dict[str, int], tmp_path_factory: pytest.TempPathFactory
) -> None:
    axe = axe_script(tmp_path_factory.mktemp("axe"))
    page = visit(viewport=size, bypass_csp=True)
    page.wait_for_selector("#overview table", state="attached", timeout=WAIT)
    problems: list[str] = []

    def check(state: str) -> None:
        for colours in ("light", "dark"):
            page.emulate_media(color_scheme=colours)
            page.wait_for_timeout(300)  # the picture fades
            problems.extend(violations(page, axe, f"{state} {colours}"))

    check("robot")
    page.click("#outputs summary")
    page.click("#build")
    page.wait_for_selector("#built button", timeout=WAIT)
    page.evaluate(
        "for (const section of document.querySelectorAll('aside > details')) section.open = true"
    )
    check("files")
    if size is PHONE:
        page.click("#views button:has-text('Text')")
    page.click("#library summary")
    check("modules")
    write(page, TEXT.replace("tube_inset_y", "tube_inset"))
    page.wait_for_selector("#diagnostics .error", state="attached", timeout=WAIT)
    check("error")
    page.click("#modules button >> nth=0")
    page.wait_for_selector("#dialog[open]", timeout=WAIT)
    check("dialog")
    assert problems == []


def test_the_link_of_a_page_is_the_link_of_the_documentation(visit: Visit) -> None:
    sys.path.insert(0, str(ROOT / "workshop" / "site"))
    try:
        import playground_links
    finally:
        sys.path.pop(0)
    text = TEXT.replace("thorvald_4wd4ws_wide", "linked")
    markdown = f"Text\n\n```yaml\n{text}```\n\n```yaml\nname: part\n```\n"
    linked = playground_links.with_links(markdown, "../playground/index.html")
    (link,) = re.findall(r'href="\.\./playground/index\.html#([^"]+)"', linked)
    page = visit(f"#{link}")
    assert page.inner_text("#title") == "linked"
    assert page.evaluate("editor.text") == text
    assert json.loads(page.evaluate("JSON.stringify([...files.keys()])")) == ["robot.yaml"]


def drives(page: Page) -> None:
    page.click("#drive")
    page.wait_for_selector("#drive[aria-pressed=true]", timeout=WAIT)


def test_the_page_works_without_a_network(visit: Visit) -> None:
    page = visit()
    page.evaluate("navigator.serviceWorker.ready.then(() => 1)")
    page.context.set_offline(True)
    page.reload()
    page.wait_for_selector("html[data-version]", timeout=WAIT)
    open_example(page, "2wd0ws_greenhouse")
    drives(page)


def test_what_the_network_lacks_is_named_until_it_is_there(visit: Visit) -> None:
    page = visit(service_workers="block")
    page.context.set_offline(True)
    page.select_option("#example", "9wd9ws")
    wait_until(page, lambda: "9wd9ws cannot be loaded" in page.inner_text("#note"))
    page.click("#drive")
    state = "document.querySelector('#drive-state').textContent"
    wait_until(page, lambda: "simulator cannot be loaded" in page.evaluate(state))
    write(page, TEXT + "# the compiler is still there\n")
    before = version(page)
    wait_until(page, lambda: version(page) > before)
    page.context.set_offline(False)
    drives(page)
    open_example(page, "9wd9ws")
    assert page.inner_text("#note") == ""


def test_the_first_compilation_has_no_limit_and_another_robot_ends_it(visit: Visit) -> None:
    files = {name: data for name, data in robot_with_meshes().items() if not name.endswith(".stl")}
    texts = {name: data.decode() for name, data in files.items()}
    texts["top.xacro"] = texts["top.xacro"].replace("${0.2 + sin(0.5)}", HUNGRY["hangs"])
    robot = json.dumps({"main": "robot.yaml", "files": texts}).encode()
    packed = zlib.compressobj(wbits=-15)
    link = base64.urlsafe_b64encode(packed.compress(robot) + packed.flush()).decode().rstrip("=")
    page = visit(f"#robot={link}", robot=False)
    wait_until(page, lambda: page.evaluate("isReady && isCompiling"))
    page.wait_for_timeout(12_000)
    assert page.evaluate("isReady && isCompiling")
    page.select_option("#example", "9wd9ws")
    page.wait_for_selector("html[data-version]", timeout=WAIT)
    assert page.inner_text("#title") == "thorvald_9wd9ws"
    assert page.inner_text("#note") == ""
