"""The studio on long and full takes: opening, scrubbing, playing, memory; run as `python benches/studio.py [hours]`.

An hour at 120 Hz with 100 markers, and ten people of 53 markers, in headless Chromium without a GPU (SwiftShader).
Frames are counted where they were drawn with their samples.
"""

from __future__ import annotations

import gzip
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Page, sync_playwright

from markerloom import _core
from markerloom.formats import c3d_file
from markerloom.points import Points
from markerloom.studio.page import built_page

RATE_HZ = 120.0
MOUSE_S = 0.008
"""Mice tell where they are 125 times a second."""
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--enable-precise-memory-info"]


def long_take(path: Path, hours: float, markers: int) -> None:
    """A C3D of markers that swing about places, with a gap now and then; written column by column to save memory."""
    frames = round(hours * 3600 * RATE_HZ)
    rng = np.random.default_rng(0)
    at = rng.uniform([-1500, -1500, 200], [1500, 1500, 1800], (markers, 3))
    phase, speed = rng.uniform(0, 6, (markers, 3)), rng.uniform(1, 4, (markers, 3))
    seconds = np.arange(frames) / RATE_HZ
    xyz = np.empty((frames, markers, 3))
    for i in range(markers):
        xyz[:, i] = at[i] + 150.0 * np.sin(seconds[:, None] * speed[i] + phase[i])
    words = np.ones((frames, markers))
    for i in range(markers):
        for start in rng.integers(1, frames - 200, max(1, frames // 20_000)):
            words[start : start + int(rng.integers(5, 60)), i] = -1.0
    xyz[words < 0] = 0.0
    file = _core.C3d.empty(RATE_HZ, 1)
    file.set_points(xyz, words)
    c3d_file._set_standard_groups(file, [f"M{i:03d}" for i in range(markers)], frames, RATE_HZ)
    c3d_file.write_file(file, path)


def people(path: Path, count: int, seconds: float) -> None:
    """People of 53 markers who walk side by side: one simulated walk, moved."""
    from markerloom.simulate import make_scene, simulate

    frames = round(seconds * 100)
    truth = simulate(make_scene("walk", frames=frames, marker_set="front-waist-53", cameras=2)).truth
    names, slots = truth.slots()
    one = np.full((frames, len(names), 3), np.nan)
    one[truth.frame, slots] = truth.xyz_mm
    every = np.concatenate([one + np.array([800.0 * (p % 5), 1500.0 * (p // 5), 0.0]) for p in range(count)], axis=1)
    frame, slot = np.nonzero(np.isfinite(every).all(axis=2))
    labels = np.array([f"P{p}:{n}" for p in range(count) for n in names])
    Points.of(frame, slot, every[frame, slot], label=labels[slot], rate_hz=100.0, source="people").save(path)


@contextmanager
def studio(what: Path, cache: Path) -> Iterator[tuple[str, int]]:
    """A running server: its address and its process."""
    command = [sys.executable, "-m", "markerloom.cli", "view", str(what), "--no-browser"]
    env = {**os.environ, "XDG_CACHE_HOME": str(cache), "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env)
    assert process.stdout is not None
    found = re.search(r"http\S+", process.stdout.readline())
    assert found
    try:
        yield found.group(), process.pid
    finally:
        process.terminate()
        process.wait()


def until(page: Page, expression: str, limit_s: float = 600.0) -> float:
    """Seconds until something is true of the page."""
    clock = time.perf_counter()
    while not page.evaluate(expression):
        if time.perf_counter() - clock > limit_s:
            raise SystemExit(f"it never happened: {expression}")
        time.sleep(0.01)
    return time.perf_counter() - clock


def first_frame(page: Page, url: str) -> float:
    """Seconds from the address to the first frame with its markers."""
    clock = time.perf_counter()
    page.goto(url)
    until(page, "window.markerloom !== undefined && window.markerloom.drawn() > 0")
    return time.perf_counter() - clock


DRAG = """([x, y, width, seconds, every]) => new Promise((done) => {
  const canvas = document.querySelector("#timeline canvas");
  const point = (type, share, target) =>
    target.dispatchEvent(new PointerEvent(type, { clientX: x + width * share, clientY: y, bubbles: true }));
  point("pointerdown", 0, canvas);
  const [before, start] = [window.markerloom.drawn(), performance.now()];
  const mouse = setInterval(() => {
    const passed = (performance.now() - start) / 1000;
    point("pointermove", Math.abs(((passed * 0.47) % 2) - 1), window);
    if (passed < seconds) return;
    clearInterval(mouse);
    point("pointerup", 0, window);
    done((window.markerloom.drawn() - before) / passed);
  }, 1000 * every);
})"""


def scrubbed(page: Page, seconds: float) -> float:
    """Frames drawn per second while the playhead is dragged over the whole take, forth and back, every two seconds."""
    box = page.locator("#timeline").bounding_box()
    assert box
    return page.evaluate(DRAG, [box["x"] + 110, box["y"] + 12, box["width"] - 120, seconds, MOUSE_S])


def played(page: Page, seconds: float) -> float:
    """Frames drawn per second while the take plays."""
    page.keyboard.press("Space")
    time.sleep(0.5)
    before, clock = page.evaluate("window.markerloom.drawn()"), time.perf_counter()
    time.sleep(seconds)
    rate = (page.evaluate("window.markerloom.drawn()") - before) / (time.perf_counter() - clock)
    page.keyboard.press("Space")
    return rate


def own_mb(pid: int) -> float:
    """Memory that a process has for itself: without pages of files, which the system may drop (MB)."""
    text = Path(f"/proc/{pid}/status").read_text("utf-8")
    return int(re.findall(r"RssAnon:\s+(\d+)", text)[0]) / 1024


def heap_mb(page: Page) -> float:
    """The page's JavaScript heap (MB)."""
    return page.evaluate("performance.memory.usedJSHeapSize") / 1e6


def measure(page: Page, what: Path, cache: Path, name: str) -> None:
    """Print a take's figures."""
    with studio(what, cache) as (url, _):
        imported = first_frame(page, url)
    with studio(what, cache) as (url, pid):
        opened = first_frame(page, url)
        rates: dict[str, Any] = {"scrub": scrubbed(page, 6.0), "play": played(page, 5.0)}
        size = what.stat().st_size / 1e6
        print(
            f"{name} ({size:.0f} MB): imported and shown in {imported:.1f} s, opened again in {opened:.2f} s; "
            f"scrubbed at {rates['scrub']:.0f}, played at {rates['play']:.0f} frames/s; "
            f"server {own_mb(pid):.0f} MB, page {heap_mb(page):.0f} MB"
        )


def main() -> None:
    """Make the takes, look at them, and print."""
    hours = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
    page_files = [f for f in built_page().rglob("*") if f.is_file()]
    packed = sum(len(gzip.compress(f.read_bytes())) for f in page_files)
    print(f"page: {sum(f.stat().st_size for f in page_files) / 1e3:.0f} kB, gzipped {packed / 1e3:.0f} kB")
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        root = Path(folder)
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        people(root / "people.c3d", 10, 10.0)
        measure(page, root / "people.c3d", root / "cache", "10 people, 530 markers, 10 s at 100 Hz")
        long_take(root / "long.c3d", hours, 100)
        measure(page, root / "long.c3d", root / "cache", f"{hours:g} h at 120 Hz, 100 markers")
        browser.close()


if __name__ == "__main__":
    main()
