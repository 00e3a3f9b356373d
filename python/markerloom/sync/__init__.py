"""Recordings without a common clock: offset and rate of each, and one time for all."""

from markerloom.sync.clocks import Clock, Synced, sync

__all__ = ["Clock", "Synced", "sync"]
