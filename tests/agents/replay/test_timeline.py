import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.replay.controls import Controls
from agents.replay.spacing import spacing_errors_ms, spacing_of
from agents.replay.timeline import Timeline

SECOND = 10**9
rates = st.sampled_from((0.1, 0.5, 1.0, 2.0, 10.0))


@given(rates, st.integers(0, 100), st.floats(0, 1000))
def test_a_moment_is_due_when_the_timeline_has_come_to_it(rate, seconds, begin_s):
    timeline = Timeline(rate)
    timeline.jump(5 * SECOND, begin_s)
    timeline.go_on(begin_s)
    due_s = timeline.due_s((5 + seconds) * SECOND)
    assert due_s == pytest.approx(begin_s + seconds / rate)
    assert timeline.now(due_s)[0] == pytest.approx((5 + seconds) * SECOND, abs=10_000)


def test_no_time_passes_while_it_is_held_and_none_is_made_up_for():
    timeline = Timeline(2.0)
    timeline.jump(0, 10.0)
    assert timeline.now(11.0) == (0, 0.0)
    assert timeline.go_on(12.0)
    assert not timeline.go_on(12.5)
    assert timeline.now(13.0) == (2 * SECOND, 2.0)
    assert timeline.hold(13.0)
    assert timeline.now(20.0) == (2 * SECOND, 0.0)
    timeline.go_on(20.0)
    assert timeline.due_s(4 * SECOND) == 21.0


def test_a_step_goes_on_until_one_frame_is_sent_and_space_until_it_is_held_again():
    controls = Controls(held=True)
    controls.step()
    controls.step()
    assert not controls.held
    controls.step_done()
    assert not controls.held
    controls.step_done()
    assert controls.held
    controls.toggle()
    assert not controls.held
    controls.step_done()
    assert not controls.held
    controls.toggle()
    assert controls.held
    # who leaves after his steps has them done first
    controls.step()
    controls.stop_when_done()
    assert not controls.stopped
    controls.step_done()
    assert controls.stopped


def test_spacing_errors_are_those_of_neighbours_of_one_run():
    recorded_ns = np.array([0, 10, 20, 0, 100], dtype=np.int64) * 10**6
    sent_s = np.array([1.0, 1.021, 1.039, 5.0, 5.2])
    run = np.array([0, 0, 0, 1, 1])
    errors = spacing_errors_ms(sent_s, recorded_ns, run, 0.5)
    np.testing.assert_allclose(errors, [1.0, 2.0, 0.0], atol=1e-9)
    spacing = spacing_of(errors)
    assert spacing is not None
    assert (spacing.pairs, round(spacing.worst_ms, 6)) == (3, 2.0)
    assert spacing_of(np.empty(0)) is None
