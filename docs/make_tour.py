"""The studio's pictures in docs/tour: the demo, looked at in headless Chromium; run by `make tour`."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from markerloom.demo import demo

FOLDER = Path(__file__).parent / "tour"
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def pick(page: Page, name: str) -> None:
    """Select a marker."""
    page.locator(".markers").get_by_role("option", name=re.compile(rf"^{name}\s")).click()


def go_to(page: Page, frame: int) -> None:
    """Go to a frame."""
    page.locator("#frame").fill(str(frame))
    page.locator("#frame").press("Enter")
    page.locator("#frame").blur()


def choose_frames(page: Page, first: int, last: int) -> None:
    """Select frames."""
    for name, value in (("first", first), ("last", last)):
        page.locator(f"#range-{name}").fill(str(value))
        page.locator(f"#range-{name}").press("Enter")
    page.locator("#range-last").blur()


def look(page: Page) -> None:
    """A marker, its rays, its dots and its path."""
    pick(page, "LTOE")
    go_to(page, 245)
    page.get_by_role("button", name="whole path").click()


def mend(page: Page) -> None:
    """A gap, and how each method would fill it."""
    pick(page, "RELB")
    go_to(page, 215)
    choose_frames(page, 200, 239)
    page.keyboard.press("Delete")
    time.sleep(0.5)
    page.get_by_role("button", name="Compare methods").click()
    page.locator(".way").first.wait_for()
    page.get_by_role("combobox", name="Graph").select_option("velocity")


def cameras(page: Page) -> None:
    """What the cameras saw, and what the rig is worth."""
    page.locator("#tab-cameras").click()
    page.locator("#show-accuracy").click()
    page.get_by_role("button", name="Hide").wait_for(timeout=60_000)
    page.keyboard.press("1")
    page.locator("#fit").click()
    for _ in range(6):
        page.mouse.move(400, 300)
        page.mouse.wheel(0, 240)
        time.sleep(0.1)


def keys(page: Page) -> None:
    """All keys."""
    page.keyboard.press("?")


PICTURES: dict[str, tuple[Callable[[Page], None], str]] = {
    "look": (look, "dark"),
    "mend": (mend, "light"),
    "cameras": (cameras, "dark"),
    "keys": (keys, "light"),
}


def main() -> None:
    """Make the demo, serve it, and take the pictures."""
    FOLDER.mkdir(exist_ok=True)
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder:
        demo(folder, frames=300)
        command = [sys.executable, "-m", "markerloom.cli", "view", folder, "--no-browser"]
        env = {**os.environ, "XDG_CACHE_HOME": f"{folder}/cache", "PYTHONUNBUFFERED": "1"}
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env)
        assert server.stdout is not None
        address = re.search(r"http\S+", server.stdout.readline())
        assert address
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
            for name, (act, theme) in PICTURES.items():
                context = browser.new_context(viewport={"width": 1360, "height": 850}, color_scheme=theme)  # pyright: ignore[reportArgumentType]
                page = context.new_page()
                page.goto(f"{address.group()}&take=walk")
                page.get_by_text("walk: ").first.wait_for(timeout=60_000)
                time.sleep(1.5)
                act(page)
                time.sleep(2.0)
                page.screenshot(path=FOLDER / f"{name}.png")
                context.close()
            browser.close()
        server.terminate()
        server.wait()


if __name__ == "__main__":
    main()
