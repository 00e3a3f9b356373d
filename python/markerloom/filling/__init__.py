"""Gaps of trajectories filled, each with its expected error."""

from markerloom.filling.takes import Filled, fill

__all__ = ["Filled", "fill"]
