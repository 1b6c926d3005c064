"""The work of both eyes at once: each eye's own result, and an error of either is an error."""

import threading

import pytest

from shared.both_eyes import of_both


def test_each_eye_has_its_own_result_and_both_are_worked_on_at_once():
    meeting = threading.Barrier(2, timeout=10)

    def work(value):
        meeting.wait()
        return 2 * value

    assert of_both(work, (1,), (2,)) == (2, 4)


@pytest.mark.parametrize("eyes", [(0, 1), (1, 0)])
def test_an_error_of_one_eye_is_raised(eyes):
    with pytest.raises(ZeroDivisionError):
        of_both(lambda value: 1 // value, *((eye,) for eye in eyes))
