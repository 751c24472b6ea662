"""Two cameras of a rig, rectified, and refused in words that name them."""

from calichrome.errors import RecordingError, SolveError
from calichrome.geometry.rectification import Rectification, rectify_pair
from calichrome.geometry.rectified_area import Framing
from calichrome.rig import Rig

__all__ = ["rectified_pair"]


def rectified_pair(rig: Rig, pair: tuple[str, str], framing: Framing | None) -> Rectification:
    """Rectify two cameras of a rig.

    Parameters
    ----------
    rig
        The calibration.
    pair
        The two cameras, in the order wanted.
    framing
        Which part of the pictures is shown; None: all of both.

    Raises
    ------
    RecordingError
        If the rig lacks one of them, or one is named twice.
    SolveError
        If no plane shows both pictures.
    """
    for name in pair:
        if name not in rig.cameras:
            raise RecordingError(f"the rig has no camera {name}; it has {', '.join(rig.cameras)}")
    if pair[0] == pair[1]:
        raise RecordingError(f"--pair {pair[0]},{pair[1]} names one camera twice; name two")
    a, b = (rig.cameras[name] for name in pair)
    b_from_a = b.cam_from_ref @ a.cam_from_ref.inverse()
    try:
        return rectify_pair(a.lens, b.lens, b_from_a, a.size_wh, b.size_wh, framing or Framing())
    except SolveError as error:
        raise SolveError(f"{pair[0]} and {pair[1]}: {error}") from error
