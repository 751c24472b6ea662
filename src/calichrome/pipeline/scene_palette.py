"""A palette for a scene: printable colours that lie close to all that the scene shows."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calichrome.colorimetry.adaptation import D65
from calichrome.colorimetry.difference import lab_from_xyz, xyz_from_lab
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ, XYZ_FROM_RGB
from calichrome.core.arrays import FloatArray
from calichrome.errors import RecordingError, TargetError
from calichrome.imaging import MAX_MEGAPIXELS, Unreadable, picture_files, read_image
from calichrome.target import PaletteColour, colour_checker_palette

__all__ = ["scene_colours", "scene_palette"]

_GREY_CHROMA = 6.0  # of Lab: ColorChecker colours below are its greys, which every palette keeps
_CELL_LAB = 5.0
"""Edge of the cells of Lab in which colours count as one: nearer discs are told apart by nothing
(`target check` calls them almost equal)."""
_LEAST_SHARE = 1e-4  # of all pixels in a cell: fewer are noise or edges, not a thing to look at
_MOST_PIXELS = 200_000  # of one picture
_MOST_PICTURES = 200
_CLIPPED = 0.99  # of full scale: a highlight has no colour
_DARK_L = 8.0  # L* below which a camera sees noise, not colour, and a printer prints black


def scene_palette(
    folder: Path, n_colours: int = 24, *, max_megapixels: float = MAX_MEGAPIXELS
) -> tuple[PaletteColour, ...]:
    """Choose colours to print for a scene.

    Parameters
    ----------
    folder
        A picture, or a folder of pictures of the scene, white-balanced.
    n_colours
        How many.
    max_megapixels
        Refuse larger pictures before decoding them.

    Returns
    -------
    tuple of PaletteColour
        The greys of the ColorChecker, then colours of the scene by how much they add, then, where
        the scene has no more, of the ColorChecker.

    Notes
    -----
    The next colour is the scene's farthest from all chosen ones, which at most doubles the largest
    gap that any choice would leave [1]_. Colours outside the sRGB gamut, which printers share in
    the main, are moved to its surface at their lightness and hue.

    References
    ----------
    .. [1] T. F. Gonzalez, "Clustering to minimize the maximum intercluster distance", Theoretical
       Computer Science 38, 1985, pp. 293-306.
    """
    checker = colour_checker_palette()
    checker_lab = lab_from_xyz(np.array([colour.xyz_d65 for colour in checker]))
    is_grey = np.hypot(checker_lab[:, 1], checker_lab[:, 2]) < _GREY_CHROMA
    greys = [colour for colour, grey in zip(checker, is_grey, strict=True) if grey]
    if n_colours < len(greys):
        raise TargetError(f"{n_colours} colours: a palette has {len(greys)} greys to begin with")
    lab = scene_colours(folder, max_megapixels=max_megapixels)
    chosen = checker_lab[is_grey]
    palette = list(greys)
    of_scene = _spread(lab, chosen, n_colours - len(palette))
    palette += [
        PaletteColour(name=f"scene_{number:02d}", xyz_d65=_triple(xyz_from_lab(colour)))
        for number, colour in enumerate(of_scene, 1)
    ]
    chosen = np.concatenate([chosen, of_scene])
    for colour in _spread(checker_lab[~is_grey], chosen, n_colours - len(palette)):
        index = int(np.linalg.norm(checker_lab - colour, axis=1).argmin())
        palette.append(checker[index])
    return tuple(palette)


def scene_colours(folder: Path, *, max_megapixels: float = MAX_MEGAPIXELS) -> FloatArray:
    """Return the printable colours that pictures show more than now and then, (n, 3) Lab.

    Raises
    ------
    RecordingError
        If there is no picture in colour.
    """
    paths: Sequence[Path] = [folder] if folder.is_file() else picture_files(folder)
    # some of many pictures, evenly
    chosen = np.unique(np.linspace(0, len(paths) - 1, _MOST_PICTURES).astype(int))
    parts = []
    for path in (paths[index] for index in chosen if paths):
        image = read_image(path, max_megapixels=max_megapixels)
        if isinstance(image, Unreadable) or not image.is_colour:
            continue
        linear = image.linear().reshape(-1, 3)
        parts.append(linear[:: max(1, len(linear) // _MOST_PIXELS)])
    if not parts:
        raise RecordingError(f"{folder}: holds no colour picture of the scene; give one or more")
    rgb = np.concatenate(parts)
    lab = lab_from_xyz(rgb[(rgb < _CLIPPED).all(axis=1)] @ XYZ_FROM_RGB["srgb"].T)
    lab = lab[lab[:, 0] > _DARK_L]
    cells, of_cell, counts = np.unique(
        np.floor(lab / _CELL_LAB), axis=0, return_inverse=True, return_counts=True
    )
    sums = np.stack([np.bincount(np.ravel(of_cell), column, len(cells)) for column in lab.T], -1)
    usual = counts >= _LEAST_SHARE * len(rgb)
    if not usual.any():
        raise RecordingError(f"{folder}: its pictures are black or overexposed; give others")
    return _printable(sums[usual] / counts[usual, None])


def _printable(lab: FloatArray) -> FloatArray:
    """Reduce the chroma of colours until they are in the sRGB gamut."""
    low, high = np.zeros(len(lab)), np.ones(len(lab))
    for _ in range(12):  # bisections: 1/4000 of the chroma
        share = np.where(_inside(lab), 1.0, (low + high) / 2)
        inside = _inside(lab * np.stack([np.ones(len(lab)), share, share], axis=-1))
        low, high = np.where(inside, share, low), np.where(inside, high, share)
    return np.asarray(lab * np.stack([np.ones(len(lab)), low, low], axis=-1))


def _inside(lab: FloatArray) -> FloatArray:
    rgb = xyz_from_lab(lab, D65) @ RGB_FROM_XYZ["srgb"].T
    return np.asarray((rgb > -1e-6).all(axis=-1) & (rgb < 1 + 1e-6).all(axis=-1))


def _spread(candidates: FloatArray, chosen: FloatArray, count: int) -> FloatArray:
    """Take candidates one by one, each the farthest from all chosen; none nearer than a cell."""
    taken: list[int] = []
    away = np.linalg.norm(candidates[:, None] - chosen, axis=-1).min(axis=1)
    while len(taken) < count and away.max(initial=0.0) >= _CELL_LAB:
        best = int(away.argmax())
        taken.append(best)
        away = np.minimum(away, np.linalg.norm(candidates - candidates[best], axis=1))
    return np.asarray(candidates[taken].reshape(-1, 3))


def _triple(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
