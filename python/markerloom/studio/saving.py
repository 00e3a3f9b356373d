"""The mended take as a file: the take itself, and its edits by the same function as `mend` and `process`."""

from __future__ import annotations

from pathlib import Path

from markerloom import formats
from markerloom.errors import InputError
from markerloom.mending import mend
from markerloom.project.process import automatic
from markerloom.studio import messages
from markerloom.studio.opened import OpenTake, results_of
from markerloom.studio.standalone import save_page


def export(take: OpenTake, wanted: messages.ExportRequest, is_project: bool) -> messages.Done:
    """Write the mended take beside its file, or into its results where it belongs to a project."""
    source = Path(take.settings.file)
    folder = results_of(take.project, take.settings) if is_project else source.parent
    if Path(wanted.file).name != wanted.file or wanted.file.startswith("."):
        raise InputError(f"'{wanted.file}' is not the plain name of a file")
    if formats.ending(wanted.file) not in (*formats.POINTS_WRITTEN, ".html"):
        raise InputError(f"takes are written as {', '.join(formats.POINTS_WRITTEN)} or .html, not as {wanted.file}")
    target = folder / wanted.file
    if target.resolve() == source.resolve():
        raise InputError("the take itself is never changed: export it under another name")
    if target.exists() and not wanted.overwrite:
        raise InputError(f"{wanted.file} is there already: export it under another name, or say that it may go")
    if take.dots_pending:
        raise InputError("centroids were left out since the take was reconstructed: reconstruct it first")
    if formats.ending(wanted.file) == ".html":
        return save_page(take, target)
    made = automatic(take.project, take.settings)
    mended = mend(made.points, take.edits)
    formats.write_points(mended, target)
    unfit = f"; {len(mended.report['unfit'])} edits do not fit" if mended.report["unfit"] else ""
    return messages.Done(message=f"{wanted.file}: {mended.report['applied']} edits{unfit}", path=str(target))
