"""Values into bytes and back: nothing may be lost, and damage must show."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calichrome.pipeline.packing import PackingError, layout, pack, unpack


@dataclass(frozen=True)
class Inner:
    values: Any


@dataclass(frozen=True)
class Outer:
    name: str
    inner: Inner | None = None


TYPES = {"Inner": Inner, "Outer": Outer}

plain = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
values = st.recursive(
    plain,
    lambda inner: (
        st.lists(inner, max_size=3).map(tuple)
        | st.dictionaries(st.text(), inner, max_size=3)
        | inner.map(Inner)
        | inner.map(lambda item: Outer("x", Inner(item)))
    ),
    max_leaves=8,
)


@given(value=values)
def test_unpacking_is_the_inverse(value: object) -> None:
    assert repr(unpack(pack(value, TYPES), TYPES)) == repr(value)


@pytest.mark.parametrize("dtype", ["<f8", "<f4", ">i2", "<i8", "|u1", "|b1"])
@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 3, 4)])
def test_arrays_keep_type_shape_and_bits(
    dtype: str, shape: tuple[int, ...], rng: np.random.Generator
) -> None:
    array = rng.integers(0, 2, shape).astype(dtype)
    back = unpack(pack(Inner((array, array.T)), TYPES), TYPES)
    assert isinstance(back, Inner)
    for packed, unpacked in zip((array, array.T), back.values, strict=True):
        assert (unpacked.dtype, unpacked.shape) == (packed.dtype, packed.shape)
        assert unpacked.tobytes() == packed.tobytes()


def test_numbers_that_text_would_lose() -> None:
    strange = np.array([np.nan, -np.nan, np.inf, -0.0, 5e-324, np.nextafter(1, 2)])
    back = unpack(pack(strange, TYPES), TYPES)
    assert isinstance(back, np.ndarray)
    assert back.tobytes() == strange.tobytes()
    assert repr(unpack(pack((float("nan"), -0.0), TYPES), TYPES)) == "(nan, -0.0)"


def test_scalars_of_numpy_become_numbers() -> None:
    back = unpack(pack((np.bool_(1), np.float64(0.1), np.int64(2)), TYPES), TYPES)
    assert repr(back) == "(True, 0.1, 2)"


@pytest.mark.parametrize(
    "value", [{1, 2}, {1: 2}, [1], np.array(["a"]), np.array([{}]), object(), Inner(1j)]
)
def test_what_is_not_known_is_refused(value: object) -> None:
    with pytest.raises(TypeError, match="cannot be packed"):
        pack(value, TYPES)


def test_any_flipped_byte_shows() -> None:
    content = pack(Outer("board", Inner(np.arange(5.0))), TYPES)
    for place in range(len(content)):
        damaged = bytearray(content)
        damaged[place] ^= 0x10
        with pytest.raises(PackingError):
            unpack(bytes(damaged), TYPES)
    for length in range(len(content)):
        with pytest.raises(PackingError):
            unpack(content[:length], TYPES)


def test_types_of_another_release_are_refused() -> None:
    content = pack(Outer("board"), TYPES)
    with pytest.raises(PackingError):
        unpack(content, {"Inner": Inner})
    with pytest.raises(PackingError):
        unpack(content, {"Inner": Inner, "Outer": Inner})
    assert layout(TYPES) == {"Inner": ["values"], "Outer": ["name", "inner"]}
