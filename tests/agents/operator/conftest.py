"""A rig whose waits are long; what its agents show is made by hand (by_hand.py)."""

import datetime

import pytest

from agents.deployment.certificates import issue
from agents.deployment.layout import Host, Layout, Process
from agents.operator.page_server import server_tls
from shared.runtime.commands import new_header
from tests.agents.operator.by_hand import HERE, PATIENT_S


@pytest.fixture
def patient(settings, monkeypatch):
    """A test machine may stall."""
    monkeypatch.setattr("agents.operator.choosing.AGAIN_FOR_S", PATIENT_S)
    monkeypatch.setattr("agents.operator.arming.PLAN_ARRIVES_S", PATIENT_S)
    monkeypatch.setattr("agents.operator.arming.new_header", lambda sender: new_header(sender, PATIENT_S))
    monkeypatch.setattr("shared.runtime.commands.FARTHEST_DEADLINE_S", 2 * PATIENT_S)
    return settings


@pytest.fixture
def tls(tmp_path):
    """The operator's certificate for this machine, and where it and its authority lie."""
    host = Host("desk", HERE, (Process("operator", "desk"),))
    issue(Layout("test", "", (host,), leaf_days=30, authority_days=365), tmp_path, datetime.datetime.now(datetime.UTC))  # noqa: TID251
    home = tmp_path / "desk" / "certificates"
    return server_tls(str(home / "operator.desk.pem"), str(home / "operator.desk.key")), home
