import numpy as np
import rerun as rr

from agents.viewer.thread_mapping import ALONG, bars_along


def test_bars_are_what_rerun_makes_of_the_same_numbers():
    heights = np.random.default_rng(1).random(len(ALONG))
    widths = np.full(len(ALONG), 1 / len(ALONG))
    assert bars_along(heights, (1, 2, 3)) == rr.BarChart(heights, abscissa=ALONG, color=(1, 2, 3), widths=widths)
