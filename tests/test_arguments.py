"""Numbers that techniques are given: which errors are raised for what is none or out of range."""

from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from treelod.techniques.technique import number, numbers, resolution_texels, whole, whole_numbers

NO_NUMBERS = [
    None,
    "3",
    b"3",
    True,
    np.True_,
    1j,
    np.complex128(1),
    {3},
    {3: 4},
    [[3]],
    [3, None],
    ["3"],
    [True],
    np.array([[3]]),
    np.array([True]),
    np.array(["3"]),
    np.array(1j),
]


@pytest.mark.parametrize("value", NO_NUMBERS, ids=repr)
@pytest.mark.parametrize("read", [number, numbers, whole, whole_numbers])
def test_what_is_no_number_is_a_type_error_that_names_it(read, value):
    with pytest.raises(TypeError, match=r"^size must be a "):
        read("size", value)


@pytest.mark.parametrize("value", [3.0, 2.5, [3, 2.5], np.array([3.0]), np.float64(3), Fraction(3)])
@pytest.mark.parametrize("read", [whole, whole_numbers])
def test_what_is_not_whole_is_a_type_error(read, value):
    with pytest.raises(TypeError, match=r"^size must be a whole number"):
        read("size", value)


@pytest.mark.parametrize("read", [whole, whole_numbers])
@pytest.mark.parametrize("value", [0, -1, 2**32, np.int64(-1)])
def test_what_is_out_of_range_is_a_value_error(read, value):
    with pytest.raises(ValueError, match=r"^size must be at least 1 and below 2"):
        read("size", value)


def test_what_is_out_of_range_among_several_is_a_value_error():
    for value in ([1, 0], (1, 2**32), np.array([3, -2])):
        with pytest.raises(ValueError, match=r"^size must be at least 1"):
            whole_numbers("size", value)


def test_one_number_or_several_are_a_list():
    whole_ones = [3, np.int64(3), np.uint8(3), np.array(3)]
    for one in [*whole_ones, 3.0, np.float32(3), np.array(3.0), Fraction(3), Decimal(3)]:
        assert numbers("size", one) == [number("size", one)] == [3.0]
        assert type(numbers("size", one)[0]) is float
    for one in whole_ones:
        assert whole_numbers("size", one) == [3]
        assert type(whole_numbers("size", one)[0]) is int
    for read in (numbers, whole_numbers):
        for several in ([3, 4], (3, 4), range(3, 5), np.array([3, 4])):
            assert read("size", several) == [3, 4]
        assert read("size", []) == []
    assert numbers("size", [3, 4.5]) == [3.0, 4.5]
    # what is in range, the core knows
    assert numbers("size", [-1, float("inf")]) == [-1.0, float("inf")]


def test_resolutions_are_one_number_or_two():
    assert resolution_texels("size", 8) == (8, 8)
    assert resolution_texels("size", (8, 4)) == (8, 4)
    assert resolution_texels("size", [np.int64(8), 4]) == (8, 4)
    for value in ("8", b"88", None, 8.0, (8, 4.0), ("8", "4"), True):
        with pytest.raises(TypeError, match=r"^size must be a "):
            resolution_texels("size", value)
    for value in ((), (8,), (8, 4, 2), (8, 0), 0):
        with pytest.raises(ValueError, match=r"^size must be a"):
            resolution_texels("size", value)
