"""A chart photographed through seven narrow filters at seven exposures: a camera put to the test.

Is it linear, and do seven numbers per patch tell its spectrum? (chart_bllanos of the test data.)
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from benchmarks.colour.spectra import WAVELENGTHS_NM, reflectances

from calichrome.core.arrays import BoolArray, FloatArray

__all__ = ["BandChart", "Linearity"]

_CHANNEL = {400: 2, 450: 2, 500: 1, 550: 1, 600: 0, 650: 0, 700: 0}
"""The channel in whose band each filter lies: red, green, blue. Others see leaks of the filters."""

_LABELS = "colorChecker_labels/d2_colorChecker30cm_550nm_labels.png"
_FRAMES = "captured_images/images_filtered_light/color_checker"
_MARGIN_PX = 5  # that labels are shrunk by: each filter focuses elsewhere
_TOO_BRIGHT = 240  # of 255: pixels are means of sensor pixels some of which are full before
_DIM = 16.0  # of 255, for linearity: rounding to 8 bits alone is 3 % of it
_ROUNDING = 0.25  # of 255, sigma of a patch's mean
_UNSTEADY = 0.005  # relative: lamp and shutter
_READING_SIGMA = 0.02  # of a band reflectance: what the surface through 23 patches leaves
_NM = (390, 720)  # of the filters' transmission that is used: beyond is noise of the spectrometer


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearity:
    """How patch means of one band grow with the exposure time.

    Parameters
    ----------
    exponent
        Of the exposure time, mean over patches.
    residual
        Relative, rms, about proportionality.
    n
        Patch means that are neither dim nor bright.
    """

    exponent: float
    residual: float
    n: int


class BandChart:
    """The set in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.bands = tuple(_CHANNEL)

    @cached_property
    def _patches(self) -> list[BoolArray]:
        labels = cv2.imread(str(self._folder / _LABELS), cv2.IMREAD_UNCHANGED)
        core = np.ones((2 * _MARGIN_PX + 1,) * 2, np.uint8)
        masks = [np.asarray(labels == k, dtype=np.uint8) for k in range(1, 25)]
        return [cv2.erode(mask, core) > 0 for mask in masks]

    @cached_property
    def centres_px(self) -> FloatArray:
        """Centres of the patches, (24, 2)."""
        return np.array([np.argwhere(patch).mean(axis=0)[::-1] for patch in self._patches])

    def raw(self, path: str) -> FloatArray:
        """Return a mosaic as stored, 0..255."""
        return np.asarray(
            cv2.imread(str(self._folder / path), cv2.IMREAD_UNCHANGED), dtype=np.float64
        )

    @cached_property
    def _dark(self) -> Mapping[int, FloatArray]:
        """Mean dark frame by exposure, ms."""
        frames: dict[int, list[FloatArray]] = {}
        for path in sorted((self._folder / "captured_images/dark_frames").glob("*.tif")):
            milliseconds = re.search(r"_(\d+)ms", path.name)
            assert milliseconds is not None  # noqa: S101
            name = str(path.relative_to(self._folder))
            frames.setdefault(int(milliseconds[1]), []).append(self.raw(name))
        return {key: np.mean(value, axis=0) for key, value in frames.items()}

    @cached_property
    def times_ms(self) -> FloatArray:
        """Exposures, increasing, (E,)."""
        return np.array(sorted(self._dark), dtype=np.float64)

    def frame(self, band: int, milliseconds: int) -> FloatArray:
        """Return the mosaic (H, W) of one band and exposure, dark frame subtracted."""
        (path,) = (self._folder / _FRAMES).glob(f"*_{band}nm_{milliseconds}ms_*.tif")
        return self.raw(str(path.relative_to(self._folder)))

    def means(self, band: int) -> tuple[FloatArray, BoolArray]:
        """Patch means above dark (E, 24), and where no pixel of the patch is too bright."""
        means, fine = (np.empty((len(self.times_ms), 24)) for _ in range(2))
        for row, milliseconds in enumerate(map(int, self.times_ms)):
            stored = self.frame(band, milliseconds)
            sites = _sites(stored.shape)[_CHANNEL[band]]
            light = stored - self._dark[milliseconds]
            for patch, inside in enumerate(self._patches):
                means[row, patch] = light[inside & sites].mean()
                fine[row, patch] = stored[inside].max() < _TOO_BRIGHT
        return means, np.asarray(fine > 0)

    def linearity(self, band: int) -> Linearity | None:
        """None if no patch is seen well at two exposures."""
        means, fine = self.means(band)
        fine &= means > _DIM
        twice = fine.sum(axis=0) >= 2
        if not twice.any():
            return None
        exponents, residuals = [], []
        for patch in np.flatnonzero(twice):
            rows = fine[:, patch]
            time, level = self.times_ms[rows], means[rows, patch]
            exponents.append(np.polyfit(np.log(time), np.log(level), 1)[0])
            residuals.append(level / time / np.mean(level / time) - 1)
        spread = np.concatenate(residuals)
        return Linearity(
            exponent=float(np.mean(exponents)),
            residual=float(np.sqrt(np.mean(spread**2))),
            n=len(spread),
        )

    @cached_property
    def _rates(self) -> FloatArray:
        """Light per ms of each patch in each band, (24, 7): all exposures that are not clipped."""
        rates = []
        for band in self.bands:
            means, fine = self.means(band)
            weight = fine / (_ROUNDING**2 + (_UNSTEADY * means) ** 2)
            time = self.times_ms[:, None]
            rates.append((weight * means * time).sum(axis=0) / (weight * time**2).sum(axis=0))
        return np.stack(rates, axis=1)

    @cached_property
    def _table(self) -> FloatArray:
        return np.loadtxt(
            self._folder / "spectral_data/spectra_averaged.csv", delimiter=",", skiprows=1
        )

    @cached_property
    def spectra(self) -> FloatArray:
        """Measured reflectances of the 24 patches, (24, 61)."""
        wavelengths, columns = self._table[:, 0], self._table[:, 12:36].T
        return np.array([np.interp(WAVELENGTHS_NM, wavelengths, column) for column in columns])

    @cached_property
    def _in_bands(self) -> FloatArray:
        """The same averaged under each filter, (24, 7)."""
        used = (self._table[:, 0] >= _NM[0]) & (self._table[:, 0] <= _NM[1])
        filters = np.maximum(self._table[used, 1:8], 0)
        return np.asarray(self._table[used, 12:36].T @ filters / filters.sum(axis=0))

    @cached_property
    def left_out(self) -> tuple[FloatArray, FloatArray]:
        """Reflectance of each patch in each band as the others tell it, (24, 7), and the truth.

        In each band the lamp's light, its unevenness and stray light are fitted to the other 23
        patches: reading = (a + b x + c y) reflectance + d.
        """
        place = (self.centres_px - self.centres_px.mean(axis=0)) / np.ptp(self.centres_px, axis=0)
        light = np.concatenate([np.ones((24, 1)), place], axis=1)
        told = np.empty_like(self._rates)
        everything = np.arange(24)
        for column in range(len(self.bands)):
            truth, rate = self._in_bands[:, column], self._rates[:, column]
            design = np.concatenate([light * truth[:, None], np.ones((24, 1))], axis=1)
            weight = 1 / (truth + 0.05)[:, None]
            for patch in everything:
                kept = everything != patch
                solution = np.linalg.lstsq(
                    (design * weight)[kept], (rate * weight[:, 0])[kept], rcond=None
                )[0]
                told[patch, column] = (rate[patch] - solution[3]) / (light[patch] @ solution[:3])
        return told, self._in_bands

    @cached_property
    def left_out_spectra(self) -> FloatArray:
        """Spectrum of each patch from its seven band reflectances, (24, 61).

        Wiener's estimate: the likeliest spectrum of a population of Munsell chips; it knows none of
        the 24.
        """
        wavelengths = self._table[:, 0]
        filters = np.array(
            [
                np.interp(WAVELENGTHS_NM, wavelengths, np.maximum(column, 0))
                for column in self._table[:, 1:8].T
            ]
        )
        filters /= filters.sum(axis=1, keepdims=True)
        chips = reflectances("munsell1269")
        mean, cov = chips.mean(axis=0), np.cov(chips.T)
        seen = filters @ cov @ filters.T + _READING_SIGMA**2 * np.eye(len(filters))
        told, _ = self.left_out
        return np.asarray(mean + (told - filters @ mean) @ np.linalg.solve(seen, filters @ cov))


def _sites(shape: tuple[int, ...]) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Red, green and blue pixels of the mosaic, whose rows are G B and R G."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    odd_y, odd_x = y % 2 == 1, x % 2 == 1
    return odd_y & ~odd_x, odd_y == odd_x, ~odd_y & odd_x
