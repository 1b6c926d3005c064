"""What is begun in a thread of its own is done meanwhile, and comes out as if it had been called."""

import threading

import pytest

from shared.aside import begun


def test_it_is_done_while_whoever_began_it_goes_on():
    mine, its = threading.Event(), threading.Event()

    def work(number, more):
        its.set()
        return number + more if mine.wait(10.0) else 0

    work_begun = begun(work, 3, more=4)
    assert its.wait(10.0)
    mine.set()
    assert work_begun.result(10.0) == 7


def test_what_it_raises_comes_to_whoever_asks():
    with pytest.raises(ZeroDivisionError):
        begun(divmod, 1, 0).result(10.0)
