"""Files that are a sequence, in one list written by hand."""

from pathlib import Path

import pytest

from gof.core import numbered
from gof.core.errors import DataFormatError

# Names as a folder lists them, and the frames' numbers in order of time.
SEQUENCES = [
    (["1", "10", "11", "12", "2", "3"], [1, 2, 3, 10, 11, 12]),
    (["f_9998", "f_9999", "f_10000", "f_10001"], [9998, 9999, 10000, 10001]),
    (["IMG_0001", "img_0002"], [1, 2]),
    (["fire_v1.0000", "fire_v1.0001", "fire_v1.0003"], None),  # 0, 1, 3, or .0000, .0001, .0003?
    (["fire_v1.0000", "fire_v1.0001", "fire_v1.0002"], [0, 1, 2]),
    (["fire.0000_512x512", "fire.0001_512x512"], [0, 1]),
    (["a_0001_1080p", "a_0002_1080p"], [1, 2]),
    (["a_0001_24fps", "a_0002_24fps"], [1, 2]),
    (["a4k_0001", "a4k_0002"], [1, 2]),
    (["fire.-0001", "fire.0000", "fire.0001"], [-1, 0, 1]),
    (["fire.-0003", "fire.-0002", "fire.-0001"], [-3, -2, -1]),
    (["frame-0001", "frame-0002"], [1, 2]),
    (["2024-01-01", "2024-01-02"], [1, 2]),
    (["frame0007left", "frame0008left"], [7, 8]),
    (["._0001", "0001", ".DS_Store", "0002", "._0002"], [1, 2]),
    (["1001", "1002", "1004"], [1001, 1002, 1004]),
    (["alone"], [0]),
    (["alone7"], [7]),
    ([], []),
    ([f"{10**30}", f"{10**30 + 1}"], [10**30, 10**30 + 1]),
    # two files of one number
    (["fire_v1.0000", "fire_v2.0000"], None),
    (["fire_v1.0000", "fire_v1.0001", "fire_v2.0000", "fire_v2.0001"], None),
    (["fire_v1.0000", "fire_v2.0001"], None),
    (["01", "1"], None),
    (["cam1_0001", "cam2_0001"], None),
    (["0001_512", "0002_512"], None),
    # no number, several sequences, decimals
    (["a", "b"], None),
    (["0001", "0002", "background"], None),
    (["left_0001", "right_0002"], None),
    (["0.25", "0.5"], None),
    (["t0.5", "t0.6", "t0.10"], None),
    (["f_0001_0.041", "f_0002_0.083"], None),
]


@pytest.mark.parametrize(("names", "numbers"), SEQUENCES, ids=lambda value: str(value)[:40])
def test_frames_follow_the_numbers_in_their_names(names, numbers):
    paths = [Path("cache", f"{name}.ply") for name in names]
    for order in (paths, paths[::-1]):
        if numbers is None:
            with pytest.raises(DataFormatError, match="cache"):
                numbered.number_files(order)
        else:
            assert [number for number, _ in numbered.number_files(order)] == numbers


def test_both_files_of_one_number_are_named():
    with pytest.raises(DataFormatError, match=r"0001\.png.*0001\.jpg|0001\.jpg.*0001\.png"):
        numbered.number_files([Path("a/0001.jpg"), Path("a/0001.png")])
    with pytest.raises(DataFormatError, match=r"b/0001\.ply: has the number 1, and so has a/0001\.ply"):
        numbered.number_files([Path("a/0001.ply"), Path("b/0001.ply")])


def test_missing_numbers_are_told_from_an_even_step():
    assert numbered.missing_numbers([1, 2, 4, 9]) == (5, "3, 5 to 8")
    assert numbered.missing_numbers([0, 2, 4, 8]) == (1, "6")
    assert numbered.missing_numbers([0, 5]) == (0, "")
    assert numbered.missing_numbers([7]) == (0, "")
    assert numbered.missing_numbers([1, 2, 10**12]) == (10**12 - 3, f"3 to {10**12 - 1}")
    assert numbered.missing_numbers(list(range(0, 40, 3)) + [40])[1].endswith(", ...")
