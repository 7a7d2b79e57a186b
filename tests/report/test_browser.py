"""The page in a real browser: it draws itself without a request, and all of it moves together.

Debian's Chromium by Playwright's core: `apt-get install chromium`, `pip install playwright`. The
tests skip where one of them is missing.
"""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from run_folders import write_run, write_true_folder

from ovmot.cameras.rig import StereoRig
from ovmot.report.page import batch_page
from ovmot.report.report import write_report

pytestmark = [pytest.mark.browser, pytest.mark.xdist_group("browser")]

WIDE, NARROW = (1400, 1000), (390, 844)
EVIL = "</script><img src=x onerror=document.title='evil'>"


@dataclass
class Opened:
    """A page in the browser, and what it said and asked for."""

    page: Any
    said: list[str]
    asked: list[str]

    def settle(self) -> None:
        """Let observers and frames run."""
        self.page.evaluate(
            "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )

    def set_time(self, index: int) -> None:
        """Move the slider as a hand does."""
        self.page.evaluate(
            "i => { const s = document.getElementById('time'); s.value = i;"
            " s.dispatchEvent(new Event('input')); }",
            index,
        )
        self.settle()

    def map_pixels(self) -> str:
        """The map as it is drawn."""
        drawn: str = self.page.evaluate("() => document.getElementById('map').toDataURL()")
        return drawn

    def column(self, number: int) -> list[str]:
        """The texts of a column of the objects' table."""
        texts: list[str] = self.page.locator(
            f"#objects tbody tr td:nth-child({number})"
        ).all_inner_texts()
        return texts


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    api = pytest.importorskip("playwright.sync_api", reason="pip install playwright")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("no Chromium: apt-get install chromium")
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture
def open_page(browser: Any) -> Iterator[Callable[..., Opened]]:
    """Opens a file in a window of a size and a colour scheme."""
    contexts = []

    def opened(path: Path, size: tuple[int, int] = WIDE, scheme: str = "light") -> Opened:
        context = browser.new_context(
            viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, offline=True
        )
        contexts.append(context)
        page = context.new_page()
        said: list[str] = []
        asked: list[str] = []
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.resolve().as_uri())
        found = Opened(page, said, asked)
        found.settle()
        return found

    yield opened
    for context in contexts:
        context.close()


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory, painted_rig: StereoRig) -> Path:
    folder = tmp_path_factory.mktemp("browser")
    run = write_run(folder / "street", painted_rig, warning=EVIL)
    return write_report([run], truth=write_true_folder(folder / "truth"))


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [WIDE, NARROW])
def test_no_error_and_no_request(
    open_page: Callable[..., Opened], report: Path, size: tuple[int, int], scheme: str
) -> None:
    opened = open_page(report, size, scheme)
    for index in (0, 10, 39):
        opened.set_time(index)
    assert opened.said == []
    assert [url for url in opened.asked if not url.startswith("data:")] == [
        report.resolve().as_uri()
    ]
    wide, window = opened.page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert wide <= window  # nothing sticks out at the side
    assert opened.page.evaluate("document.documentElement.dataset.theme") == scheme
    assert "the true objects" in opened.page.locator("#map-key").inner_text()


@pytest.mark.parametrize("size", [WIDE, NARROW])
def test_the_slider_moves_frame_map_and_plots(
    open_page: Callable[..., Opened], report: Path, size: tuple[int, int]
) -> None:
    opened = open_page(report, size)
    image = opened.page.locator("#views img")
    seen = []
    for index in (2, 30):
        opened.set_time(index)
        lines = opened.page.locator("#plots .now")
        times = {line.get_attribute("data-time") for line in lines.all()}
        assert len(times) == 1  # all plots stand at one time
        seen.append((image.get_attribute("src"), opened.map_pixels(), *times))
        assert opened.page.locator("#now").inner_text() == f"{0.1 * index:.2f} s"
    assert lines.count() == 10  # two of speeds, six of errors, NEES, stages
    assert all(before != after for before, after in zip(*seen, strict=True))
    assert image.evaluate("image => image.naturalWidth") == 800


def test_the_table_sorts_both_ways(open_page: Callable[..., Opened], report: Path) -> None:
    opened = open_page(report)
    assert [text.strip() for text in opened.column(2)] == ["#1", "#2"]  # by the first time
    head = opened.page.locator("#objects th button", has_text="nearest")
    number = 9
    ups = opened.page.locator("#objects th[aria-sort=ascending]")
    head.click()
    assert "nearest" in ups.inner_text()
    rising = opened.column(number)
    head.click()
    assert opened.column(number) == rising[::-1] != rising


def test_keys_move_the_time(open_page: Callable[..., Opened], report: Path) -> None:
    opened = open_page(report)
    opened.page.keyboard.press("ArrowRight")
    opened.page.keyboard.press("ArrowRight")
    assert opened.page.locator("#now").inner_text() == "0.20 s"
    opened.page.locator("#time").focus()
    opened.page.keyboard.press("End")
    assert opened.page.locator("#now").inner_text() == "3.90 s"
    opened.page.locator("#map").focus()
    before = opened.map_pixels()
    opened.page.keyboard.press("+")
    opened.settle()
    assert opened.map_pixels() != before
    assert opened.said == []


def test_play_goes_on_and_stops(open_page: Callable[..., Opened], report: Path) -> None:
    opened = open_page(report)
    button = opened.page.locator("#play")
    button.click()
    for _ in range(200):
        if opened.page.evaluate("clock.index") > 2:
            break
        opened.page.wait_for_timeout(50)
    button.click()
    assert opened.page.evaluate("clock.index") > 2
    stopped = opened.page.evaluate("clock.index")
    opened.settle()
    assert opened.page.evaluate("clock.index") == stopped
    assert button.get_attribute("aria-label") == "Play"


def test_the_theme_can_be_changed(open_page: Callable[..., Opened], report: Path) -> None:
    opened = open_page(report)
    background = "getComputedStyle(document.body).backgroundColor"
    light = opened.page.evaluate(background)
    opened.page.locator("#theme").click()
    opened.settle()
    assert opened.page.evaluate(background) != light
    assert opened.page.locator("#plots canvas").count() == 10
    assert opened.said == []


def test_texts_from_files_stay_texts(open_page: Callable[..., Opened], report: Path) -> None:
    opened = open_page(report)
    assert EVIL in opened.page.locator("#warnings").inner_text()
    assert opened.page.title() == "ovmot: street"
    assert opened.page.locator("#warnings img").count() == 0


def test_several_runs_side_by_side(
    open_page: Callable[..., Opened], tmp_path: Path, painted_rig: StereoRig
) -> None:
    runs = [write_run(tmp_path / name, painted_rig, 20, preview=name != "c") for name in "abc"]
    opened = open_page(write_report(runs, tmp_path / "page.html"))
    opened.set_time(12)
    assert opened.page.locator("#views figure").count() == 3
    assert opened.page.locator("#views img").count() == 2
    assert opened.page.locator("#overview tbody tr").count() == 3
    assert opened.page.locator("#objects tbody tr").count() == 6
    assert opened.said == []


def test_a_run_without_objects_and_truth(
    open_page: Callable[..., Opened], tmp_path: Path, painted_rig: StereoRig
) -> None:
    run = write_run(tmp_path / "short", painted_rig, 1, preview=False)
    (run / "tracks.csv").unlink()
    (run / "timing.csv").unlink()
    opened = open_page(write_report([run]), NARROW)
    assert "No moving object" in opened.page.locator("#objects").inner_text()
    assert opened.said == []


def test_the_page_of_a_batch(open_page: Callable[..., Opened], tmp_path: Path) -> None:
    for link in ("a/0", "a/1"):
        (tmp_path / link).mkdir(parents=True)
        (tmp_path / link / "report.html").write_text("<title>a run</title>")
    runs = [
        {"name": f"{name}/{seed}", "sequence": name, "settings": "default",
         "report": f"{name}/{seed}/report.html" if name == "a" else None,
         "metrics": {"ate_yaw_m": 0.1 * (seed + 1)}}
        for name in "ab" for seed in (0, 1)
    ]  # fmt: skip
    spread = {
        "sequence": "a", "settings": "default", "metric": "ate_yaw_m", "count": 2, "mean": 0.15,
        "median": 0.15, "std": None, "least": 0.1, "greatest": 0.2, "usual": True,
        "values": [0.1, 0.2],
    }  # fmt: skip
    contents = {
        "name": EVIL, "failures": {"b/7": EVIL}, "metrics": ["ate_yaw_m"], "runs": runs,
        "spreads": [spread, {**spread, "metric": "poses", "usual": False}],
        "worst": [{"metric": "ate_yaw_m", "run": 1, "value": 0.2, "median": 0.15}],
        "consistency": [{"sequence": "a", "settings": "default", "metric": "nees_pose", "runs": 2,
                         "mean": 9.0, "low": 5.0, "high": 7.0}],
    }  # fmt: skip
    (tmp_path / "report.html").write_text(batch_page(contents), encoding="utf-8")
    for size, scheme in ((WIDE, "light"), (NARROW, "dark")):
        opened = open_page(tmp_path / "report.html", size, scheme)
        assert opened.said == []
        assert EVIL in opened.page.locator("#failures").inner_text()
        assert opened.page.locator("#spreads tbody tr").count() == 1
        assert opened.page.locator("#spreads circle").count() == 2
        assert "overconfident" in opened.page.locator("#consistency").inner_text()
        opened.page.locator("#spreads button", has_text="All 2 rows").click()
        assert opened.page.locator("#spreads tbody tr").count() == 2
        opened.page.locator("#runs th button", has_text="ate_yaw_m").click()
        opened.page.locator("#runs th button", has_text="ate_yaw_m").click()
        assert opened.page.locator("#runs tbody tr").first.inner_text().startswith("a/1")
    opened.page.locator("#worst a").click()
    assert opened.page.url.endswith("a/1/report.html")
