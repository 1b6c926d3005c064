"""Installing a host's part of the plan on that host."""

import datetime
import shutil
import socket
from pathlib import Path, PurePosixPath

import pytest

from agents.cli.lab.deploy import layout_of
from agents.configuration.rig import RigConfig
from agents.deployment import install as installing
from agents.deployment.certificates import issue
from agents.deployment.install import affected
from agents.deployment.layout import ROUTER, Host, Layout, Process
from shared.clock import now_ns
from shared.runtime.config import load_config
from tests.agents.deployment.conftest import LAB, deploy, made

CERTIFICATES = PurePosixPath("/etc/suturegrasp/certificates")


@pytest.fixture(scope="module")
def deployed(tmp_path_factory):
    return made(LAB, tmp_path_factory.mktemp("deployed"))


@pytest.fixture
def desk(deployed, tmp_path):
    """A copy of one host's part, to be spoilt."""
    return shutil.copytree(deployed / "desk", tmp_path / "desk")


@pytest.fixture
def refused(tmp_path, capfd):
    """Why a part is not installed, in one line."""

    def install(folder):
        assert deploy("install", "--folder", folder, "--root", tmp_path / "root") == 2
        (complaint,) = capfd.readouterr().err.splitlines()
        assert not (tmp_path / "root").exists()
        return complaint

    return install


def test_installing_puts_all_in_its_place_and_does_nothing_twice(deployed, tmp_path, capfd):
    for expected in ("installed /etc/suturegrasp/rig.toml", "nothing has changed"):
        assert deploy("install", "--folder", deployed / "desk", "--root", tmp_path) == 0
        assert expected in capfd.readouterr().out
    etc = tmp_path / "etc"
    assert load_config(etc / "suturegrasp" / "rig.toml", RigConfig).host == "desk"
    certificates = etc / "suturegrasp" / "certificates"
    places = (certificates, certificates / "viewer.desk.key", certificates / "operator.desk.key")
    assert [path.stat().st_mode & 0o777 for path in places] == [0o755, 0o600, 0o640]
    units = {path.name for path in (etc / "systemd" / "system").iterdir()}
    assert units == {"suturegrasp-viewer.service", "suturegrasp.target"}


@pytest.mark.parametrize(
    ("key", "group", "mode"),
    [
        ("operator.desk.key", "suturegrasp-operators", 0o640),
        ("robot_zenoh.robot.key", "suturegrasp-robot", 0o640),
        ("planner.main.key", "", 0o600),
    ],
)
def test_a_key_that_people_read_belongs_to_their_group_and_a_services_own_to_none(
    monkeypatch, tmp_path, key, group, mode
):
    given = []
    monkeypatch.setattr(installing.shutil, "chown", lambda path, _user, of: given.append((Path(path).name, of)))
    source, target = tmp_path / "made", tmp_path / key
    source.write_text("a key")
    installing._put(source, target, installing._mode(PurePosixPath(target)), real=True)
    assert given == ([(f".{key}.new", group)] if group else [])
    assert target.stat().st_mode & 0o777 == mode


def test_nobody_but_root_installs_on_a_machine_and_nothing_is_touched_before(deployed, monkeypatch):
    touched = []
    monkeypatch.setattr(installing.os, "geteuid", lambda: 1000)
    for name in ("_make_users", "_put", "_remove_stale", "_tell_systemd"):
        monkeypatch.setattr(installing, name, lambda *_: touched.append(1))
    host = next(h for h in layout_of(load_config(LAB, RigConfig)).hosts if h.name == "desk")
    with pytest.raises(installing.InstallError, match="only root may install"):
        installing.install(deployed / "desk", host)
    assert not touched


@pytest.mark.slow
def test_a_host_keeps_no_key_and_no_unit_of_what_runs_elsewhere_now(tmp_path, capfd):
    """A newer plan may have been copied over an older one."""
    text, root = LAB.read_text(), tmp_path / "root"
    moved = text.replace(', "planner"]', "]").replace('"robot_bridge psm1"]', '"robot_bridge psm1", "planner"]')
    for plan, folder in ((text, tmp_path / "before"), (moved, tmp_path / "now")):
        host = shutil.copytree(made(plan, folder) / "strong", tmp_path / "strong", dirs_exist_ok=True)
        assert deploy("install", "--folder", host, "--root", root) == 0
    said = capfd.readouterr().out
    for name in ("suturegrasp-planner.service", "planner.main.key", "planner.main.pem"):
        assert f"removed {name}" in said
    left = {path.name for path in (root / "etc").rglob("*") if path.is_file()}
    assert not [name for name in left if "planner" in name]
    assert {"suturegrasp-perception.service", "perception.main.key", "authority.pem"} <= left


def test_what_is_installed_is_this_hosts_own_part(desk, deployed, refused, capfd):
    assert deploy("install", "--folder", deployed / "desk") == 2
    assert "the part of host desk (10.0.0.14), and this machine has neither that address" in capfd.readouterr().err
    rig = (desk / "rig.toml").read_text()
    # this machine is robot, by its name
    (desk / "rig.toml").write_text(rig.replace('"10.0.0.13"', f'"{socket.gethostname()}"'))
    assert "is the part of host desk, and this machine is robot; install robot's here" in refused(desk)
    (desk / "rig.toml").write_text(rig.split("\n", 1)[1])
    assert "is no host's part of a rig" in refused(desk)


VIEWER_UNIT = "systemd/suturegrasp-viewer.service"


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda desk: shutil.rmtree(desk / "certificates"), "holds no certificates; suturegrasp deploy certificates"),
        (lambda desk: (desk / "rig.toml").unlink(), "has no rig.toml"),
        (lambda desk: (desk / "certificates" / "viewer.desk.pem").unlink(), "viewer.desk.pem: No such file"),
        (lambda desk: (desk / VIEWER_UNIT).unlink(), "viewer.service is missing; take the"),
        pytest.param(
            lambda desk: (desk / VIEWER_UNIT).write_text("[Service]\nType=notfy\n"),
            "systemd would not take the units",
            marks=pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here"),
        ),
    ],
)
def test_what_is_not_complete_or_would_not_be_taken_is_not_installed(desk, refused, spoil, said):
    spoil(desk)
    assert said in refused(desk)


@pytest.mark.parametrize(
    ("days", "said"),
    [
        (-31, "operator.desk.pem has expired; renew it"),
        (1, "operator.desk.pem is not valid yet; set this machine's clock"),
    ],
)
def test_certificates_that_do_not_hold_now_are_not_installed(desk, refused, days, said):
    shutil.rmtree(desk / "certificates")
    host = Host("desk", "10.0.0.14", (Process("viewer", "desk"), Process("operator", "desk")))
    at = datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC) + datetime.timedelta(days)
    issue(Layout("lab", "tls/10.0.0.11:7447", (host,), 30, 3650), desk.parent, at)
    assert said in refused(desk)


@pytest.mark.parametrize(
    ("changed", "units"),
    [
        ([CERTIFICATES / "camera.main.pem", CERTIFICATES / "camera.main.key"], {"camera"}),
        ([PurePosixPath("/etc/systemd/system/suturegrasp-recorder.service")], {"recorder"}),
        ([CERTIFICATES / "operator.video.key"], set()),
        ([], set()),
        ([PurePosixPath("/etc/suturegrasp/rig.toml")], {"router", "camera", "recorder"}),
        ([CERTIFICATES / "authority.pem", CERTIFICATES / "camera.main.key"], {"router", "camera", "recorder"}),
    ],
)
def test_what_reads_a_file_that_changed_is_started_again_and_nothing_else(changed, units):
    processes = (Process(ROUTER), Process("camera"), Process("recorder", "video"), Process("operator", "video"))
    expected = sorted(f"suturegrasp-{unit}.service" for unit in units)
    assert affected(changed, Host("video", "10.0.0.1", processes)) == expected
