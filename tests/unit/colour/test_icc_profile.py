"""ICC profiles, read by another library."""

import io

import numpy as np
import pytest
from PIL import Image as PilImage
from PIL import ImageCms

from calichrome.colorimetry.encoding import encode
from calichrome.colorimetry.icc_profile import icc_profile
from calichrome.colorimetry.rgb_spaces import RGB_FROM_XYZ, XYZ_FROM_RGB


@pytest.mark.parametrize(("space", "name"), [("srgb", "sRGB"), ("display-p3", "Display P3")])
def test_littlecms_reads_colours_as_we_mean_them(
    space: str, name: str, rng: np.random.Generator
) -> None:
    """Colours within sRGB, turned into it by the profile alone, are those that we compute."""
    content = icc_profile(space)
    assert content is not None
    profile = ImageCms.ImageCmsProfile(io.BytesIO(content))
    assert ImageCms.getProfileDescription(profile).strip() == name
    to_linear = RGB_FROM_XYZ["srgb"] @ XYZ_FROM_RGB[space]
    wanted = rng.uniform(0.05, 0.95, (20, 30, 3))
    stored = np.rint(encode(wanted @ np.linalg.inv(to_linear).T, "srgb") * 255).astype(np.uint8)
    found = ImageCms.profileToProfile(
        PilImage.fromarray(stored), profile, ImageCms.createProfile("sRGB"),
        renderingIntent=ImageCms.Intent.RELATIVE_COLORIMETRIC,
    )  # fmt: skip
    assert found is not None
    expected = encode(wanted, "srgb") * 255
    assert np.abs(np.asarray(found, dtype=float) - expected).max() < 2.5


def test_other_spaces_have_none() -> None:
    assert icc_profile("xyz-d65") is None
