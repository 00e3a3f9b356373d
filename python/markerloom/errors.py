"""What can go wrong, for the person at the cameras: where, what, and what to do."""

from pathlib import Path

from markerloom._core import BytesError, InputError, MarkerloomError, NoPointError, RigError

__all__ = ["BytesError", "FormatError", "InputError", "MarkerloomError", "NoPointError", "RigError"]


class FormatError(MarkerloomError):
    """A file is not what its name says, or is damaged."""

    def __init__(self, path: str | Path, problem: str, *, where: str = "") -> None:
        """Say which file, where in it, and what is wrong."""
        place = f", {where}" if where else ""
        super().__init__(f"{Path(path).name}{place}: {problem} ({path})")
