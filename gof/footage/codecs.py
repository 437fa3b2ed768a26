"""Statements of a coded stream itself, where its container has none: whether a frame is two fields, and its colours."""

from __future__ import annotations

from dataclasses import dataclass

from gof.footage.colour import UNKNOWN, Colour
from gof.footage.containers import DAMAGED

HIGH_PROFILES = (100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135)  # of H.264, which state a chroma format
OTHER_ASPECT = 255  # of H.264's pixels: not one of its table


@dataclass(frozen=True)
class CodedStream:
    """Statements of a stream.

    Attributes:
        two_fields: whether its frames may be two fields.
        colour: what its code values mean.
    """

    two_fields: bool = False
    colour: Colour = UNKNOWN

    @classmethod
    def of(cls, codec: bytes, description: bytes) -> CodedStream:
        """Read that of an H.264, MPEG-2 or DV stream; others, and damaged ones, state nothing here.

        Args:
            codec: FFmpeg's four letters.   description: what the container hands to the decoder ("extradata").
        """
        try:
            if codec.lower() in (b"h264", b"avc1"):
                return _read_h264(description)
            if codec.lower() in (b"mpg2", b"mpeg"):
                return _read_mpeg2(description)
        except DAMAGED:
            return cls()
        return cls(codec[:3].lower() in (b"dvs", b"dvc", b"dvp"))


def _read_mpeg2(description: bytes) -> CodedStream:
    """Read the sequence's extensions (ITU-T H.262, 6.2.2)."""
    two_fields, colour = False, UNKNOWN
    for part in description.split(b"\0\0\1\xb5")[1:]:
        if part[0] >> 4 == 1:
            two_fields = not part[1] & 8  # its 13th bit says "progressive"
        if part[0] >> 4 == 2 and part[0] & 1:
            colour = Colour(*part[1:4])
    return CodedStream(two_fields, colour)


def _read_h264(description: bytes) -> CodedStream:
    """Read the first sequence parameter set and its usability information (ITU-T H.264, 7.3.2.1.1 and E.1.1)."""
    if description[:1] == b"\1":
        start = 8
    else:
        starts = (k + 3 for k in range(len(description) - 4) if description[k : k + 3] == b"\0\0\1")
        start = next((k for k in starts if description[k] & 31 == 7), len(description))
    bits = _Bits(description[start + 1 : start + 256].replace(b"\0\0\3", b"\0\0"))
    profile = bits.read(8)
    bits.read(16)
    bits.exp_golomb()
    if profile in HIGH_PROFILES:
        if bits.exp_golomb() == 3:
            bits.read(1)
        bits.exp_golomb()
        bits.exp_golomb()
        bits.read(1)
        if bits.read(1):
            return CodedStream()  # scaling lists: not followed
    bits.exp_golomb()
    order = bits.exp_golomb()
    if order == 0:
        bits.exp_golomb()
    elif order == 1:
        bits.read(1)
        for _ in range(2):
            bits.exp_golomb()
        for _ in range(min(bits.exp_golomb(), 255)):
            bits.exp_golomb()
    bits.exp_golomb()
    bits.read(1)
    bits.exp_golomb()
    bits.exp_golomb()
    two_fields = not bits.read(1)
    try:
        return CodedStream(two_fields, _colour_of_h264(bits, two_fields))
    except DAMAGED:
        return CodedStream(two_fields)


def _colour_of_h264(bits: _Bits, two_fields: bool) -> Colour:
    """Return that of a sequence parameter set that was read up to `frame_mbs_only_flag`."""
    bits.read(2 if two_fields else 1)
    if bits.read(1):  # cropped
        for _ in range(4):
            bits.exp_golomb()
    if not bits.read(1):  # no usability information
        return UNKNOWN
    if bits.read(1) and bits.read(8) == OTHER_ASPECT:
        bits.read(32)
    if bits.read(1):  # overscan
        bits.read(1)
    if not bits.read(1):
        return UNKNOWN
    bits.read(3)
    full_range = bits.read(1) == 1
    points = [bits.read(8) for _ in range(3)] if bits.read(1) else []
    return Colour(*points, full_range=full_range)


class _Bits:
    """A reader of bits, the highest of a byte first."""

    def __init__(self, data: bytes):
        self._bits, self._at = "".join(f"{byte:08b}" for byte in data), 0

    def read(self, count: int) -> int:
        self._at += count
        return int(self._bits[self._at - count : self._at], 2)

    def exp_golomb(self) -> int:
        zeros = self._bits.index("1", self._at) - self._at
        self._at += zeros
        return self.read(zeros + 1) - 1
