"""The studio: a local server and a page in the browser that show a take and mend it."""

from markerloom.studio.opening import view

__all__ = ["view"]
