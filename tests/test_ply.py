"""PLY files of other tools: every form of the format is read as its text says, and a wrong one names file and line."""

import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gof.core.errors import DataFormatError
from gof.core.ply_file import read_vertices, write_vertices
from tests.plys import read_ply, write_ply

TRIANGLE = [(0.0, 1.5, 7), (2.0, -3.25, 255)]  # x, y, red of two vertices


def ply(path, head, body):
    path.write_bytes(head.encode() + (body if isinstance(body, bytes) else body.encode()))
    return path


def head(*lines, format="ascii", end="\n"):
    return end.join(["ply", f"format {format} 1.0", *lines, "end_header", ""])


VERTEX = ("element vertex 2", "property float x", "property double y", "property uchar red")
ASCII = "0 1.5 7\n2 -3.25 255\n"


def packed(order):
    return b"".join(struct.pack(order + "fdB", *row) for row in TRIANGLE)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("format", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_every_form(tmp_path, format, end):
    body = ASCII.replace("\n", end) if format == "ascii" else packed("<" if "little" in format else ">")
    lines = ("comment made by  a hand", "obj_info 3", *VERTEX)
    got, comments = read_vertices(ply(tmp_path / "a.ply", head(*lines, format=format, end=end), body))
    assert [tuple(row) for row in got.tolist()] == TRIANGLE
    assert comments == ["made by  a hand"]


FACES = [(3, (0, 1, 2)), (0, ()), (4, (3, 2, 1, 0))]


@pytest.mark.parametrize("faces_first", [True, False])
@pytest.mark.parametrize("order", ["text", "<", ">"])
def test_faces_before_or_behind_are_stepped_over(tmp_path, order, faces_first):
    lines = ("element face 3", "property list uchar int vertex_indices", "property short material")
    if order == "text":
        parts = ["".join(f"{n} {' '.join(map(str, of))} 5\n" for n, of in FACES), ASCII]
    else:
        parts = [b"".join(struct.pack(f"{order}B{n}ih", n, *of, 5) for n, of in FACES), packed(order)]
    lines, parts = (lines + VERTEX, parts) if faces_first else (VERTEX + lines, parts[::-1])
    format = {"text": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    got, _ = read_vertices(ply(tmp_path / "a.ply", head(*lines, format=format), parts[0] + parts[1]))
    assert [tuple(row) for row in got.tolist()] == TRIANGLE


@pytest.mark.parametrize("order", ["text", "<", ">"])
def test_lists_between_the_numbers_of_a_vertex_are_left_out(tmp_path, order):
    lines = ("element vertex 2", "property float x", "property list ushort double near", "property int id")
    if order == "text":
        format, body = "ascii", "1.5 2 0.1 0.2 -7\n\n2.5 0 9\n"
    else:
        format = "binary_little_endian" if order == "<" else "binary_big_endian"
        body = struct.pack(f"{order}fHddi", 1.5, 2, 0.1, 0.2, -7) + struct.pack(f"{order}fHi", 2.5, 0, 9)
    got, _ = read_vertices(ply(tmp_path / "a.ply", head(*lines, format=format), body))
    assert got.dtype.names == ("x", "id") and got.tolist() == [(1.5, -7), (2.5, 9)]


def test_written_bytes(tmp_path):
    """Every byte of a small file by hand."""
    vertex = np.array([(1.0, 3), (-2.5, 255)], [("x", "<f4"), ("red", "u1")])
    write_vertices(tmp_path / "a.ply", vertex, ["one", "m/s"])
    text = "ply\nformat binary_little_endian 1.0\ncomment one\ncomment m/s\nelement vertex 2\nproperty float x\n"
    text += "property uchar red\nend_header\n"
    assert (tmp_path / "a.ply").read_bytes() == text.encode() + struct.pack("<fBfB", 1, 3, -2.5, 255)
    for bad in ("two\nlines", "Grüße"):
        with pytest.raises(ValueError, match="comment"):
            write_vertices(tmp_path / "b.ply", vertex, [bad])


WRONG = {
    "no line 'ply'": (head(*VERTEX)[1:], ASCII, "not a PLY"),
    "no vertices": (head("element face 0"), "", "not a PLY file with a 'vertex' element"),
    "no end": (head(*VERTEX).replace("end_header", "comment"), "", "no line 'end_header'"),
    "no format": ("ply\nelement vertex 0\nend_header\n", "", "no line 'format'"),
    "another format": (head(*VERTEX, format="binary"), ASCII, "line 2: 'format binary 1.0'"),
    "another version": (head(*VERTEX).replace("1.0", "2.0", 1), ASCII, "line 2"),
    "two formats": (head("format ascii 1.0", *VERTEX), ASCII, "line 3"),
    "another type": (head("element vertex 2", "property half x"), ASCII, "line 4: no type 'half'; there are char"),
    "a list counted in float": (head("element vertex 2", "property list float int x"), ASCII, "line 4: 'float' cannot"),
    "no element yet": (head("property float x"), ASCII, "line 3: property 'x' stands before"),
    "two of a name": (head(*VERTEX, "property int x"), ASCII, "line 7: a second property 'x'"),
    "two elements": (head(*VERTEX, *VERTEX), ASCII, "line 7: a second element"),
    "no count": (head("element vertex", "property float x"), ASCII, "line 3"),
    "a negative count": (head("element vertex -2", "property float x"), ASCII, "line 3"),
    "a long count": (head(f"element vertex {'9' * 5000}", "property float x"), ASCII, "line 3"),
    "more than there is": (head("element vertex 9", "property float x"), "1\n2\n3\n", "announces 9 points.*truncated"),
    "no properties": (head("element vertex 999999999999"), ASCII, "announces"),
    "a row short": (head(*VERTEX), "0 1.5 7\n\n\n\n\n\n", "ends in line 13 with 1 of 2 vertices"),
    "a value short": (head(*VERTEX), "0 1.5 7\n2 -3.25   \n", "line 9: no value for 'red'"),
    "a value more": (head(*VERTEX), "0 1.5 7 8\n2 -3.25 255\n", "line 8: 4 values, but the header announces 3"),
    "a word": (head(*VERTEX), "0 1.5 7\n2 three 255\n", "line 9: .*three"),
    "too large a number": (head(*VERTEX), "0 1.5 7\n2 -3.25 256\n", r"line 9: 256 is not in 0\.\.255"),
    "a negative list": (head("element vertex 1", "property list int int a"), "-1 \n", "line 6: a list of -1 numbers"),
    "half a row": (head(*VERTEX, format="binary_little_endian"), packed("<")[:-1], "announces 2 points"),
    "a list behind the end": (
        head("element vertex 1", "property list uint int a", "property int b", format="binary_little_endian"),
        struct.pack("<I9i", 2**31, *range(9)),
        "row 0 of 'vertex'.*'a'; truncated",
    ),
    "a list of fewer than none": (
        head("element vertex 1", "property list char int a", "property int b", format="binary_big_endian"),
        struct.pack(">b9i", -3, *range(9)),
        "row 0 of 'vertex'.*'a'",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named_with_file_and_line(tmp_path, name):
    text, body, message = WRONG[name]
    with pytest.raises(DataFormatError, match=message) as caught:
        read_vertices(ply(tmp_path / "wrong.ply", text, body))
    assert "wrong.ply" in str(caught.value) and len(str(caught.value)) < 800


def test_a_big_file_is_read_at_once(tmp_path):
    """As many bytes as the file has, and not a Python object for every number."""
    rows = np.random.default_rng(0).normal(size=(40000, 60)).astype("<f4")
    file = write_ply(tmp_path / "big.ply", rows.view([(f"p{i}", "<f4") for i in range(60)])[:, 0])
    tracemalloc.start()
    got, _ = read_vertices(file)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.array_equal(got.view("<f4").reshape(rows.shape), rows)
    assert peak < 1.1 * rows.nbytes + 2**20
    assert np.array_equal(read_ply(file)[0], got)


# ---------------------------------------------------------------- headers that nobody vouches for

WORDS = st.sampled_from(
    "ply format ascii binary_little_endian binary_big_endian 1.0 comment obj_info element vertex face property list "
    "float double uchar int x y red 0 1 2 3 -1 9999999999 999999999999999999999 end_header \x00 \ufffd".split(" ")
)
LINES = st.lists(st.lists(WORDS, max_size=6).map(" ".join), max_size=12)
LIKELY = st.lists(st.sampled_from([*VERTEX, "element face 1", "property list uchar int i", "comment"]), max_size=8)


@settings(deadline=None, max_examples=300)
@given(
    format=st.sampled_from(["ascii", "binary_little_endian", "binary_big_endian"]),
    lines=st.one_of(LIKELY, LINES),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    body=st.one_of(st.binary(max_size=80), st.text("0123456789.-e \n", max_size=80).map(str.encode)),
)
def test_a_strange_header_is_read_or_refused_by_name(tmp_path_factory, format, lines, end, body):
    path = ply(tmp_path_factory.mktemp("fuzz") / "strange.ply", head(*lines, format=format, end=end), body)
    tracemalloc.start()
    try:
        got, _ = read_vertices(path)
        assert got.nbytes <= 8 * path.stat().st_size, "no more vertices than the file has room for"
    except DataFormatError as e:
        assert "strange.ply" in str(e)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 2**21, "memory follows the file"
