"""markerloom: open optical motion capture. ``import markerloom as ml``."""

from markerloom.api import *  # noqa: F403
from markerloom.api import __all__ as _api_names
from markerloom.errors import FormatError, InputError, MarkerloomError, NoPointError, RigError

__version__ = "0.1.0"
__all__ = [  # noqa: PLE0604
    *_api_names,
    "FormatError",
    "InputError",
    "MarkerloomError",
    "NoPointError",
    "RigError",
]
