"""The studio in a real browser: a take is opened, played, looked at and mended; a server that dies loses nothing."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import markerloom as ml
from test_mending import take as swing

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = next(filter(None, (shutil.which(n) for n in ("chromium", "chromium-browser", "google-chrome"))), None)
BUILT = Path(ml.__file__).parent / "studio/page/index.html"
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium: apt install chromium"),
    pytest.mark.skipif(
        not BUILT.is_file() and shutil.which("npm") is None, reason="the page is not built, and npm missing"
    ),
]
# Everybody runs in software here; without a sandbox because tests may run as root.
FLAGS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-angle=swiftshader"]
expect: Any = sync_api.expect


class Server:
    """`markerloom view` in a process of its own."""

    def __init__(self, what: Path, cache: Path) -> None:
        self.what, self.cache = what, cache
        self.start()

    def start(self) -> None:
        command = [sys.executable, "-m", "markerloom.cli", "view", str(self.what), "--no-browser"]
        env = {**os.environ, "XDG_CACHE_HOME": str(self.cache), "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env)
        assert self.process.stdout is not None
        found = re.search(r"http\S+", self.process.stdout.readline())
        assert found, "the server says no address"
        self.url = found.group()

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture
def view(tmp_path: Path) -> Iterator[Callable[[Path], Server]]:
    servers: list[Server] = []

    def start(what: Path) -> Server:
        servers.append(Server(what, tmp_path / "cache"))
        return servers[-1]

    yield start
    for one in servers:
        one.kill()


@pytest.fixture
def look(browser: Any) -> Iterator[Callable[[str], Any]]:
    context = browser.new_context(viewport={"width": 1440, "height": 900}, color_scheme="dark")
    errors: list[str] = []

    def open_page(url: str) -> Any:
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(url)
        return page

    yield open_page
    context.close()
    assert errors == []


@pytest.fixture
def file(tmp_path: Path) -> Path:
    swing(gap=(200, 229)).save(tmp_path / "swing.parquet")
    return tmp_path / "swing.parquet"


def marker(page: Any, name: str) -> Any:
    return page.locator(".markers").get_by_role("option", name=re.compile(rf"^{re.escape(name)}\s"))


def pick(page: Any, name: str, *, add: bool = False) -> None:
    marker(page, name).click(modifiers=["Shift"] if add else [])


def go_to(page: Any, frame: int) -> None:
    page.locator("#frame").fill(str(frame))
    page.locator("#frame").press("Enter")
    page.locator("#frame").blur()


def shown_mm(page: Any) -> list[float]:
    """The coordinates on the page."""
    text = page.locator("#coordinates .xyz").inner_text()
    return [float(v) for v in re.findall(r"-?\d+\.\d+", text)]


def sample(points: ml.Points, label: str, frame: int) -> list[float]:
    row = np.flatnonzero((points.label == label) & (points.frame == frame))
    return points.xyz_mm[row[0]].tolist()


def choose_frames(page: Any, first: int, last: int) -> None:
    page.locator("#range-first").fill(str(first))
    page.locator("#range-first").press("Enter")
    page.locator("#range-last").fill(str(last))
    page.locator("#range-last").press("Enter")
    page.locator("#range-last").blur()


def wait_until(true: Callable[[], bool]) -> None:
    """The page's policy forbids the polling of Playwright itself, which evaluates text."""
    for _ in range(200):
        if true():
            return
        time.sleep(0.05)
    raise AssertionError("it does not happen")


def says(page: Any, text: str) -> None:
    expect(page.locator("#status")).to_contain_text(text)


def test_a_take_is_opened_played_and_read(view: Any, look: Any, file: Path) -> None:
    page = look(view(file).url)
    says(page, "swing: 400 frames, 5 trajectories")
    expect(page.locator(".markers").get_by_role("option")).to_have_count(5)
    page.keyboard.press("Space")
    expect(page.locator("#play")).to_have_attribute("aria-label", "Stop")
    wait_until(lambda: page.evaluate("markerloom.state.row.get()") > 20)
    page.keyboard.press("Space")
    expect(page.locator("#play")).to_have_attribute("aria-label", "Play")
    pick(page, "C")
    points = ml.read_points(file)
    for frame in (10, 237, 409):
        go_to(page, frame)
        expect(page.locator("#coordinates h2")).to_have_text("C")
        expect(page.locator("#why")).to_contain_text(f"in frame {frame}")
        assert shown_mm(page) == pytest.approx(sample(points, "C", frame), abs=0.006)
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#frame")).to_have_value("408")


def test_two_markers_are_exchanged_undone_saved_and_exported(view: Any, look: Any, file: Path) -> None:
    server = view(file)
    page = look(server.url)
    pick(page, "A")
    pick(page, "B", add=True)
    choose_frames(page, 50, 59)
    page.keyboard.press("s")
    says(page, "B and A exchanged, frames 50 to 59")
    points = ml.read_points(file)
    pick(page, "A")
    go_to(page, 55)
    expect(page.locator("#why")).to_contain_text("in frame 55")
    wait_until(lambda: page.evaluate("markerloom.state.frames.get().peek(45) !== null"))
    assert shown_mm(page) == pytest.approx(sample(points, "B", 55), abs=0.006)
    page.keyboard.press("Control+z")
    says(page, "undone")
    page.keyboard.press("Control+Shift+Z")
    says(page, "done again")
    page.reload()
    says(page, "swing: 400 frames")
    page.locator("#tab-edits").click()
    expect(page.locator("#edits li")).to_have_count(1)
    page.locator("#export").click()
    says(page, "swing-mended.c3d: 1 edits")
    made = ml.read_points(file.parent / "swing-mended.c3d")
    np.testing.assert_allclose(sample(made, "A", 45), sample(points, "B", 55), atol=1e-3)
    np.testing.assert_allclose(sample(made, "A", 35), sample(points, "A", 45), atol=1e-3)


def test_a_gap_is_found_compared_and_filled(view: Any, look: Any, file: Path) -> None:
    page = look(view(file).url)
    says(page, "swing:")
    page.keyboard.press("g")
    expect(page.locator("#frame")).to_have_value("200")
    expect(page.locator("#coordinates")).to_contain_text("no sample in this frame")
    expect(page.locator("#why")).to_contain_text("missing from frame 200 to 229 (30 frames, 0.30 s)")
    page.get_by_role("button", name="Compare methods").click()
    expect(page.locator(".way")).to_have_count(10)
    page.get_by_role("button", name="Fill with rigid").click()
    says(page, "A filled (rigid), frames 200 to 229")
    expect(page.locator("#coordinates")).to_contain_text("filled")
    filled = ml.fill(ml.read_points(file), method="rigid")
    assert shown_mm(page) == pytest.approx(sample(filled, "A", 200), abs=0.006)
    page.locator("#tab-findings").click()
    expect(page.locator("#panel-findings")).not_to_contain_text("is missing")


def test_naming_with_suggestions_cutting_and_joining(view: Any, look: Any, tmp_path: Path) -> None:
    points = swing()
    late = (points.label == "C") & (points.frame >= 250)
    points.label[late], points.track[late] = "", 9
    points.save(tmp_path / "cut.parquet")
    page = look(view(tmp_path / "cut.parquet").url)
    pick(page, "*9")
    page.get_by_role("button", name="Suggest").click()
    page.get_by_role("button", name=re.compile(r"^C \(")).click()
    says(page, "*9 is C")
    expect(page.locator(".markers").get_by_role("option")).to_have_count(5)
    pick(page, "C")
    go_to(page, 100)
    page.keyboard.press("x")
    says(page, "C cut at frame 100")
    expect(page.locator(".markers").get_by_role("option")).to_have_count(6)
    page.keyboard.press("q")
    page.keyboard.type("NECK")
    page.keyboard.press("Enter")
    says(page, "is NECK")


def test_a_server_that_is_killed_loses_nothing(view: Any, look: Any, file: Path) -> None:
    server = view(file)
    page = look(server.url)
    pick(page, "D")
    go_to(page, 30)
    page.keyboard.press("u")
    says(page, "D loses its name")
    server.kill()
    expect(page.locator("#banner")).to_be_visible()
    expect(page.locator("#banner")).to_contain_text("The server does not answer")
    pick(page, "E")
    page.keyboard.press("q")
    page.keyboard.type("ELBOW")
    page.keyboard.press("Enter")
    says(page, "does not answer")
    server.start()
    expect(page.locator("#banner")).to_be_hidden(timeout=20_000)
    expect(page.locator("#status")).to_contain_text("E is ELBOW", timeout=20_000)
    assert [x.op for x in ml.read_edits(ml.edits_path(file)).edits] == ["unlabel", "label"]


def test_two_windows_see_each_others_edits(view: Any, look: Any, file: Path) -> None:
    server = view(file)
    first, second = look(server.url), look(server.url)
    says(second, "swing:")
    pick(first, "A")
    first.keyboard.press("u")
    says(first, "A loses its name")
    says(second, "changed in another window")
    expect(marker(second, "A")).to_have_count(0)


def test_a_camera_is_left_out_and_the_take_reconstructed_again(view: Any, look: Any, tmp_path: Path) -> None:
    ml.save(ml.simulate(ml.make_scene("walk", frames=60, seed=3)), tmp_path / "sim")
    (tmp_path / "markerloom.toml").write_text(
        'name = "walks"\ncalibration = "sim/calibration.toml"\n[settings]\nfill = "none"\n'
        '[takes.walk]\nfile = "sim/observations.parquet"\n'
    )
    page = look(view(tmp_path).url)
    expect(page.locator("#status")).to_contain_text("walk: 60 frames", timeout=60_000)
    before = ml.read_points(tmp_path / "results/walk/track.parquet")
    page.locator("#tab-cameras").click()
    expect(page.locator(".coverage")).to_have_count(8)
    page.locator("#exclude-camera").click()
    says(page, "left out, frames 0 to 59")
    page.locator("#tab-edits").click()
    page.locator("#reconstruct").click()
    expect(page.locator("#status")).to_contain_text("walk: 60 frames", timeout=60_000)
    expect(page.locator("#reconstruct")).to_have_count(0)
    after = ml.read_points(tmp_path / "results/walk/track.parquet")
    assert after.rays[after.kind == 0].mean() < before.rays[before.kind == 0].mean() - 0.3
    assert (tmp_path / "results/walk/walk.c3d").is_file()
    page.locator("#undo").click()
    says(page, "undone")


def test_a_browser_without_webgl_still_mends(view: Any, browser: Any, file: Path) -> None:
    server = view(file)
    context = browser.new_context(viewport={"width": 1200, "height": 800})
    page = context.new_page()
    page.add_init_script(
        "const get = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {"
        "  return kind.startsWith('webgl') ? null : get.call(this, kind, ...rest); }"
    )
    page.goto(server.url)
    expect(page.locator("#view-3d")).to_contain_text("This browser shows no 3D")
    pick(page, "A")
    expect(page.locator("#graphs canvas")).to_have_count(1)
    page.keyboard.press("u")
    says(page, "A loses its name")
    context.close()


def test_a_broken_take_is_told_and_the_others_open(view: Any, look: Any, tmp_path: Path) -> None:
    (tmp_path / "takes").mkdir()
    (tmp_path / "takes/broken.c3d").write_bytes(b"nonsense")
    swing().save(tmp_path / "takes/good.parquet")
    (tmp_path / "markerloom.toml").write_text('name = "mixed"\n')
    page = look(view(tmp_path).url)
    expect(page.locator("#failure")).to_contain_text("broken cannot be shown")
    page.get_by_role("combobox", name="Take", exact=True).select_option("good")
    says(page, "good: 400 frames")
    expect(page.locator("#failure")).to_be_hidden()


def test_a_file_that_goes_while_it_is_open_is_told(view: Any, look: Any, file: Path) -> None:
    page = look(view(file).url)
    says(page, "swing:")
    file.rename(file.with_name("elsewhere.parquet"))
    expect(page.locator("#banner")).to_contain_text("is gone from disk", timeout=10_000)
    file.with_name("elsewhere.parquet").rename(file)
    expect(page.locator("#banner")).to_be_hidden(timeout=10_000)


def test_a_page_that_holds_its_take_needs_no_server(look: Any, file: Path, tmp_path: Path) -> None:
    env = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")}
    command = [sys.executable, "-m", "markerloom.cli", "view", str(file), "--page", str(tmp_path / "swing.html")]
    subprocess.run(command, check=True, env=env, capture_output=True)
    page = look("about:blank")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto((tmp_path / "swing.html").as_uri())
    says(page, "swing: 400 frames, 5 trajectories")
    pick(page, "C")
    go_to(page, 237)
    expect(page.locator("#why")).to_contain_text("C is measured in frame 237")
    assert shown_mm(page) == pytest.approx(sample(ml.read_points(file), "C", 237), abs=0.006)
    page.keyboard.press("Escape")
    page.keyboard.press("Shift+G")
    expect(page.locator("#frame")).to_have_value("200")
    expect(page.get_by_role("button", name="Fill", exact=True)).to_have_count(0)
    page.keyboard.press("u")
    says(page, "it is mended in the studio")
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


def test_the_wrong_token_shows_what_to_do(view: Any, look: Any, file: Path) -> None:
    url = view(file).url
    page = look(re.sub(r"token=.*", "token=wrong", url))
    assert "open the address that" in page.inner_text("body")


def test_everything_can_be_reached_by_keyboard(view: Any, look: Any, file: Path) -> None:
    page = look(view(file).url)
    says(page, "swing:")
    unnamed = page.evaluate(
        "[...document.querySelectorAll('button, input, select, [tabindex]')].filter(e => e.offsetParent &&"
        " !(e.getAttribute('aria-label') || e.textContent.trim() || e.labels?.length || e.title)).map(e => e.outerHTML)"
    )
    assert unnamed == []
    page.keyboard.press("?")
    expect(page.locator("#help")).to_be_visible()
    expect(page.locator("#help kbd").first).to_be_visible()
    page.keyboard.press("Escape")
    page.locator("#tab-marker").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#tab-findings")).to_have_attribute("aria-selected", "true")
    page.locator("#tab-findings").blur()
    page.keyboard.press("ArrowDown")
    assert page.evaluate("markerloom.state.selection.get()") == [0]
    seen = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        seen.add(page.evaluate("document.activeElement.id || document.activeElement.textContent"))
    assert {"play", "frame", "next-gap", "theme", "show-help"} <= seen
