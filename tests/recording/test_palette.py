import numpy as np

from carom.recording.schema import palette


def test_a_body_that_touches_nobody_is_grey() -> None:
    assert palette.node_colours(np.array([-1, 0, 1])).tolist() == [palette.GREY, palette.SKY, palette.ORANGE]


def test_a_few_bodies_have_a_hue_each_and_many_share_that_of_their_group() -> None:
    few = palette.body_colours(np.zeros(5, dtype=np.int64))
    assert len(set(few.tolist())) == 5
    many = palette.body_colours(np.repeat([0, 1], 50))
    blue, red = (many >> np.uint32(8)) & 0xFF, many >> np.uint32(24)
    assert np.all(blue[:50] > red[:50])
    assert np.all(blue[50:] < red[50:])
