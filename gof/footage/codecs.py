"""Statements of a coded stream itself, where its container has none: whether a frame is two fields, and its colours."""

from __future__ import annotations

from dataclasses import dataclass

from gof.footage.colour import UNKNOWN, Colour
from gof.footage.containers import DAMAGED

HIGH_PROFILES = (100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135)  # of H.264, which state a chroma format
OTHER_ASPECT = 255  # of a pixel: not one of the table
SEQUENCE_H265, PROFILE_BITS, LEVEL_BITS, MOST_SETS = 33, 88, 8, 65  # of H.265


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
        """Read that of an H.264, H.265, MPEG-2 or DV stream; others, and damaged ones, state nothing here.

        Args:
            codec: FFmpeg's four letters.   description: what the container hands to the decoder ("extradata").
        """
        try:
            if codec.lower() in (b"h264", b"avc1"):
                return _read_h264(description)
            if codec.lower() in (b"hevc", b"hvc1", b"hev1"):
                return cls(colour=_read_h265(description))
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
        bits.skip_exp_golomb(4)
    return _colour_in_use(bits)


def _colour_in_use(bits: _Bits) -> Colour:
    """Return that of the usability information, which both codecs begin alike."""
    if not bits.read(1):
        return UNKNOWN
    if bits.read(1) and bits.read(8) == OTHER_ASPECT:
        bits.read(32)
    if bits.read(1):  # overscan
        bits.read(1)
    if not bits.read(1):
        return UNKNOWN
    bits.read(3)
    full_range = bits.read(1) == 1
    if not bits.read(1):
        return Colour(full_range=full_range)
    return Colour(bits.read(8), bits.read(8), bits.read(8), full_range)


def _read_h265(description: bytes) -> Colour:
    """Read the first sequence parameter set and its usability information (ITU-T H.265, 7.3.2.2.1 and E.2.1)."""
    units = _units_of_configuration(description) if description[:1] == b"\1" else description.split(b"\0\0\1")
    unit = next(unit for unit in [*units, b"\x42\1"] if len(unit) > 1 and unit[0] >> 1 & 63 == SEQUENCE_H265)
    bits = _Bits(unit[2:1024].replace(b"\0\0\3", b"\0\0"))
    bits.read(4)
    layers = bits.read(3)
    bits.read(1 + PROFILE_BITS + LEVEL_BITS)
    stated = [(bits.read(1), bits.read(1)) for _ in range(layers)]
    bits.read(2 * (8 - layers) if layers else 0)
    for has_profile, has_level in stated:
        bits.read(PROFILE_BITS * has_profile + LEVEL_BITS * has_level)
    bits.exp_golomb()
    if bits.exp_golomb() == 3:
        bits.read(1)
    bits.skip_exp_golomb(2)
    if bits.read(1):  # cropped
        bits.skip_exp_golomb(4)
    bits.skip_exp_golomb(2)
    count_bits = bits.exp_golomb() + 4
    bits.skip_exp_golomb(3 * (layers + 1 if bits.read(1) else 1) + 6)
    if bits.read(1) and bits.read(1):
        return UNKNOWN  # scaling lists: not followed
    bits.read(2)
    if bits.read(1):  # uncompressed blocks
        bits.read(8)
        bits.skip_exp_golomb(2)
        bits.read(1)
    _skip_reference_sets(bits)
    if bits.read(1):  # long-term references
        bits.read(bits.exp_golomb() * (count_bits + 1))
    bits.read(2)
    return _colour_in_use(bits)


def _units_of_configuration(description: bytes) -> list[bytes]:
    """Return the units of an MP4's configuration record (ISO/IEC 14496-15, 8.3.2.1)."""
    units, at = [], 23
    for _ in range(description[22]):
        count, at = int.from_bytes(description[at + 1 : at + 3], "big"), at + 3
        for _ in range(count):
            end = at + 2 + int.from_bytes(description[at : at + 2], "big")
            units.append(description[at + 2 : end])
            at = end
    return units


def _skip_reference_sets(bits: _Bits) -> None:
    """Go past the short-term reference picture sets (7.3.7)."""
    pictures = 0  # of the set before
    for number in range(min(bits.exp_golomb(), MOST_SETS)):
        if number and bits.read(1):  # told by the set before
            bits.read(1)
            bits.exp_golomb()
            pictures = sum(bits.read(1) or bits.read(1) for _ in range(pictures + 1))
            continue
        pictures = bits.exp_golomb() + bits.exp_golomb()
        for _ in range(min(pictures, MOST_SETS)):
            bits.exp_golomb()
            bits.read(1)


class _Bits:
    """A reader of bits, the highest of a byte first."""

    def __init__(self, data: bytes):
        self._bits, self._at = "".join(f"{byte:08b}" for byte in data), 0

    def read(self, count: int) -> int:
        self._at += count
        return int(self._bits[self._at - count : self._at], 2) if count else 0

    def exp_golomb(self) -> int:
        zeros = self._bits.index("1", self._at) - self._at
        self._at += zeros
        return self.read(zeros + 1) - 1

    def skip_exp_golomb(self, count: int) -> None:
        for _ in range(count):
            self.exp_golomb()
