"""Marker sets and subjects of a project, for the editor."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from markerloom.errors import InputError, MarkerloomError
from markerloom.project import Project
from markerloom.studio import messages
from markerloom.studio.opened import OpenTake
from markerloom.subjects import (
    MarkerSet,
    create_subject,
    marker_sets,
    read_marker_set,
    read_subject,
    with_markers,
    write_marker_set,
    write_subject,
)

MOST_TOLD = 12
LEAST_MARKERS = 3


def known_sets(project: Project) -> list[str]:
    """Names of the sets that can be looked at: those that takes wear, those in the project's folder, markerloom's."""
    own = {Path(t.marker_set).name for t in project.takes if Path(t.marker_set).is_file()}
    for file in sorted(project.folder.glob("*.toml")) if project.folder.is_dir() else ():
        try:
            read_marker_set(file)
        except MarkerloomError:
            continue
        own.add(file.name)
    worn = sorted({t.marker_set for t in project.takes} & set(marker_sets()))
    return list(dict.fromkeys([*worn, *sorted(own), *marker_sets()]))


def marker_set_view(project: Project, name: str) -> messages.MarkerSetView:
    """A set to be looked at."""
    made = read_marker_set(_source(project, name))
    markers = [
        messages.MarkerView(
            name=marker,
            side=made.sides[i] or "middle",  # pyright: ignore[reportArgumentType]
            segment=made.segments[i],
            color=made.colors[i],
            place=tuple(made.places[i].tolist()) if np.isfinite(made.places[i]).all() else None,
        )
        for i, marker in enumerate(made.markers)
    ]
    return messages.MarkerSetView(name=made.name, title=made.title, markers=markers, links=list(made.rigid_pairs))


def _source(project: Project, name: str) -> str | Path:
    if name not in known_sets(project):
        raise InputError(f"there is no marker set '{name}'; there are {', '.join(known_sets(project))}")
    return project.folder / name if (project.folder / name).is_file() else name


def save_marker_set(project: Project, name: str, view: messages.MarkerSetView) -> messages.Done:
    """Write a set into the project's folder; those of markerloom itself are never changed."""
    if Path(name).name != name or not name.endswith(".toml") or name == "markerloom.toml" or name.startswith("."):
        raise InputError(f"'{name}': a marker set is saved as NAME.toml in the project's folder")
    file = project.folder / name
    if file.exists() and name not in known_sets(project):
        raise InputError(f"{name} is there already, and is no marker set")
    names = [one.name for one in view.markers]
    if not names:
        raise InputError("a marker set has at least one marker")
    again = sorted({n for n in names if names.count(n) > 1})
    if again or "" in names:
        raise InputError(f"two markers are called '{again[0]}'" if again else "every marker has a name")
    strangers = sorted({n for pair in view.links for n in pair} - set(names))
    if strangers:
        raise InputError(f"a link names '{strangers[0]}', which is no marker of the set")
    made = MarkerSet(
        name=view.name or name.removesuffix(".toml"),
        markers=tuple(names),
        segments=tuple(one.segment for one in view.markers),
        sides=tuple(one.side for one in view.markers),
        places=np.array([one.place or (np.nan,) * 3 for one in view.markers], float),
        colors=tuple(one.color for one in view.markers),
        rigid_pairs=tuple((a, b) for a, b in view.links),
        title=view.title,
    )
    project.folder.mkdir(parents=True, exist_ok=True)
    write_marker_set(made, file)
    return messages.Done(message=f"{name}: {len(names)} markers", path=str(file))


def learn_subject(take: OpenTake, wanted: messages.SubjectRequest) -> messages.Done:
    """Learn who wears the markers from a take as it was mended; raises ``InputError`` where that cannot be."""
    name, folder = wanted.name.strip(), take.project.folder
    if not name or Path(name).name != name or name.startswith(".") or name == "markerloom":
        raise InputError(f"'{wanted.name}' is no name for a subject: it becomes NAME.toml in the project's folder")
    file = folder / f"{name}.toml"
    if file.exists() and not wanted.overwrite:
        raise InputError(f"{file.name} is there already: give the subject another name, or say that it may go")
    with take.lock:
        points = take.sheet.window(0, take.sheet.count)
    worn = take.settings.marker_set
    made = create_subject(points, marker_set=read_marker_set(worn) if worn else None, name=name)
    folder.mkdir(parents=True, exist_ok=True)
    write_subject(made, file)
    text = (
        f'{file.name}: {len(made)} markers from {made.poses:.0f} poses; `subjects = ["{file.name}"]` names takes by it'
    )
    return messages.Done(message=text, path=str(file))


def edit_subject(project: Project, file: str, wanted: messages.SubjectEdit) -> messages.Done:
    """Rename a subject and its markers, or let markers go; what was learned of the others stays."""
    path = next((Path(s) for s in _subjects(project) if Path(s).name == file), None)
    if path is None:
        raise InputError(f"the project has no subject in {file}")
    if not wanted.name.strip() or len(wanted.markers) < LEAST_MARKERS:
        raise InputError(f"a subject has a name, and at least {LEAST_MARKERS} markers")
    made = replace(with_markers(read_subject(path), wanted.markers), name=wanted.name.strip())
    write_subject(made, path)
    return messages.Done(message=f"{file}: {len(made)} markers", path=str(path))


def _subjects(project: Project) -> list[str]:
    """Files of subjects: those that takes name, and those in the project's folder."""
    found = {s for t in project.takes for s in t.subjects}
    for file in sorted(project.folder.glob("*.toml")) if project.folder.is_dir() else ():
        with suppress(MarkerloomError):
            read_subject(file)
            found.add(str(file))
    return sorted(found)


def subject_views(project: Project) -> list[messages.SubjectView]:
    """Subjects of the project, with the distances that vary least."""
    found = []
    for file in _subjects(project):
        one = read_subject(file)
        n = len(one)
        pairs = [
            (one.markers[i], one.markers[j], 1000.0 * known[0], 1000.0 * known[1])
            for i in range(n)
            for j in range(i + 1, n)
            if (known := one.distances[i * n + j]) is not None
        ]
        firm = sorted(pairs, key=lambda p: p[3])[:MOST_TOLD]
        found.append(
            messages.SubjectView(
                file=Path(file).name,
                name=one.name,
                marker_set=one.marker_set,
                markers=list(one.markers),
                poses=one.poses,
                firmest=firm,
            )
        )
    return found
