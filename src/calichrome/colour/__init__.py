"""Camera colour to target colour, and how sure that is."""

from calichrome.colour.standalone import ChartFit, Patches, fit

__all__ = ["ChartFit", "Patches", "fit"]
