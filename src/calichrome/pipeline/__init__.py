"""The order of work."""

from calichrome.pipeline.calibrate import Calibration, CalibrationSettings, calibrate

__all__ = ["Calibration", "CalibrationSettings", "calibrate"]
