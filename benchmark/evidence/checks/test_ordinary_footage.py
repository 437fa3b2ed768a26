"""The rotation tag that evidence writes into its phones' videos is the one that players turn by."""

import pytest

from gof.core.errors import DataFormatError
from gof.footage.videos import read_info
from gof_benchmark.evidence.ordinary_footage import tagged_clockwise
from tests.videos import numbered, write_video


def test_the_evidence_scripts_phones_have_the_tag(tmp_path):
    video = write_video(tmp_path / "phone.mp4", numbered(30), 30.0)
    video.write_bytes(tagged_clockwise(video.read_bytes()))
    assert read_info(video).rotation_deg == 90
    with pytest.raises(DataFormatError, match="lies as it is stored"):
        tagged_clockwise(video.read_bytes())
