"""Marker sets (what markers there are and where) and subjects (one person or thing that wears them)."""

from markerloom.subjects.create import create_subject
from markerloom.subjects.marker_set import MarkerSet, marker_sets, read_marker_set, write_marker_set
from markerloom.subjects.subject import Subject, read_subject, with_markers, write_subject
from markerloom.subjects.virtual import with_virtual_markers

__all__ = [
    "MarkerSet",
    "Subject",
    "create_subject",
    "marker_sets",
    "read_marker_set",
    "read_subject",
    "with_markers",
    "with_virtual_markers",
    "write_marker_set",
    "write_subject",
]
