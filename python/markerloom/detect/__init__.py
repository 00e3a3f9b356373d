"""From images and video to centroids."""

from markerloom.detect.markers import Blobs, detect_markers

__all__ = ["Blobs", "detect_markers"]
