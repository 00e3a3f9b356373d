"""The verb ``process`` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from markerloom import report as reports
from markerloom.errors import InputError
from markerloom.project.process import process as run_process
from markerloom.project.settings import FILE
from markerloom.studio.standalone import save_view


def process(
    project: Annotated[Path, typer.Argument(help=f"A folder with a {FILE}.")],
    takes: Annotated[str | None, typer.Option(help="Only these, with commas between.")] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="Write a report as JSON.", metavar="FILE.json")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False,
) -> None:
    """Take a project's takes the whole way: track, label, fill, export; what did not change is not computed again.

    Example: markerloom process sessions/friday
    """
    wanted = None if takes is None else takes.split(",")
    result = run_process(project, takes=wanted, say=None if quiet else typer.echo, viewer=save_view)
    if report is not None:
        reports.save(reports.of_run([], {"project": project.name, "takes": wanted}, result), report)
    if result["failed"]:
        names = ", ".join(f"'{f['take']}'" for f in result["failed"])
        raise InputError(
            f"{len(result['failed'])} takes failed ({names}); the others are done: see results/report.html"
        )
