# SPDX-License-Identifier: Apache-2.0
"""What is said of points that are left out is the same whenever they are looked at."""

from collections import Counter

import numpy as np
import pytest

from otf_core.bags.sample_order import Screening
from otf_core.errors import InputError

STAMPS = np.arange(1, 9, dtype=np.int64) * 10_000_000
POINTS = np.ones((8, 3))
POINTS[5] = np.nan


def test_first_bad_sample_has_its_number_in_the_stream_wherever_foreign_points_came():
    said = set()
    for at in (0, 4, 8):  # live they come in between, a bag counts them before
        screening = Screening()
        screening.good(STAMPS[:at], POINTS[:at])
        screening.foreign(Counter(lab=3))
        screening.good(STAMPS[at:], POINTS[at:])
        said.add(screening.remarks()[0])
    (text,) = said
    assert 'dropped 1 of 11 points' in text and 'the first is sample 5, 0.050000 s' in text


def test_long_frame_id_is_not_repeated_whole():
    screening = Screening()
    screening.foreign(Counter({'x' * 100_000: 3}))
    assert "'" + 'x' * 60 + " ...'" in screening.remarks()[0]
    with pytest.raises(InputError) as caught:
        screening.check('bag')
    assert max(map(len, [*screening.remarks(), str(caught.value)])) < 400
