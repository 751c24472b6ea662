"""Real photographs of charts: python -m benchmarks.colour.photographs [--figures FOLDER].

Fitted by `calichrome.colour.fit`; errors are CIEDE2000 against the chart's colours under D65, each
patch left out of the fit in turn (model, but not veil and light).
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from benchmarks.colour.bands import BandChart
from benchmarks.colour.spectra import data_folder, illuminant, observer
from benchmarks.geometry.tables import Bar, print_bars, print_table

from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colorimetry.encoding import EncodingName, encode
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ
from calichrome.colour import ChartFit, fit
from calichrome.core.arrays import FloatArray, UInt8Array
from calichrome.core.homography import apply_homography, fit_homography
from calichrome.detection.card import CARD_CORNERS, CARD_PLACES, CardReading, measure_card
from calichrome.detection.card_search import find_card
from calichrome.imaging import Image, read_image
from calichrome.target import PaletteColour, colour_checker_palette

__all__ = ["Photograph", "main", "photographs"]

_WORST_CAMERA = 5.7
"""Mean leave-one-out dE2000 of a matrix on 24 patches: the worst of 51 cameras under 3 lights."""
_MOST_RESIDUAL = 0.02  # relative: 8 bits at 16 of 255 leave 0.03
_REFLECTANCE = 0.03  # rms, of what repeated measurements of a chart differ by, times three
_DRAWN_PX = 80  # of a patch in a figure


@dataclass(frozen=True, kw_only=True, eq=False)
class Photograph:
    """A picture of a chart.

    Parameters
    ----------
    corners_px : (4, 2) float, or None
        Centres of the corner patches where the card is not to be found.
    expected
        What the fit has to be: "trusted", "refused"; "" where nothing is asked.
    """

    name: str
    image: Image
    reference: Sequence[PaletteColour]
    corners_px: FloatArray | None = None
    expected: str = ""

    @cached_property
    def reading(self) -> CardReading:
        """What is read from it."""
        found = (
            find_card(self.image)
            if self.corners_px is None
            else measure_card(self.image, self.corners_px)
        )
        if not isinstance(found, CardReading):
            raise TypeError(f"{self.name}: {found.reason}")
        return found

    @cached_property
    def fitted(self) -> ChartFit:
        """The best model."""
        result = fit(self.reading, self.reference)
        if isinstance(result, str):
            raise TypeError(f"{self.name}: {result}")
        return result

    @property
    def left_out(self) -> float:
        """Mean leave-one-out error of the patches that were used."""
        return float(self.fitted.left_out_delta_e[self.fitted.used].mean())


def photographs() -> Iterator[Photograph]:
    """Yield the pictures of the test data."""
    data, card = data_folder(), colour_checker_palette()

    def read(path: str, encoding: EncodingName) -> Image:
        image = read_image(data / path, encoding=encoding)
        assert isinstance(image, Image), image  # noqa: S101
        return image

    linear = read("chart_andriy_linear/color_target_sun.tif", "linear")
    yield Photograph(name="andriy_linear", image=linear, reference=card, expected="trusted")
    doubled = np.minimum(linear.pixels * 1.5, 255).astype(np.uint8)
    yield Photograph(
        name="andriy_linear, exposed x1.5 (by us)",
        image=replace(linear, pixels=doubled),
        reference=card,
        corners_px=np.array([[49.5, 49.5], [549.5, 49.5], [549.5, 348.5], [49.5, 348.5]]),
        expected="trusted",
    )
    for number in ("", "2"):
        path = f"chart_macduff/below_fishbox{number}.jpg"
        image = read(path, "srgb")
        yield Photograph(name=f"macduff{number}", image=image, reference=card, expected="trusted")
    yield Photograph(
        name="plantcv_partial",
        image=read("chart_plantcv_partial/partial_card_rgb.png", "srgb"),
        reference=card,
        expected="refused",
    )
    yield _unfiltered(data / "chart_bllanos")


def _unfiltered(folder: Path) -> Photograph:
    """Return the chart of seven bands in the projector's own light, one pixel per 2 x 2 sites."""
    chart = BandChart(folder)
    stored = chart.raw("multispectral_images/d2_colorChecker30cm_raw01.tif")
    green = (stored[0::2, 0::2] + stored[1::2, 1::2]) / 2
    pixels = np.stack([stored[1::2, 0::2], green, stored[0::2, 1::2]], axis=-1)
    image = Image(pixels=(pixels / 255).astype(np.float32), encoding="linear", bits=32)
    weights = observer() * illuminant("D65")[:, None]
    xyz = chart.spectra @ weights / weights[:, 1].sum()
    reference = [
        PaletteColour(name=colour.name, xyz_d65=(float(x), float(y), float(z)))
        for colour, (x, y, z) in zip(colour_checker_palette(), xyz, strict=True)
    ]
    return Photograph(
        name="bllanos, projector light",
        image=image,
        reference=reference,
        corners_px=(chart.centres_px[list(CARD_CORNERS)] - 0.5) / 2,
        expected="trusted",
    )


def main(argv: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figures", type=Path, help="draw the corrected charts into this folder")
    options = parser.parse_args(argv)
    if not data_folder().is_dir():
        parser.error(f"{data_folder()} holds no test data: set CALICHROME_DATA")
    bars = [*_print_bands(BandChart(data_folder() / "chart_bllanos"))]
    rows, notes = [], []
    for photograph in photographs():
        reading, fitted = photograph.reading, photograph.fitted
        lit = fitted.light.at(CARD_PLACES)
        white = photograph.reading.rgb[18]
        rows.append(
            [
                photograph.name,
                f"{reading.tilt_deg:.0f}",
                f"{reading.recession:.2f}",
                f"{int((reading.clipped > 0).sum())}",
                f"{1 - lit.min() / lit.max():.0%}",
                f"{(fitted.light.veil_rgb / white).max():.1%}",
                fitted.model.MODEL,
                f"{int(fitted.used.sum())}",
                f"{fitted.fit_delta_e[fitted.used].mean():.2f}",
                f"{photograph.left_out:.2f}",
                f"{fitted.left_out_delta_e[fitted.used].max():.1f}",
                "yes" if fitted.trustworthy else "NO",
            ]
        )
        notes += [f"{photograph.name}: {text}" for text in reading.remarks]
        notes += [f"{photograph.name}: {doubt.code}: {doubt.text}" for doubt in fitted.doubts]
        bars += _bars(photograph)
        if options.figures is not None:
            options.figures.mkdir(parents=True, exist_ok=True)
            name = photograph.name.partition(",")[0].replace(" ", "_")
            drawn = draw_chart(photograph)[..., ::-1]
            cv2.imwrite(str(options.figures / f"{name}_{len(rows)}.png"), drawn)
    head = ["picture", "tilt", "recession", "clipped", "light falls by", "veil", "model", "used"]
    print_table([*head, "fit", "left out", "worst", "trusted"], rows)
    print("\n" + "\n".join(notes) + "\n")
    print_bars(bars)


def _bars(photograph: Photograph) -> Iterator[Bar]:
    name, fitted = photograph.name, photograph.fitted
    if photograph.expected == "trusted":
        yield Bar(f"{name}: trusted", float(fitted.trustworthy), low=1)
        yield Bar(f"{name}: left out, mean dE2000", photograph.left_out, high=_WORST_CAMERA)
    elif photograph.expected == "refused":
        yield Bar(f"{name}: trusted", float(fitted.trustworthy), high=0)


def _print_bands(chart: BandChart) -> Iterator[Bar]:
    """Print linearity over the exposures, and spectra from seven bands."""
    told, truth = chart.left_out
    rows = []
    for column, band in enumerate(chart.bands):
        error = float(np.sqrt(np.mean((told[:, column] - truth[:, column]) ** 2)))
        found = chart.linearity(band)
        cells = ["", "", "0"]
        if found is not None:
            cells = [f"{found.exponent:.4f}", f"{found.residual:.2%}", f"{found.n}"]
            yield Bar(f"{band} nm: exponent", found.exponent, low=0.98, high=1.02)
            yield Bar(f"{band} nm: residual", found.residual, high=_MOST_RESIDUAL)
        rows.append([f"{band}", *cells, f"{error:.4f}"])
    head = ["band, nm", "exponent of time", "residual", "patch means", "reflectance, left out"]
    print("\nbllanos: seven bands, seven exposures")
    print_table(head, rows)
    spectra = chart.left_out_spectra
    weights = observer() * illuminant("D65")[:, None] / (observer()[:, 1] @ illuminant("D65"))
    delta_e = delta_e_2000_xyz(spectra @ weights, chart.spectra @ weights)
    rms = float(np.sqrt(np.mean((spectra - chart.spectra) ** 2)))
    print(
        f"\n24 spectra from 7 bands, each left out: reflectance {rms:.4f} rms, dE2000 (D65) "
        f"{delta_e.mean():.2f} mean, {delta_e.max():.1f} largest\n"
    )
    bands = float(np.sqrt(np.mean((told - truth)[:, 1:] ** 2)))
    yield Bar("reflectance in 450 to 700 nm, left out, rms", bands, high=_REFLECTANCE)


def draw_chart(photograph: Photograph) -> UInt8Array:
    """Draw the chart as taken, and corrected with the reference inside each patch, side by side."""
    reading, fitted = photograph.reading, photograph.fitted
    to_px = fit_homography(CARD_PLACES[list(CARD_CORNERS)], reading.corners_px)
    y, x = np.mgrid[: 4 * _DRAWN_PX, : 6 * _DRAWN_PX]
    places = (np.stack([x, y], axis=-1) + 0.5) / _DRAWN_PX - np.array([3.0, 2.0])
    at = apply_homography(to_px, places).reshape(-1, 2)
    column, row = np.clip(np.rint(at).astype(int), 0, np.array(photograph.image.size_wh) - 1).T
    light = photograph.image.linear()[row, column]
    even = fitted.light.removed(light, places.reshape(-1, 2))
    corrected = fitted.model.apply(even).reshape(*x.shape, 3)
    nearest = np.abs(places[..., None, :] - CARD_PLACES)
    inside = (nearest < 0.2).all(axis=-1)
    index = inside.argmax(axis=-1)
    xyz = np.array([colour.xyz_d65 for colour in photograph.reference])
    corrected = np.where(inside.any(axis=-1)[..., None], xyz[index], corrected)
    shown = encode(np.clip(corrected @ RGB_FROM_XYZ["srgb"].T, 0, 1), "srgb")
    taken = encode(np.clip(light / np.nanmax(reading.rgb), 0, 1), "srgb").reshape(shown.shape)
    both = np.concatenate([taken, shown], axis=1)
    return np.asarray(np.rint(255 * both), dtype=np.uint8)


if __name__ == "__main__":
    main()
