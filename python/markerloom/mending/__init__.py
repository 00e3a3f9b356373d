"""Mending by hand: edits as a small list beside the take, applied anew whenever it is processed."""

from markerloom.mending.dots import without_excluded
from markerloom.mending.edits import EditList, edits_path, read_edits, write_edits
from markerloom.mending.takes import Mended, mend

__all__ = ["EditList", "Mended", "edits_path", "mend", "read_edits", "without_excluded", "write_edits"]
