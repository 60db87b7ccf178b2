"""Stars that share a pixel."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.physics.drawing.crowds import crowd_light

PLACES = arrays(float, 12, elements=st.floats(-3.0, 3.0))
LIGHT = arrays(float, 12, elements=st.sampled_from([0.0, -2.0, 1.0, 4.0, 1e6]))


@given(x=PLACES, y=PLACES, light=LIGHT, limit=st.floats(0.1, 2e6))
def test_those_within_a_limit_keep_to_it_together(x, y, light, limit):
    found = crowd_light(x, y, light)
    size, pixel = np.abs(light), list(zip(np.floor(x), np.floor(y), strict=True))
    for i in range(12):
        mine = np.array([p == pixel[i] for p in pixel])
        assert size[mine & (found <= limit)].sum() <= limit
        low, high = size[mine & (size < size[i])].sum(), size[mine & (size <= size[i])].sum()
        assert low + size[i] <= found[i] <= high


def test_stars_alone_count_their_own_light():
    x = np.array([0.5, 1.5, -0.5, 0.5])
    y = np.array([0.5, 0.5, 0.5, 7.5])
    light = np.array([3.0, 1.0, 2.0, 5.0])
    np.testing.assert_array_equal(crowd_light(x, y, light), light)
    assert len(crowd_light(x[:0], y[:0], light[:0])) == 0
