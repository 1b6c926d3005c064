"""Whether a host has time to spare for pages."""

import os

import pytest

from agents.operator.spare import CALM_S, STAT, Processors, Spare, processors


class Host:
    """Two processors, of whose time so large a share is idle from now on."""

    def __init__(self):
        self.idle, self._now_s, self._spent = 0.9, 0.0, Processors(0, 0)
        self.spare = Spare(lambda: self._spent)

    def after(self, seconds):
        """Whether it is full after so many looks, one a second."""
        for _ in range(round(seconds)):
            self._now_s += 1.0
            self._spent = Processors(self._spent.idle + round(200 * self.idle), self._spent.total + 200)
            self.spare.look(self._now_s)
        return self.spare.full


@pytest.fixture
def host():
    return Host()


def test_a_host_is_full_as_soon_as_a_second_of_it_was_used_up_and_has_room_once_it_was_calm_for_a_while(host):
    assert not host.after(3)
    host.idle = 0.05
    assert host.after(1)
    host.idle = 0.5
    assert host.after(CALM_S - 1)
    assert not host.after(2)


def test_what_stepping_back_itself_sets_free_is_not_yet_room_and_the_calm_must_last(host):
    host.idle = 0.05
    assert host.after(1)
    host.idle = 0.2
    assert host.after(10 * CALM_S)
    for _ in range(5):
        host.idle = 0.6
        assert host.after(CALM_S / 2)
        host.idle = 0.25
        assert host.after(1)


@pytest.mark.skipif(not STAT.exists(), reason="this system has no /proc/stat")
def test_this_host_tells_of_its_processors():
    told = processors()
    assert told is not None
    ticks = os.sysconf("SC_CLK_TCK")
    uptime_s = float(STAT.with_name("uptime").read_text().split()[0])
    assert 0 <= told.idle <= told.total
    # all processors together, some of which may have been there for a part of the time only
    assert told.total <= 1.1 * ticks * uptime_s * (os.cpu_count() or 1)


def test_where_the_system_tells_nothing_or_damaged_figures_no_host_is_full(tmp_path, monkeypatch):
    monkeypatch.setattr("agents.operator.spare.STAT", tmp_path / "stat")
    assert processors() is None
    (tmp_path / "stat").write_text("cpu 1 2 x\n")
    assert processors() is None
    spare = Spare()
    spare.look(1.0)
    assert not spare.full
