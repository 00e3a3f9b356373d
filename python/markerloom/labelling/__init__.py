"""Names for the markers of a take, and whether the names of a take are right."""

from markerloom.labelling.check import Checked, check_labels, repair_labels
from markerloom.labelling.live import Labeller
from markerloom.labelling.takes import Labelled, label

__all__ = ["Checked", "Labelled", "Labeller", "check_labels", "label", "repair_labels"]
