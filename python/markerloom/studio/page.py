"""The built page: in the wheel, or made from `web/` where its sources are newer than what was built."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from markerloom.errors import InputError

BUILT = Path(__file__).parent / "page"
SOURCES = Path(__file__).parents[3] / "web"
"""Of a checkout; a wheel has none."""


def built_page() -> Path:
    """The folder of the page, built first where that is needed. Raises ``InputError`` where it cannot be built."""
    if not (SOURCES / "package.json").is_file():
        return _there()
    newest = max(f.stat().st_mtime_ns for f in _sources())
    index = BUILT / "index.html"
    if index.is_file() and index.stat().st_mtime_ns >= newest:
        return BUILT
    npm = shutil.which("npm")
    if npm is None:
        if index.is_file():
            return BUILT
        raise InputError("the page is not built: install Node 20 or newer (it brings npm) and run `make web`")
    steps = [[npm, "run", "--silent", "build"]]
    if not (SOURCES / "node_modules" / ".package-lock.json").is_file():
        steps.insert(0, [npm, "ci", "--no-audit", "--no-fund"])
    for step in steps:
        done = subprocess.run(step, cwd=SOURCES, capture_output=True, text=True, check=False)
        if done.returncode:
            raise InputError(f"the page could not be built: {(done.stderr or done.stdout).strip()[-800:]}")
    return _there()


def page_is_built() -> bool:
    """Whether the page is there: nothing but looking at a take waits for it to be built."""
    return (BUILT / "index.html").is_file()


def _there() -> Path:
    if not (BUILT / "index.html").is_file():
        raise InputError("the page is missing from this installation: install markerloom again")
    return BUILT


def _sources() -> list[Path]:
    return [f for f in SOURCES.rglob("*") if f.is_file() and "node_modules" not in f.parts]
