"""The documentation as a site: it builds without a warning, and its links lead somewhere."""

from __future__ import annotations

import functools
import http.server
import json
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.accessibility import axe_script, violations
from tests.browser import chromium
from tests.docs.site_pages import dead_links, foreign_files
from tests.site_build import built_site

ROOT = Path(__file__).resolve().parents[2]
pytestmark = [pytest.mark.xdist_group("site"), pytest.mark.timeout(300)]


MAST = """\
thorvaldc: 1
description: A mast.
mount: {kinds: [frame_clamp], link: body}
links:
  body:
    parts:
      - {shape: {cylinder: {radius: 20 mm, length: 1 m}}, mass: 2 kg, source: "estimated: a tube"}
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built_site(tmp_path_factory)


@pytest.mark.slow
def test_every_link_and_anchor_exists(site: Path) -> None:
    assert list(dead_links(site)) == []


def test_a_site_without_the_playground_has_no_link_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a computer without npm."""
    monkeypatch.syspath_prepend(ROOT / "workshop" / "site")
    from playground_links import without_links

    text = (ROOT / "docs" / "playground.md").read_text(encoding="utf-8")
    assert "playground/index.html" in text
    assert "playground/index.html" not in without_links(text)
    assert "contains it: open the playground. In" in without_links(text)


def test_the_site_has_a_gallery_of_each_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(ROOT / "workshop" / "site")
    import reference_modules

    folder = tmp_path / "agri" / "modules"
    mast = folder / "tool" / "mast"
    mast.mkdir(parents=True)
    (mast / "module.yaml").write_text(MAST, encoding="utf-8")
    (mast / "picture.png").write_bytes(b"PNG")
    monkeypatch.setattr(reference_modules, "LIBRARIES", str(folder))
    pages = reference_modules.pages()
    index = pages["reference/modules/agri/README.md"]
    assert "| [tool/mast](tool.md#mast) | A mast. | ![The module tool/mast](tool_mast.png)" in index
    assert pages["reference/modules/agri/tool_mast.png"] == mast / "picture.png"
    assert "[agri](agri/README.md)" in pages["reference/modules/README.md"]
    assert "controller/odrive" in pages["reference/modules/odrive/README.md"]


@pytest.mark.slow
def test_the_files_for_language_models(site: Path) -> None:
    """Every page of the navigation, with its text in Markdown."""
    index = (site / "llms.txt").read_text(encoding="utf-8")
    full = (site / "llms-full.txt").read_text(encoding="utf-8")
    assert index.startswith("# thorvaldc\n\n> A compiler for modular robots")
    pages = re.findall(r"^- \[([^\]]+)\]\(([^)]+)\)(?:: (.+))?$", index, re.MULTILINE)
    assert len(pages) == len(re.findall(r"^ +- .*\.md$", (ROOT / "mkdocs.yml").read_text(), re.M))
    assert ("Installation", "install.md") in [page[:2] for page in pages]
    for _, address, sentence in pages:
        text = (site / address).read_text(encoding="utf-8")
        assert text.strip() in full, address
        assert len(sentence) <= 160, address
    assert sum(1 for page in pages if not page[2]) <= 12


@pytest.mark.slow
def test_nothing_is_loaded_from_another_host(site: Path) -> None:
    assert list(foreign_files(site)) == []


def test_the_check_of_links_finds_dead_ones(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<h1 id="top">A</h1> <a href="#top">1</a> <a href="#bottom">2</a> <a href="b.html">3</a>'
        '<img src="c.png"> <script src="https://cdn.example/x.js"></script>'
    )
    assert list(dead_links(tmp_path)) == ["a.html: #bottom", "a.html: b.html", "a.html: c.png"]
    assert list(foreign_files(tmp_path)) == ["a.html: https://cdn.example/x.js"]


# One page of each kind, with the width of the window and the colours.
SAMPLE = (
    ("index.html", 390, "dark"),
    ("tutorial/simulation.html", 1280, "dark"),
    ("how-to/module.html", 390, "light"),
    ("reference/fleet.html", 1280, "light"),
    ("reference/commands.html", 390, "light"),
    ("diagnostics/TV501.html", 1280, "dark"),
    ("explanation/least-squares.html", 1280, "light"),
    ("examples.html", 390, "dark"),
    ("python.html", 1280, "light"),
    ("examples/odometry_experiment/index.html", 1280, "light"),
    ("404.html", 1280, "light"),
)


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *arguments: Any) -> None:
        pass


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    handler = functools.partial(QuietHandler, directory=str(site))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture(scope="module")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The program axe-core, which checks the accessibility of a page in a browser."""
    return axe_script(tmp_path_factory.mktemp("axe"))


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as browser:
        yield browser


@pytest.mark.slow
def test_pages_are_accessible_and_ask_no_other_host(address: str, axe: str, browser: Any) -> None:
    found, hosts, errors, wide = [], set(), [], []
    for name, width, colours in SAMPLE:
        page = browser.new_page(
            viewport={"width": width, "height": 900}, color_scheme=colours, bypass_csp=True
        )
        page.on("request", lambda request: hosts.add(request.url.split("/")[2]))
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(f"{address}/{name}")
        found += violations(page, axe, f"{name} {width} {colours}")
        if page.evaluate("document.documentElement.scrollWidth") > width:
            wide.append(f"{name} {width}")
        page.close()
    assert found == []
    assert hosts == {address.removeprefix("http://")}
    assert (errors, wide) == ([], [])


@pytest.mark.slow
def test_a_description_has_room_beside_a_command(address: str, browser: Any) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(f"{address}/commands.html")
    for command, description in zip(*[iter(page.locator("table th").all()[:6])] * 2, strict=True):
        assert description.bounding_box()["width"] > 0.6 * command.bounding_box()["width"]
    option = page.locator("table .option", has_text="--no-browser").bounding_box()
    assert option["height"] < 25  # px: it is in one line
    page.close()


@pytest.mark.slow
def test_axe_finds_a_picture_without_a_text(axe: str, browser: Any) -> None:
    page = browser.new_page()
    page.set_content("<html lang='en'><title>x</title><main><h1>x</h1><img src='x.png'></main>")
    found = violations(page, axe, "page")
    page.close()
    assert found == ['page: image-alt: <img src="x.png">']


@pytest.mark.slow
@pytest.mark.parametrize("opened_as", ["http", "file"])
def test_the_search_finds_a_page(address: str, site: Path, browser: Any, opened_as: str) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(f"{address}/index.html" if opened_as == "http" else (site / "index.html").as_uri())
    # The search listens to keys; it may not see a text that is set at once.
    page.locator("input[name=query]").press_sequentially("least squares")
    page.wait_for_selector(".md-search-result__item", timeout=300_000)
    found = page.inner_text(".md-search-result__list")
    page.close()
    assert "Least squares" in found


@pytest.mark.slow
def test_the_reference_has_every_key_of_a_robot(site: Path) -> None:
    keys = json.loads((ROOT / "thorvaldc/schema/robot.schema.json").read_text())["properties"]
    text = (site / "reference/robot.html").read_text(encoding="utf-8")
    assert all(f">{key}<" in text or f'id="{key}"' in text for key in keys)


@pytest.mark.slow
def test_the_reference_has_every_module_with_a_picture(site: Path) -> None:
    """Modules without a visible part have none."""
    bare = {"controller/propulsion_propulsion", "frame/open"}
    for file in ROOT.glob("modules/*/*/module.yaml"):
        category, name = file.parts[-3:-1]
        page = (site / f"reference/modules/{category}.html").read_text(encoding="utf-8")
        assert f'id="{name}"' in page
        picture = f"{category}_{name}.png"
        assert (picture in page) == (f"{category}/{name}" not in bare), picture
