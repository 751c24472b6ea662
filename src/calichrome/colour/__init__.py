"""Camera colour to target colour, and how sure that is."""

import calichrome.colour.fit  # noqa: F401 (loaded first, or it would take the function's name later)
from calichrome.colour.standalone import ChartFit, Patches, fit

__all__ = ["ChartFit", "Patches", "fit"]
