from benchmarks.latency import COUNTS, unaccounted


def counted(lost_after=None):
    """Frames at 30 Hz for 20 s, and what a consumer says of them once a second, up to two frames late."""
    published_ns = [round(i * 1e9 / 30) for i in range(600)]
    told: list[tuple[int, int]] = []
    for second in range(20):
        at_ns = second * 1_000_000_000 + 5_000_000
        come = sum(p <= at_ns for p in published_ns) - second % 3
        told.append((at_ns, 1000 + come - (lost_after is not None and second >= lost_after) * 4))
    return published_ns, told


def test_frames_on_their_way_are_not_lost():
    assert unaccounted(*counted()) == 0


def test_frames_that_nobody_counts_are_told():
    assert unaccounted(*counted(lost_after=20 - COUNTS)) == 4


def test_a_frame_lost_within_a_short_time_is_told():
    published_ns, told = counted(lost_after=17)
    assert unaccounted(published_ns, told[14:20]) == 4


def test_without_a_count_nothing_is_told():
    assert unaccounted([1, 2, 3], []) == 0
