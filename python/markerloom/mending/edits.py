"""Edits: what somebody decided about a take, as plain data in a JSON file beside it.

Edits point at a trajectory by a frame and a place in it, never by its number, so that they still mean the same marker
after the take was tracked anew. Frames are numbers of the take; ``first`` and ``last`` are both included.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from markerloom.errors import FormatError
from markerloom.formats.files import read_text, write_text

VERSION = 1
ENDING = ".edits.json"
Millimetres = Annotated[float, Field(allow_inf_nan=False)]
Pixels = Annotated[float, Field(allow_inf_nan=False)]
Frame = Annotated[int, Field(ge=-(2**31), lt=2**31)]
Name = Annotated[str, Field(min_length=1, max_length=120, pattern=r"^[^*\x00-\x1f][^\x00-\x1f]*$")]


class Strict(BaseModel):
    """Data that say nothing but what is known."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class At(Strict):
    """A trajectory, by its place (mm, world, Z up) in a frame."""

    frame: Frame
    xyz_mm: tuple[Millimetres, Millimetres, Millimetres]


class Range(Strict):
    """Frames ``first`` to ``last``, both included."""

    first: Frame
    last: Frame

    @model_validator(mode="after")
    def _in_order(self) -> Range:
        if self.last < self.first:
            raise ValueError(f"last frame {self.last} lies before first frame {self.first}")
        return self


class Label(Strict):
    """Give a trajectory a name; over frames ``within``, or all along."""

    op: Literal["label"] = "label"
    at: At
    name: Name
    within: Range | None = None


class Unlabel(Strict):
    """Take a trajectory its name; over frames ``within``, or all along."""

    op: Literal["unlabel"] = "unlabel"
    at: At
    within: Range | None = None


class Swap(Strict):
    """Exchange the samples of two trajectories over frames ``within``."""

    op: Literal["swap"] = "swap"
    at: At
    other: At
    within: Range


class Split(Strict):
    """Cut a trajectory: what comes from ``frame`` on becomes one of its own, without a name."""

    op: Literal["split"] = "split"
    at: At
    frame: Frame


class Join(Strict):
    """The samples of ``other`` become those of ``at``; the two must not have a frame in common."""

    op: Literal["join"] = "join"
    at: At
    other: At


class Delete(Strict):
    """Throw away the samples of a trajectory over frames ``within``."""

    op: Literal["delete"] = "delete"
    at: At
    within: Range


class Fill(Strict):
    """Fill the gaps of a trajectory that lie in frames ``within``; ``predicted``: what a tracker carried there, too."""

    op: Literal["fill"] = "fill"
    at: At
    within: Range
    method: str = "auto"
    predicted: bool = False


class Smooth(Strict):
    """Smooth a trajectory over frames ``within``."""

    op: Literal["smooth"] = "smooth"
    at: At
    within: Range
    method: str = "butterworth"
    cutoff_hz: Annotated[float, Field(gt=0, lt=1e5)] = 6.0


class Move(Strict):
    """Put one sample somewhere else; it is of kind ``edited`` from then on."""

    op: Literal["move"] = "move"
    at: At
    xyz_mm: tuple[Millimetres, Millimetres, Millimetres]


class ExcludeDot(Strict):
    """Leave out one centroid before reconstruction: the one of a camera nearest to ``pixel``."""

    op: Literal["exclude_dot"] = "exclude_dot"
    camera: str
    frame: Frame
    pixel: tuple[Pixels, Pixels]


class ExcludeCamera(Strict):
    """Leave out all centroids of a camera over frames ``within`` before reconstruction."""

    op: Literal["exclude_camera"] = "exclude_camera"
    camera: str
    within: Range


class ExcludeRegion(Strict):
    """Leave out the centroids in a rectangle of a camera's image (corners, px) over frames ``within``."""

    op: Literal["exclude_region"] = "exclude_region"
    camera: str
    low: tuple[Pixels, Pixels]
    high: tuple[Pixels, Pixels]
    within: Range


class MarkContact(Strict):
    """A place of a foot stands on the floor over frames ``within``; or does not, where ``stands`` is false."""

    op: Literal["contact"] = "contact"
    site: str
    within: Range
    stands: bool = True


PointEdit = Label | Unlabel | Swap | Split | Join | Delete | Fill | Smooth | Move
DotEdit = ExcludeDot | ExcludeCamera | ExcludeRegion
Edit = Annotated[PointEdit | DotEdit | MarkContact, Field(discriminator="op")]
POINT_EDITS = (Label, Unlabel, Swap, Split, Join, Delete, Fill, Smooth, Move)
DOT_EDITS = (ExcludeDot, ExcludeCamera, ExcludeRegion)


class EditList(Strict):
    """The edits of one take, in the order in which they were made."""

    version: Literal[1] = VERSION
    edits: tuple[Edit, ...] = ()

    def __len__(self) -> int:
        """Return the number of edits."""
        return len(self.edits)

    @property
    def of_points(self) -> list[PointEdit]:
        """Those that change trajectories."""
        return [e for e in self.edits if isinstance(e, POINT_EDITS)]

    @property
    def of_dots(self) -> list[DotEdit]:
        """Those that leave out centroids before reconstruction."""
        return [e for e in self.edits if isinstance(e, DOT_EDITS)]

    @property
    def of_contacts(self) -> list[MarkContact]:
        """Those that tell when feet stand."""
        return [e for e in self.edits if isinstance(e, MarkContact)]

    def plain(self) -> list[dict[str, object]]:
        """As plain data, without what was left at its default."""
        return [{"op": e.op, **e.model_dump(mode="json", exclude_defaults=True)} for e in self.edits]


def edits_path(take: str | Path) -> Path:
    """Where the edits of a take are: ``walk.c3d`` has ``walk.c3d.edits.json`` beside it."""
    return Path(f"{take}{ENDING}")


def read_edits(path: str | Path) -> EditList:
    """Read a list of edits; raises ``FormatError`` naming the edit that is not one."""
    try:
        return EditList.model_validate(json.loads(read_text(path)))
    except json.JSONDecodeError as error:
        raise FormatError(path, f"not JSON: {error}") from None
    except ValidationError as error:
        raise FormatError(path, reason(error)) from None


def reason(error: ValidationError) -> str:
    """The first thing that is wrong with data, in words."""
    first = error.errors()[0]
    words = [f"edit {p + 1}" if isinstance(p, int) else str(p) for p in first["loc"] if p != "edits"]
    where = ", ".join(words)
    return f"{where}: {first['msg']}" if where else str(first["msg"])


def write_edits(edits: EditList, path: str | Path) -> None:
    """Write a list of edits, one a line, so that it appears whole or not at all."""
    lines = ",\n".join(f"  {json.dumps(e, ensure_ascii=False)}" for e in edits.plain())
    write_text(path, f'{{"version": {edits.version}, "edits": [\n{lines}\n]}}\n')
