"""Names of markers: prefixes of subjects, and left and right."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable

SIDES = (("Left", "Right"), ("LEFT", "RIGHT"), ("left", "right"), ("L", "R"), ("l", "r"))


def split_prefix(name: str, known: Collection[str] = ()) -> tuple[str, str]:
    """The subject's prefix and the marker's own name: ``Anna:LFHD``, or ``Anna_LFHD`` where LFHD is ``known``."""
    prefix, colon, own = name.rpartition(":")
    if colon:
        return prefix, own
    if name in known:
        return "", name
    for at in (i for i, letter in enumerate(name) if letter == "_"):
        if name[at + 1 :] in known:
            return name[:at], name[at + 1 :]
    return "", name


def prefixes(names: Iterable[str], known: Collection[str] = ()) -> list[str]:
    """The prefixes of subjects in a list of names, in order of appearance."""
    return list(dict.fromkeys(split_prefix(name, known)[0] for name in names))


def other_side(name: str, names: Collection[str]) -> str | None:
    """The marker of the other side: left and right may stand first, last, or after a prefix; ``None`` without one."""
    for left, right in SIDES:
        for here, there in ((left, right), (right, left)):
            tries = []
            if name.startswith(here):
                tries.append(there + name[len(here) :])
            if name.endswith(here):
                tries.append(name[: -len(here)] + there)
            tries += [name[: m.start()] + there + name[m.end() :] for m in re.finditer(re.escape(here), name)]
            for found in tries:
                if found != name and found in names:
                    return found
    return None


def side_of(name: str, names: Collection[str]) -> str:
    """``left``, ``right`` or ``middle``, by the name alone."""
    other = other_side(name, names)
    if other is None:
        return "middle"
    at = next(i for i, (a, b) in enumerate(zip(name, other, strict=False)) if a != b)
    return "left" if name[at].lower() == "l" else "right"
