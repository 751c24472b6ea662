"""Paths and their errors, from pairs made by hand."""

import numpy as np
import pytest

from calichrome.core.arrays import FloatArray
from calichrome.core.pose import Pose
from calichrome.errors import DisconnectedRigError, SolveError
from calichrome.geometry.pairs import PairSolution
from calichrome.geometry.rig_graph import UncertainPose, connect_cameras

Source = tuple[str, str | None]


def _pair(
    trans_m: tuple[float, float, float] = (1, 0, 0),
    rms_px: float = 0.3,
    n_shared: int = 10,
    errors: dict[tuple[int, str | None], FloatArray] | None = None,
) -> PairSolution:
    motion = Pose(np.eye(3), np.array(trans_m))
    return PairSolution(b_from_a=motion, errors=errors, rms_px=rms_px, n_shared=n_shared)


def test_the_path_has_the_lowest_sum_of_errors() -> None:
    pairs = {
        ("a", "b"): _pair((1, 0, 0), 0.3),
        ("b", "c"): _pair((0, 1, 0), 0.3),
        ("a", "c"): _pair((5, 5, 5), 0.7),
    }
    graph = connect_cameras("abc", pairs, "a")
    assert graph.paths == {"a": ("a",), "b": ("a", "b"), "c": ("a", "b", "c")}
    np.testing.assert_allclose(graph.cams_from_ref["c"].pose.trans_m, [1, 1, 0])
    pairs["a", "c"] = _pair((5, 5, 5), 0.5)
    assert connect_cameras("abc", pairs, "a").paths["c"] == ("a", "c")


def test_steps_against_the_pair_are_inverted() -> None:
    pairs = {("a", "b"): _pair((1, 0, 0)), ("a", "c"): _pair((0, 2, 0))}
    graph = connect_cameras("abc", pairs, "b")
    assert graph.paths["c"] == ("b", "a", "c")
    np.testing.assert_allclose(graph.cams_from_ref["c"].pose.trans_m, [-1, 2, 0])


def test_the_reference_is_the_camera_in_the_middle() -> None:
    pairs = {("a", "b"): _pair(), ("b", "c"): _pair(), ("c", "d"): _pair(), ("b", "e"): _pair()}
    assert connect_cameras("abcde", pairs).reference == "b"
    assert connect_cameras("abcde", pairs, "d").reference == "d"


def test_perfect_pairs_connect_too() -> None:
    """A weight of zero would be no edge in a sparse graph."""
    graph = connect_cameras("ab", {("a", "b"): _pair(rms_px=0.0)}, "a")
    assert graph.paths["b"] == ("a", "b")


@pytest.mark.parametrize(("n_shared", "path"), [(3, "ac"), (2, "abdc")])
def test_few_shared_views_are_the_last_resort(n_shared: int, path: str) -> None:
    pairs = {
        ("a", "b"): _pair(rms_px=5), ("b", "d"): _pair(rms_px=5), ("c", "d"): _pair(rms_px=5),
        ("a", "c"): _pair(rms_px=0.1, n_shared=n_shared),
    }  # fmt: skip
    assert connect_cameras("abcd", pairs, "a").paths["c"] == tuple(path)
    only = {("a", "c"): pairs["a", "c"]}
    assert connect_cameras("ac", only, "a").paths["c"] == ("a", "c")


def test_groups_are_named() -> None:
    with pytest.raises(DisconnectedRigError, match=r"2 groups .* a, c \| b") as caught:
        connect_cameras("abc", {("a", "c"): _pair()})
    assert caught.value.groups == (("a", "c"), ("b",))


def test_an_unknown_reference_is_refused() -> None:
    with pytest.raises(SolveError, match="reference camera z is not among a, b"):
        connect_cameras("ab", {("a", "b"): _pair()}, "z")


def test_the_reference_has_no_error_and_unknown_stays_unknown() -> None:
    graph = connect_cameras("ab", {("a", "b"): _pair()}, "a")
    np.testing.assert_array_equal(_cov(graph.cams_from_ref["a"]), np.zeros((6, 6)))
    assert graph.cams_from_ref["b"].cov is None


def _cov(place: UncertainPose) -> FloatArray:
    assert place.cov is not None
    return place.cov


def _uncertain(rng: np.random.Generator, *sources: Source) -> UncertainPose:
    pose = Pose.from_rotvec(rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3))
    return UncertainPose(pose, {source: rng.normal(0, 1e-4, (6, 6)) for source in sources})


def _disturbed(motion: UncertainPose, draws: dict[Source, FloatArray]) -> Pose:
    assert motion.errors is not None
    step = sum((part @ draws[source] for source, part in motion.errors.items()), np.zeros(6))
    return motion.pose.perturbed(step)


def _difference(found: Pose, truth: Pose) -> FloatArray:
    turn = Pose(found.rotation @ truth.rotation.T, np.zeros(3)).rotvec_rad
    return np.concatenate([turn, found.trans_m - truth.trans_m])


def test_errors_follow_the_motions(rng: np.random.Generator) -> None:
    """Inverting and composing disturbed motions gives what the responses say, to first order."""
    a_from_b = _uncertain(rng, ("b", None), ("a", "01"))
    b_from_c = _uncertain(rng, ("b", None), ("c", "01"))
    sources: list[Source] = [("b", None), ("a", "01"), ("c", "01")]
    draws = {source: rng.normal(size=6) for source in sources}
    first, second = _disturbed(a_from_b, draws), _disturbed(b_from_c, draws)
    for predicted, found in (
        (a_from_b.inverse(), first.inverse()),
        (a_from_b @ b_from_c, first @ second),
        ((a_from_b @ b_from_c).inverse(), (first @ second).inverse()),
    ):
        expected = _disturbed(predicted, draws)
        # second order: squares of steps of about 4e-4
        np.testing.assert_allclose(
            _difference(expected, predicted.pose), _difference(found, predicted.pose), atol=3e-6
        )


def test_shared_errors_cancel_on_the_way_back(rng: np.random.Generator) -> None:
    """There and back again is certain, although each way is not."""
    a_from_b = _uncertain(rng, ("a", None), ("b", "01"))
    around = a_from_b @ a_from_b.inverse()
    np.testing.assert_allclose(_cov(around), 0, atol=1e-20)  # (1e-4)^2 if they did not cancel


def test_cameras_share_their_lens_along_a_path(rng: np.random.Generator) -> None:
    """The names of errors are those of the cameras, whichever side of a pair they are on."""
    lens_b = rng.normal(0, 1e-3, (6, 9))
    pairs = {
        ("a", "b"): _pair((0, 0, 0), errors={(1, None): lens_b}),
        ("b", "c"): _pair((0, 0, 0), errors={(0, None): -lens_b}),  # b seems to move: c with it
    }
    graph = connect_cameras("abc", pairs, "a")
    np.testing.assert_allclose(_cov(graph.cams_from_ref["b"]), lens_b @ lens_b.T, rtol=1e-12)
    np.testing.assert_allclose(_cov(graph.cams_from_ref["c"]), 0, atol=1e-20)
