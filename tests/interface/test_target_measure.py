"""``target measure`` and ``target make`` as their user meets them."""

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calichrome.colorimetry.difference import delta_e_2000_xyz
from calichrome.colorimetry.reference import colour_checker_spectra
from calichrome.detection.card import CardReading
from calichrome.detection.card_search import find_card
from calichrome.imaging import Image, read_image
from calichrome.target import Target, load_target, target_to_json

sys.path.insert(0, str(Path(__file__).parents[2]))  # benchmarks are no part of the package

from benchmarks.colour.beside_card import printed_scenes, write_pictures

Cli = Callable[..., Any]
Refused = Callable[..., str]


@pytest.fixture(scope="module")
def photographs(standard_target: Target, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One picture of board and card, with target.json beside it."""
    folder = tmp_path_factory.mktemp("by_card")
    write_pictures(
        printed_scenes(standard_target, 2, sides=("left",), size_wh=(960, 720)), folder / "pictures"
    )
    (folder / "board.json").write_text(json.dumps(target_to_json(standard_target)))
    return folder


def test_from_card_says_what_it_found(cli: Cli, photographs: Path, tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    shutil.copytree(photographs / "pictures", pictures)
    (pictures / "torn.png").write_bytes(b"no picture")
    output = tmp_path / "measured.json"
    words = ("target", "measure", photographs / "board.json", "--from-card", pictures)
    outcome = cli(*words, "--square", "29.9mm", "-o", output)
    assert outcome.code == 0, outcome.err
    for part in (
        "48 discs measured by 1 of 2 pictures",
        "Change against before: ",
        "Estimated error: ",
        "Paper: Y = ",
        "left.png: ",
        "left out torn.png: ",
        "with measured 48 discs and squares of 29.9mm",
    ):
        assert part in outcome.out
    target = load_target(output)
    assert target.colours_measured
    assert target.square_size_measured
    assert target.paper.white_xyz_d65 is not None

    outcome = cli(*words, "-o", output, "--force", "--json")
    assert len(outcome.json["discs"]) == 48
    assert outcome.json["left_out"][0]["file"].endswith("torn.png")
    assert 0 < outcome.json["paper_white_Y_sigma"] < 5
    assert outcome.json["sigma_delta_e_2000"]["mean"] < 2.5


def test_corners_of_the_card_come_from_a_file(cli: Cli, photographs: Path, tmp_path: Path) -> None:
    picture = photographs / "pictures" / "left.png"
    image = read_image(picture)
    assert isinstance(image, Image)
    card = find_card(image)
    assert isinstance(card, CardReading)
    corners = tmp_path / "corners.csv"
    np.savetxt(corners, card.corners_px, delimiter=",", header="x,y", comments="")
    words = ("target", "measure", photographs / "board.json", "--from-card", picture)
    output = tmp_path / "measured.json"
    assert cli(*words, "--card-corners", corners, "-o", output).code == 0
    assert load_target(output).colours_measured


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ((), "nothing was measured"),
        (("--values", "v.csv", "--from-card", "p"), "give one of them"),
        (("--square", "30mm", "--card-corners", "c.csv"), "--card-corners belongs to pictures"),
        (("--square", "30mm", "--encoding", "srgb"), "--encoding belongs to pictures"),
        (("--from-card", "nowhere"), "nowhere: is not there"),
    ],
)
def test_options_that_do_not_go_together(
    refused: Refused, photographs: Path, tmp_path: Path, options: tuple[str, ...], says: str
) -> None:
    board = photographs / "board.json"
    refused("target", "measure", board, *options, "-o", tmp_path / "m.json", says=[says])


def test_a_refused_measurement_leaves_nothing(
    refused: Refused, photographs: Path, tmp_path: Path
) -> None:
    picture = tmp_path / "no_card.png"
    image = read_image(photographs / "pictures" / "left.png")
    assert isinstance(image, Image)
    import cv2

    cv2.imwrite(str(picture), image.pixels[:, image.size_wh[0] // 2 :, ::-1])
    words = ("target", "measure", photographs / "board.json", "--from-card", picture)
    refused(*words, "-o", tmp_path / "m.json", says=["no_card.png: no ColorChecker card"])


def test_spectra_of_an_instrument_measure_a_board(
    cli: Cli, photographs: Path, tmp_path: Path
) -> None:
    bands = range(380, 731, 10)
    fields = ["SAMPLE_NAME", *(f"SPECTRAL_NM{band}" for band in bands)]
    rows = [
        "\t".join([name, *(f"{value:.4f}".replace(".", ",") for value in spectrum[:71:2])])
        for name, spectrum in colour_checker_spectra().items()
    ]
    text = ["CGATS.17", "BEGIN_DATA_FORMAT", "\t".join(fields), "END_DATA_FORMAT"]
    text += ["BEGIN_DATA", *rows, "END_DATA", ""]
    values = tmp_path / "print.txt"
    values.write_text("\n".join(text), encoding="utf-8")
    output = tmp_path / "measured.json"
    words = ("target", "measure", photographs / "board.json", "--values", values)
    outcome = cli(*words, "-o", output)
    assert outcome.code == 0, outcome.err
    before, after = load_target(photographs / "board.json"), load_target(output)
    assert after.colours_measured
    # the nominal colours are the same spectra, interpolated by straight lines between 10 nm
    assert delta_e_2000_xyz(after.marker_xyz_d65, before.marker_xyz_d65).max() < 0.3

    outcome = cli("target", "make", "--palette", values, "-o", tmp_path / "made.json")
    assert outcome.code == 0, outcome.err
    assert len({marker.name for marker in load_target(tmp_path / "made.json").markers}) == 24
