"""The report of a study: its content, its bytes, and a click in a browser."""

from __future__ import annotations

import html
import itertools
import json
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Locator, Page

import thorvaldc
from tests.accessibility import axe_script, violations
from tests.browser import WAIT, chromium
from tests.cli.conftest import UNPOWERED, Command, run_in_this_process
from tests.cli.conftest import thorvaldc as thorvaldc_command
from tests.slow import mostly_slow
from thorvaldc.tools.study.study_report import (
    ReportContent,
    ReportRobot,
    Sensitivity,
    study_report,
    thinned,
)
from thorvaldc.tools.study.study_results import StudyTable

run = pytest.fixture(name="run")(thorvaldc_command.__wrapped__)  # type: ignore[attr-defined]

NASTY = "</script><script>document.title = 'taken'</script><img src=x onerror=alert(1)>"
STUDY = f"""\
thorvaldc: 1
study: track
description: "{NASTY}"
robot: good.yaml
variables:
  track: {{paths: [modules.frame.params.width], min: 0.8 m, max: 1.2 m}}
  words: {{paths: [description], values: ["{NASTY}"]}}
constraints:
  tip_over: {{fact: stability.angles.left, at_least: 50 deg}}
objectives:
  light: {{fact: mass, goal: minimise}}
  stable: {{fact: stability.angles.left, goal: maximise}}
samples: {{method: grid, number: 5}}
"""


@pytest.fixture
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is drawn, to save time, also if another test has drawn before."""
    monkeypatch.setattr(
        "thorvaldc.tools.study.study_report.picture_fault", lambda: "MuJoCo cannot draw"
    )


def report(run: Command, study: str, *arguments: str) -> str:
    """Runs a study and returns its report."""
    Path("study.yaml").write_text(study)
    Path("good.yaml").write_text(f"{UNPOWERED}description: a robot\n")
    shutil.rmtree("study", ignore_errors=True)
    assert run("study", "run", "study.yaml", "-j", "1").status == 0
    result = run("study", "report", "study.yaml", *arguments)
    assert result.status == 0, result.err
    return Path(result.out.strip()).read_text("utf-8")


def data(page: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    assert found is not None
    value: dict[str, Any] = json.loads(found[1])
    return value


def body(page: str) -> str:
    """Returns the elements of a page as text."""
    return html.unescape(re.sub(r"<(script|style).*?</\1>|<[^>]*>", " ", page, flags=re.S))


@pytest.mark.usefixtures("no_pictures")
def test_the_report_has_the_question_the_designs_and_the_differences(run: Command) -> None:
    page = report(run, STUDY)
    text = body(page)
    for words in ("0.8\xa0m to 1.2\xa0m", "at least 50 deg", "minimise", "5 designs"):
        assert words in text
    found = data(page)
    assert found["axes"] == ["light", "stable"]
    assert [column["unit"] for column in found["columns"]] == ["mm", "", "deg", "kg", "deg"]
    assert [column["values"][0] for column in found["columns"]][:2] == [800.0, NASTY]
    # A wider robot is heavier and more stable, so that the front has all designs that pass.
    passed = [status == "ok" for status in found["statuses"]]
    assert 1 < sum(passed) < 5
    assert found["front"] == passed
    failed = found["samples"][passed.index(False)]
    message = found["messages"][found["messageOf"][passed.index(False)]]
    assert re.fullmatch(r"tip_over is 4\d\.\d+ deg, less than 50 deg", message)
    assert f"design {failed}: {message}" in text
    robots = [int(number) for number in re.findall(r'id="robot-(\d+)"', page)]
    assert robots == [0, *(n for n, on_front in enumerate(found["front"], 1) if on_front)]
    assert found["chosen"] in robots
    assert "length 1.1 m" not in text  # equal in all robots
    assert re.search(r"width 0\.9 m → 1\.2 m", text)
    assert "the report has no pictures: MuJoCo cannot draw".lower() in text.lower()


@pytest.mark.usefixtures("no_pictures")
def test_equal_tables_give_equal_bytes_and_load_nothing(run: Command) -> None:
    page = report(run, STUDY)
    assert report(run, STUDY, "-o", "other.html") == page
    assert "default-src 'none'; script-src 'sha256-" in page
    plain = re.sub(r"<script>.*?</script>", "", page, flags=re.S)
    assert not re.findall(
        r"<(?:link|iframe|object|script) |<img [^>]*src|@import|url\(",
        re.sub(r'<script type="application/json".*?</script>', "", plain, flags=re.S),
    )
    assert page.count("<script") == 3  # the data, plotly.js and the plots
    assert str(Path.cwd()) not in plain


@pytest.mark.usefixtures("no_pictures")
@pytest.mark.parametrize("count", mostly_slow([1, 3]))
def test_one_or_three_objectives(run: Command, count: int) -> None:
    first = "  light: {fact: mass, goal: minimise}\n"
    more = first + "  wide: {fact: size.width, goal: maximise}\n"
    text = STUDY.replace(first, more if count == 3 else first)
    if count == 1:
        text = re.sub(r"  stable: .*\n", "", text)
    found = data(report(run, text))
    if count == 1:
        assert found["axes"] == ["track", "light"]
        lightest = found["columns"][-1]["values"][found["samples"].index(found["chosen"])]
        passed = [s == "ok" for s in found["statuses"]]
        values = found["columns"][-1]["values"]
        assert lightest == min(v for v, ok in zip(values, passed, strict=True) if ok)
        assert sum(found["front"]) == 1
    else:
        assert found["axes"] == ["light", "wide"]
        assert [column["kind"] for column in found["columns"]].count("objective") == 3


@pytest.mark.usefixtures("no_pictures")
def test_of_one_objective_the_five_best_designs_are_shown(run: Command) -> None:
    text = re.sub(r"  stable: .*\n", "", STUDY).replace("number: 5", "number: 8")
    report(run, text.replace("50 deg", "30 deg"))
    study = thorvaldc.compile("study.yaml").tool_document
    assert study is not None
    content = ReportContent(study, StudyTable.open(Path("study/track")))
    best = sorted(content.designs, key=lambda design: design["light"])[:5]
    assert content.shown == [design["sample"] for design in best]


@pytest.mark.usefixtures("no_pictures")
def test_a_study_without_a_good_design_or_without_results(run: Command) -> None:
    page = report(run, STUDY.replace("at_least: 50 deg", "at_least: 85 deg"))
    assert "No design meets every constraint" in body(page)
    assert data(page)["chosen"] == 0
    Path("study.yaml").write_text(STUDY.replace("max: 1.2 m", "max: 1.3 m"))
    changed = run("study", "report", "study.yaml")
    assert (changed.status, "study run" in changed.err) == (3, True)
    missing = run("study", "report", "study.yaml", "--results", "nothing")
    assert (missing.status, "study run" in missing.err) == (3, True)


@pytest.mark.usefixtures("no_pictures")
def test_the_sensitivity_is_a_table_and_chooses_the_variable(run: Command) -> None:
    report(run, re.sub(r"  stable: .*\n", "", STUDY))
    study = thorvaldc.compile("study.yaml").tool_document
    assert study is not None
    content = ReportContent(study, StudyTable.open(Path("study/track")))
    rows = (("track", "0.2"), ("words", "0.7 <b>"))
    table = Sensitivity(("variable", "light"), rows, {"track": 0.2, "words": 0.7}, ("a note",))
    page = study_report(content, [ReportRobot(0)], sensitivity=table)
    assert "not finished" not in page
    unfinished = ReportContent(study, StudyTable.open(Path("study/track")), 8)
    assert "3 of 8 designs have no result" in study_report(unfinished, [ReportRobot(0)])
    assert data(page)["axes"] == ["words", "light"]
    assert "0.7 &lt;b&gt;" in page
    assert "Sensitivity" in body(page)
    assert "Sensitivity" not in body(study_report(content, [ReportRobot(0)]))


def test_a_large_front_is_thinned_evenly() -> None:
    designs = [{"sample": number} for number in range(100)]
    numbers = [design["sample"] for design in thinned(designs, 20)]
    assert (len(numbers), numbers[0], numbers[-1]) == (20, 0, 99)
    steps = {b - a for a, b in itertools.pairwise(numbers)}
    assert steps <= {5, 6}
    assert thinned(designs, 200) == designs


# -- in a browser ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def report_with_pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    with pytest.MonkeyPatch.context() as monkeypatch:
        run = run_in_this_process(monkeypatch, folder)
        report(run, STUDY.replace("number: 5", "number: 2"), "-o", "report.html")
    return folder / "report.html"


@pytest.fixture
def page(browser: Browser, report_with_pictures: Path) -> Iterator[Page]:
    """A report with pictures in the browser."""
    with opened(browser, report_with_pictures) as page:
        yield page


@contextmanager
def opened(browser: Browser, file: Path, **options: Any) -> Iterator[Page]:
    """Opens a file in the browser; the page must have no error and ask no server."""
    page = browser.new_page(viewport={"width": 1000, "height": 800}, **options)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("request", lambda request: errors.append(request.url[:100]))
    page.goto(file.resolve().as_uri())
    page.wait_for_selector("html[data-ready]", timeout=WAIT)
    yield page
    page.close()
    assert all(error.startswith(("file:", "data:", "blob:")) for error in errors), errors


@pytest.mark.slow
def test_a_click_shows_the_robot(page: Page) -> None:
    assert page.title() == "track: report of a study"
    assert "taken" in page.inner_text("header")  # as text
    assert page.inner_text("#title") == "Design 2: front"
    assert page.evaluate("document.querySelector('#picture').naturalWidth") == 480
    page.click(".gallery [data-design='0']")
    assert page.inner_text("#title") == "Start robot"
    excluded, on_front = page.locator("#plot .scatterlayer .point").all()
    click(page, excluded)
    page.wait_for_function("document.querySelector('#title').textContent == 'Design 1: constraint'")
    assert page.inner_text("#message").startswith("tip_over is 4")
    assert page.is_visible("#no-robot")
    click(page, on_front)
    page.wait_for_function("document.querySelector('#title').textContent == 'Design 2: front'")
    assert page.is_visible("#robot-2 >> text=width 0.9 m → 1.2 m")
    assert page.is_visible("#picture")
    assert "1200 mm" in page.inner_text("#values")
    assert page.locator("[aria-pressed=true]").get_attribute("data-design") == "2"
    page.select_option("#x", "track")
    assert "track (mm)" in page.inner_html("#plot .xtitle")


@pytest.mark.slow
def test_a_printed_page_has_the_lines_that_were_not_in_view(page: Page) -> None:
    assert not page.locator("#parallel canvas").count()
    page.pdf()
    assert page.locator("#parallel canvas").count()
    assert page.evaluate("document.documentElement.className") == ""  # the colours are back


def click(page: Page, point: Locator) -> None:
    page.locator("#plot").scroll_into_view_if_needed()
    box = point.bounding_box()
    assert box is not None
    place = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(0.0, 0.0)  # a click counts for the point that was hovered last
    page.wait_for_selector("#plot .hovertext", state="detached")
    page.mouse.move(*place)
    page.wait_for_selector("#plot .hovertext")
    page.mouse.click(*place)


@pytest.mark.slow
@pytest.mark.usefixtures("no_pictures")
def test_ranges_of_parallel_coordinates_dim_the_other_designs(
    browser: Browser, run: Command, tmp_path: Path
) -> None:
    report(run, STUDY.replace("50 deg", "30 deg").replace("number: 5", "number: 3"), "-o", "r.html")
    axe = axe_script(tmp_path)
    with opened(browser, Path("r.html"), bypass_csp=True) as page:
        page.locator("#parallel").scroll_into_view_if_needed()
        axis = page.locator("#parallel .axis-brush").first
        axis.wait_for(timeout=WAIT)
        box = axis.bounding_box()
        assert box is not None
        x, y, height = box["x"] + box["width"] / 2, box["y"], box["height"]
        page.mouse.move(x, y + 0.35 * height)
        page.mouse.down()
        page.mouse.move(x, y + 0.65 * height, steps=2)
        page.mouse.up()
        page.wait_for_function("document.querySelector('#brushed').textContent")
        assert page.inner_text("#brushed").startswith("1 of 3 designs")  # that with 1 m
        points = page.locator("#plot .scatterlayer .point").all()
        opacities = [p.evaluate("p => Number(getComputedStyle(p).opacity)") for p in points]
        assert [value > 0.5 for value in opacities[:3]] == [False, True, False]
        assert violations(page, axe, "report") == []
