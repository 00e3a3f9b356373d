"""Gaps of trajectories filled, with honest uncertainty."""

from markerloom.filling.takes import Filled, fill

__all__ = ["Filled", "fill"]
