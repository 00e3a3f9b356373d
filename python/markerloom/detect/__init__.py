"""From images and video to centroids."""

from markerloom.detect.images import grey_images
from markerloom.detect.markers import Blobs, detect_markers
from markerloom.detect.takes import detect, learn_mask, read_mask

__all__ = ["Blobs", "detect", "detect_markers", "grey_images", "learn_mask", "read_mask"]
