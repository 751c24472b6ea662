"""Everything at once: lenses, camera poses, board poses and the board's shape.

``observations`` packs what was seen, ``state`` what is unknown; ``blocks`` turns both into one
small Hessian a view, ``equations`` eliminates the boards, ``solve`` minimises; ``noise`` tells how
noisy views are, ``robust`` finds the corners that do not belong. `docs/formulation.md` derives what
stands here.
"""

from calichrome.geometry.bundle.board_shape import BoardShape
from calichrome.geometry.bundle.equations import BundleEquations
from calichrome.geometry.bundle.observations import Observations, ObservedView
from calichrome.geometry.bundle.solve import BundleResult, residuals_px, solve_bundle
from calichrome.geometry.bundle.state import BundleState, Free, Priors

__all__ = [
    "BoardShape",
    "BundleEquations",
    "BundleResult",
    "BundleState",
    "Free",
    "Observations",
    "ObservedView",
    "Priors",
    "residuals_px",
    "solve_bundle",
]
