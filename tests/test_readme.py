"""The README's commands and the examples do what they say."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*/*.py"))
LAST_LINES = {
    "first_points.py": r"\d+ points in 50 frames, 100 % of frames certified",
    "three_methods.py": r"optimal +found (99\.9\d|100\.00) %, ghosts per frame 0\.0\d",
    "edit_motions.py": r"along the line: 0\.\d\d m rms from it",
    "capture.py": r"\d+ dots of 2 cameras → out/capture/dots.csv",
    "your_own_rig.py": r"point \[0\.2, 0\.1, 1\.3\] m, uncertain by 0\.\d\d mm",
}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda p: p.name)
def test_every_example_runs_and_prints_what_it_promises(example: Path, tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, example], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(LAST_LINES[example.name], done.stdout.strip().splitlines()[-1]), done.stdout


def test_the_readmes_make_targets_exist() -> None:
    targets = re.findall(r"`?make (\w+)`?", (ROOT / "README.md").read_text())
    makefile = (ROOT / "Makefile").read_text()
    assert {"demo", "test"} <= set(targets)
    for target in targets:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def test_the_readmes_shell_commands_run(tmp_path: Path) -> None:
    """The lines that start with `markerloom` in the README, in order, in an empty folder."""
    blocks = re.findall(r"```sh\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines() if line.startswith("markerloom")]
    assert lines
    for line in lines:
        command = [sys.executable, "-m", "markerloom.cli", *line.split()[1:]]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{line}\n{done.stderr}"


def test_links_in_the_documentation_lead_somewhere() -> None:
    for page in [ROOT / "README.md", ROOT / "ARCHITECTURE.md", *(ROOT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"
