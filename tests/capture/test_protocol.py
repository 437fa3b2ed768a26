"""Framing: round trips, and no bytes whatever may crash, hang or grow the reader."""

from hypothesis import given, settings
from hypothesis import strategies as st

from gof.capture.protocol import FRAME_MAX, FrameReader, Request, crc16, decode_frame, encode_frame, encode_request

payloads = st.binary(min_size=1, max_size=64)


def test_crc_is_the_published_one():
    assert crc16(b"123456789") == 0x29B1


@given(payloads)
def test_frames_round_trip_and_hold_no_zero(payload):
    frame = encode_frame(payload)
    assert frame.endswith(b"\0") and b"\0" not in frame[:-1]
    assert decode_frame(frame[:-1]) == payload


@given(st.lists(payloads, max_size=5), st.lists(st.integers(1, 9), min_size=1))
def test_split_frames_arrive_whole(sent, cuts):
    data, reader, got, i = b"".join(map(encode_frame, sent)), FrameReader(), [], 0
    while i < len(data):
        step = cuts[i % len(cuts)]
        got += reader.push(data[i : i + step])
        i += step
    assert got == sent and reader.bad_frames == 0


@settings(max_examples=200)
@given(st.binary(max_size=400), payloads)
def test_a_good_frame_after_any_noise_is_read(noise, payload):
    reader = FrameReader()
    reader.push(noise + b"\0")
    assert reader.push(encode_frame(payload)) == [payload]
    assert len(reader._buffer) <= FRAME_MAX


@given(payloads, st.data())
def test_a_dropped_or_changed_byte_never_gives_another_payload(payload, data):
    frame = bytearray(encode_frame(payload))
    at = data.draw(st.integers(0, len(frame) - 2))
    damaged = frame[:at] + frame[at + 1 :] if data.draw(st.booleans()) else frame
    if len(damaged) == len(frame):
        damaged[at] ^= 1 << data.draw(st.integers(0, 7))
    assert all(p == payload for p in FrameReader().push(bytes(damaged)))


def test_requests_start_by_clearing_the_line():
    assert encode_request(Request.STATUS, 300)[0] == 0
    assert FrameReader().push(b"noise" + encode_request(Request.STATUS, 300)) == [bytes([1, 44, 2])]
