"""Edits in words."""

from __future__ import annotations

from markerloom.errors import InputError
from markerloom.mending import edits as e
from markerloom.mending.sheet import Sheet


def of_edit(edit: e.Edit, sheet: Sheet) -> str:
    """What an edit does, with the names that its markers have before it."""

    def name(at: e.At) -> str:
        try:
            return sheet.name(sheet.find(at))
        except InputError:
            return f"marker in frame {at.frame}"

    match edit:
        case e.Label():
            return f"{name(edit.at)} is {edit.name}{_over(edit.within)}"
        case e.Unlabel():
            return f"{name(edit.at)} loses its name{_over(edit.within)}"
        case e.Swap():
            return f"{name(edit.at)} and {name(edit.other)} exchanged{_over(edit.within)}"
        case e.Split():
            return f"{name(edit.at)} cut at frame {edit.frame}"
        case e.Join():
            return f"{name(edit.other)} joined to {name(edit.at)}"
        case e.Delete():
            return f"{name(edit.at)} deleted{_over(edit.within)}"
        case e.Fill():
            return f"{name(edit.at)} filled ({edit.method}){_over(edit.within)}"
        case e.Smooth():
            how = f"{edit.method}, {edit.cutoff_hz:g} Hz" if edit.method == "butterworth" else edit.method
            return f"{name(edit.at)} smoothed ({how}){_over(edit.within)}"
        case e.Move():
            return f"{name(edit.at)} moved in frame {edit.at.frame}"
        case e.ExcludeDot():
            return f"centroid of camera {edit.camera} left out in frame {edit.frame}"
        case e.ExcludeCamera():
            return f"camera {edit.camera} left out{_over(edit.within)}"
        case e.ExcludeRegion():
            return f"region of camera {edit.camera} left out{_over(edit.within)}"
        case e.MarkContact():
            return f"{edit.site} {'stands' if edit.stands else 'does not stand'}{_over(edit.within)}"


def _over(within: e.Range | None) -> str:
    return "" if within is None else f", frames {within.first} to {within.last}"
