"""Which detector made a result."""

import cv2
import numpy as np

__all__ = ["DETECTOR_VERSION"]

DETECTOR_VERSION = f"5 opencv {cv2.__version__} numpy {np.__version__}"
"""Stands for everything but picture and target that a detection depends on; kept results of
another version are not used. Raise the number with every change that can move a corner, a colour
or a reason by a single bit. The libraries stand here because they decode and compute."""
