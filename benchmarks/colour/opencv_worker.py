"""Fits of `cv2.ccm`, each in a process of its own: `setColorSpace` changes a process-wide object.

Reads a line of JSON for each fit (type, rgb, lab of n colours) and writes a line of JSON (matrix
for rows of linear RGB, and the reference in OpenCV's linear sRGB). Knows nothing of calichrome.
"""

import json
import os
import sys

import cv2
import numpy as np

_TYPES = {"linear": cv2.ccm.CCM_LINEAR, "affine": cv2.ccm.CCM_AFFINE}


def fit(line: str) -> str:
    """Fit one model."""
    request = json.loads(line)
    rgb, lab = (np.array(request[key]).reshape(-1, 1, 3) for key in ("rgb", "lab"))
    model = cv2.ccm.ColorCorrectionModel(rgb, lab, cv2.ccm.COLOR_SPACE_LAB_D65_2)
    model.setColorSpace(cv2.ccm.COLOR_SPACE_SRGB)
    model.setLinearization(cv2.ccm.LINEARIZATION_IDENTITY)
    model.setCcmType(_TYPES[request["type"]])
    model.setDistance(cv2.ccm.DISTANCE_CIE2000)
    model.setSaturatedThreshold(0, 100)  # by default it drops colours above 0.98
    model.setRGB(True)
    model.compute()
    return json.dumps(
        {
            "matrix": model.getColorCorrectionMatrix().tolist(),
            "reference_linear": model.getRefLinearRGB().reshape(-1, 3).tolist(),
        }
    )


def main() -> None:
    """Fork once for each line; this process never makes a model."""
    cv2.setNumThreads(0)
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            print(fit(line), flush=True)
            os._exit(0)
        if os.waitpid(child, 0)[1]:
            sys.exit("a fit failed")


if __name__ == "__main__":
    main()
