"""What a calibration takes from the recording beside the corners."""

import shutil
from pathlib import Path

import cv2
import numpy as np

from calichrome.imaging import open_recording
from calichrome.observations import write_observations
from calichrome.pipeline.calibrate import CalibrationSettings, run, run_on_corners
from calichrome.pipeline.detect import detect_recording, find_target


def _linear_recording(simulated: Path, folder: Path) -> Path:
    """Three frames of one camera, stored again as linear 16-bit pictures."""
    (folder / "cam0").mkdir(parents=True)
    for path in sorted((simulated / "cam0").glob("00[0-2].png")):
        encoded = cv2.imread(str(path))
        assert encoded is not None
        tones = encoded / 255
        light = np.where(tones <= 0.04045, tones / 12.92, ((tones + 0.055) / 1.055) ** 2.4)
        linear = np.rint(light * 65535).astype(np.uint16)
        assert cv2.imwrite(str(folder / "cam0" / path.name), linear)
    shutil.copy(simulated / "target.json", folder)
    return folder


def test_corners_with_their_recording_keep_its_encoding(simulated: Path, tmp_path: Path) -> None:
    """The colours of markers.csv are linear; the pictures to correct later are as recorded."""
    folder = _linear_recording(simulated, tmp_path / "linear")
    recording = open_recording(folder)
    detection = detect_recording(recording, find_target(recording, None, None))
    corners = tmp_path / "c.csv"
    write_observations(detection.dataset, detection.rejected, corners)
    done = run_on_corners(corners, folder, {}, CalibrationSettings())
    colour = done.rig.cameras["cam0"].colour
    assert colour is not None
    assert colour.encoding == "linear"


def test_fixed_values_of_recording_toml(simulated: Path, tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    (folder / "cam0").mkdir(parents=True)
    for path in sorted((simulated / "cam0").glob("00[0-3].png")):
        shutil.copy(path, folder / "cam0")
    (folder / "recording.toml").write_text(
        'target = "chessboard:9x8:30mm"\nsquare = "31mm"\n'
        "[cameras.cam0.fixed]\nk3 = 0.0\ncx = 320\n"
    )
    rig = run(folder, CalibrationSettings()).rig
    lens = rig.cameras["cam0"].lens
    assert (lens.as_dict()["k3"], lens.cx) == (0.0, 320.0)
    assert rig.cameras["cam0"].lens_sigma["cx"] == 0
    assert rig.target.square_m == (0.031, 0.031)
    assert rig.target.square_size_measured
