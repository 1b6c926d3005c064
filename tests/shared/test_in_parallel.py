"""The work of both eyes at once, in a thread beside: each eye's own result, and an error of either is an error."""

import threading

import pytest

from shared.in_parallel import of_both


def test_each_eye_has_its_own_result_or_error_and_both_are_worked_on_at_once():
    meeting = threading.Barrier(2, timeout=10)

    def work(value):
        meeting.wait()
        return 6 // value

    assert of_both(work, (1,), (2,)) == (6, 3)
    for eyes in ((0, 1), (1, 0)):
        with pytest.raises(ZeroDivisionError):
            of_both(work, *((eye,) for eye in eyes))
