"""Calibration: rigs from a wand wave, and what they are worth."""

from markerloom.calibrate.wand import Calibration, calibrate_wand
from markerloom.calibrate.wands import Wand, read_wand

__all__ = ["Calibration", "Wand", "calibrate_wand", "read_wand"]
