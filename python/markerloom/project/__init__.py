"""Projects: a folder of takes that go the whole way together."""

from markerloom.project.process import process
from markerloom.project.settings import Project, TakeSettings, read_project

__all__ = ["Project", "TakeSettings", "process", "read_project"]
