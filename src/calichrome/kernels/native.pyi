from numpy import float32, generic, uint8
from numpy.typing import NDArray

class _Plan: ...

def compile_plan(
    *,
    in_size_wh: tuple[int, int],
    out_size_wh: tuple[int, int],
    n_channels: int,
    in_type: int,
    out_type: int,
    is_bgr: bool,
    has_colour: bool,
    clips: bool,
    full_scale: float,
    out_scale: float,
    map_step: int,
    map_nodes: NDArray[float32],
    gain_step: int,
    gain_nodes: NDArray[float32],
    balance: NDArray[float32],
    linearisation: int,
    curve: NDArray[float32],
    curve_foot: tuple[float, float],
    linear: NDArray[float32],
    matrix: NDArray[float32],
    offset: NDArray[float32],
    lift: float,
    lifted_grey: float,
    lifted_matrix: NDArray[float32],
    factors: NDArray[uint8],
    coefficients: NDArray[float32],
    table_size: int,
    table_scale: NDArray[float32],
    table: NDArray[float32],
    is_encoded: bool,
    encoding: NDArray[float32],
    encoding_foot: tuple[float, float],
) -> _Plan: ...
def run(
    plan: _Plan,
    source: NDArray[generic],
    out: NDArray[generic],
    first: int,
    last: int,
    wide: bool,
    /,
) -> None: ...
def rgb_of_yuv(
    luma: NDArray[uint8],
    blue: NDArray[uint8],
    red: NDArray[uint8],
    rgb: NDArray[uint8],
    matrix: NDArray[float32],
    wide: bool = True,
    /,
) -> None: ...
def yuv_of_rgb(
    luma: NDArray[uint8],
    blue: NDArray[uint8],
    red: NDArray[uint8],
    rgb: NDArray[uint8],
    matrix: NDArray[float32],
    wide: bool = True,
    /,
) -> None: ...
