"""Objects in front of a known empty scene: found in every camera, placed in space, followed."""

from calichrome.tracking.background import Background, Picture
from calichrome.tracking.distance import Distances, distance_bounds
from calichrome.tracking.extent import extent_of
from calichrome.tracking.hypotheses import Hypothesis, find_objects
from calichrome.tracking.light_levels import light_levels
from calichrome.tracking.likelihood import AssociationSettings, RegionTable
from calichrome.tracking.overlay import Mark, draw_marks
from calichrome.tracking.regions import Region, find_regions
from calichrome.tracking.surface_colour import SurfaceColour, mean_colour
from calichrome.tracking.track import Sighting, Step, Track
from calichrome.tracking.tracker import Tracker, TrackingSettings
from calichrome.tracking.trajectory import ErrorSizes, Trajectory, smooth_tracks
from calichrome.tracking.view import PixelRays, View, views_of

__all__ = [
    "AssociationSettings",
    "Background",
    "Distances",
    "ErrorSizes",
    "Hypothesis",
    "Mark",
    "Picture",
    "PixelRays",
    "Region",
    "RegionTable",
    "Sighting",
    "Step",
    "SurfaceColour",
    "Track",
    "Tracker",
    "TrackingSettings",
    "Trajectory",
    "View",
    "distance_bounds",
    "draw_marks",
    "extent_of",
    "find_objects",
    "find_regions",
    "light_levels",
    "mean_colour",
    "smooth_tracks",
    "views_of",
]
