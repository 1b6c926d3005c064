"""From one file to each host's configuration, certificates, units and containers, as a person would do it."""

import dataclasses
import datetime
import json
import shutil
import socket
import subprocess
from pathlib import Path, PurePosixPath

import pytest
from cryptography import x509

from agents.cli.lab.deploy import layout_of
from agents.cli.main import main
from agents.configuration.rig import RigConfig
from agents.deployment import install as installing
from agents.deployment.certificates import AuthorityError, issue
from agents.deployment.containers import IMAGE_USER
from agents.deployment.install import affected, verify
from agents.deployment.layout import ROUTER, Host, Layout, Process
from agents.deployment.plan import plan
from agents.diagnostics.status.judgement import EXPIRES_SOON_S
from shared.clock import now_ns
from shared.runtime.access import access_control
from shared.runtime.config import load_config

REPOSITORY = Path(__file__).parents[3]
LAB = REPOSITORY / "deploy" / "lab.toml"
IMAGES = 'source = "images"\nleft = "l"\ncalibration = "{}"'
NOW = datetime.datetime(2026, 11, 22, 12, tzinfo=datetime.UTC)
HOSTS = ("video", "strong", "robot", "desk")
needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze here, which checks the units"
)
LAYOUT = Layout(
    rig="lab",
    endpoint="tls/10.0.0.1:7447",
    hosts=(
        Host("video", "10.0.0.1", (Process(ROUTER), Process("camera"), Process("recorder", "video"))),
        Host("robot", "robot.lab", (Process("robot_bridge", "psm1"),), realtime=True),
        Host("desk", "10.0.0.3", (Process("operator", "desk"),)),
    ),
    leaf_days=30,
    authority_days=3650,
)


def suturegrasp(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code


@pytest.fixture(scope="module")
def deployed(tmp_path_factory):
    """Everything that deploy plan and deploy certificates make of the example of a lab."""
    folder = tmp_path_factory.mktemp("deployed")
    for action in ("plan", "certificates"):
        assert suturegrasp("deploy", action, "--config", LAB, "--folder", folder) == 0
    return folder


def test_every_host_gets_what_it_runs_and_nothing_else(deployed):
    certificates = {host: sorted(p.name for p in (deployed / host / "certificates").glob("*.key")) for host in HOSTS}
    assert certificates == {
        "video": ["camera.main.key", "recorder.video.key", "router.main.key", "simulator.main.key"],
        "strong": ["perception.main.key", "planner.main.key", "reconstruction.main.key"],
        "robot": ["robot_bridge.psm1.key"],
        "desk": ["operator.desk.key", "viewer.desk.key"],
    }
    assert {host for host in HOSTS if (deployed / host / "router.json5").exists()} == {"video"}
    for host in HOSTS:
        assert load_config(deployed / host / "rig.toml", RigConfig).host == host
        assert all(p.stat().st_mode & 0o077 == 0 for p in (deployed / host / "certificates").glob("*.key"))


@pytest.mark.slow
@needs_systemd
def test_systemd_takes_the_units_and_finds_them_well_confined(deployed, deployed_far):
    for folder in (*(deployed / host for host in HOSTS), deployed_far / "robot"):
        assert verify((folder / "systemd").iterdir()) == []
    for unit in (*deployed.glob("*/systemd/*.service"), *deployed_far.glob("robot/systemd/*.service")):
        rated = subprocess.run(
            ["systemd-analyze", "security", "--offline=yes", "--threshold=35", str(unit)],  # noqa: S607
            capture_output=True,
            text=True,
            check=False,
        )
        assert rated.returncode == 0, (unit.name, rated.stdout.splitlines()[-1:], rated.stderr)


ARM = """[robot.psm1]
backend = "dvrk"
T_camera_base = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
[robot.psm1.dvrk]
endpoint = "tls/10.0.0.13:7448"
through_guard = true
dry_run = false
"""


@pytest.fixture(scope="module")
def deployed_far(tmp_path_factory):
    """The same, with an arm whose bridge is not on its computer, but its guard is."""
    folder = tmp_path_factory.mktemp("far")
    text = LAB.read_text().replace('[robot.psm1]\nbackend = "simulated"\n', ARM)
    text = text.replace('"robot_bridge psm1"', '"guard psm1"').replace('"planner"]', '"planner", "robot_bridge psm1"]')
    (folder / "rig.toml").write_text(text)
    for action in ("plan", "certificates"):
        assert suturegrasp("deploy", action, "--config", folder / "rig.toml", "--folder", folder) == 0
    return folder


def test_the_robots_computer_gets_its_guard_and_what_its_zenoh_is_told(deployed_far):
    robot = deployed_far / "robot"
    assert sorted(p.name for p in (robot / "systemd").iterdir()) == [
        "suturegrasp-guard-psm1.service",
        "suturegrasp.target",
    ]
    unit = (robot / "systemd" / "suturegrasp-guard-psm1.service").read_text()
    assert "guard --arm psm1 --config" in unit
    assert "WatchdogSec=10" in unit
    assert sorted(p.name for p in (robot / "certificates").glob("*.key")) == ["guard.psm1.key", "robot_zenoh.robot.key"]
    assert "guard-psm1:" in (robot / "compose.yaml").read_text()
    server = x509.load_pem_x509_certificate((robot / "certificates" / "robot_zenoh.robot.pem").read_bytes())
    names = server.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert [str(name.value) for name in names] == ["10.0.0.13"]
    told = json.loads((robot / "robot-zenoh.json5").read_text().split("\n", 1)[1])
    assert told["listen"]["endpoints"] == ["tls/10.0.0.13:7448"]
    assert told["transport"]["link"]["tls"]["enable_mtls"] is True
    assert told["transport"]["link"]["tls"]["close_link_on_expiration"] is True
    assert {s["id"] for s in told["access_control"]["subjects"]} == {"robot_bridge.psm1", "guard.psm1"}
    assert "/PSM1/jaw/servo_jp" in told["plugins"]["ros2dds"]["allow"]["subscribers"]


def test_a_guard_beside_its_bridge_is_there_first(deployed_far, tmp_path):
    text = (deployed_far / "rig.toml").read_text().replace('"planner", "robot_bridge psm1"]', '"planner"]')
    (tmp_path / "rig.toml").write_text(text.replace('"guard psm1"', '"guard psm1", "robot_bridge psm1"'))
    assert suturegrasp("deploy", "plan", "--config", tmp_path / "rig.toml", "--folder", tmp_path) == 0
    unit = (tmp_path / "robot" / "systemd" / "suturegrasp-guard-psm1.service").read_text()
    assert "Before=suturegrasp-robot-bridge-psm1.service" in unit


def test_the_emulated_rig_of_two_computers_is_planned(tmp_path):
    config = REPOSITORY / "deploy" / "emulated_far.toml"
    assert suturegrasp("deploy", "plan", "--config", config, "--folder", tmp_path) == 0
    assert (tmp_path / "robot" / "robot-zenoh.json5").exists()
    assert (tmp_path / "robot" / "systemd" / "suturegrasp-guard-psm1.service").exists()


def test_compose_takes_the_containers(deployed):
    compose = next((c for c in (["docker", "compose"], ["docker-compose"]) if _works(c)), None)
    if compose is None:
        pytest.skip("there is no docker compose here, which checks its own files")
    for host in HOSTS:
        command = [*compose, "-f", "compose.yaml", "config", "--quiet"]
        told = subprocess.run(command, cwd=deployed / host, capture_output=True, text=True, check=False)
        assert (told.returncode, told.stderr) == (0, "")


def _works(command):
    program: str = command[0]
    return (
        shutil.which(program) is not None
        and subprocess.run([*command, "version"], capture_output=True, check=False).returncode == 0
    )


def test_the_containers_router_is_told_what_ours_is(deployed):
    text = (deployed / "video" / "router.json5").read_text()
    told = json.loads(text.split("\n", 1)[1])
    names = load_config(LAB, RigConfig).common_names()
    assert told["access_control"] == access_control("lab", names)
    assert told["listen"]["endpoints"] == ["tls/10.0.0.11:7447"]
    assert told["transport"]["link"]["tls"]["enable_mtls"] is True
    assert told["transport"]["link"]["tx"]["lease"] == 2000


def test_the_image_is_built_from_files_that_are_there_and_its_user_owns_the_certificates():
    image = (REPOSITORY / "deploy" / "Dockerfile").read_text()
    copying = [line for line in image.splitlines() if line.startswith("COPY ")]
    copied = [name for line in copying for name in line.split()[1:-1] if name[0] != "-"]
    assert copied
    assert all((REPOSITORY / name).exists() for name in copied)
    assert f"useradd --uid {IMAGE_USER} --gid {IMAGE_USER} " in image
    page = (REPOSITORY / "docs" / "deployment.md").read_text()
    assert f"chown --recursive {IMAGE_USER} video/certificates" in page


def test_installing_puts_all_in_its_place_and_does_nothing_twice(deployed, tmp_path, capfd):
    for expected in ("installed /etc/suturegrasp/rig.toml", "nothing has changed"):
        assert suturegrasp("deploy", "install", "--folder", deployed / "desk", "--root", tmp_path) == 0
        assert expected in capfd.readouterr().out
    etc = tmp_path / "etc"
    assert load_config(etc / "suturegrasp" / "rig.toml", RigConfig).host == "desk"
    assert (etc / "suturegrasp/certificates/viewer.desk.key").stat().st_mode & 0o777 == 0o600
    assert (etc / "suturegrasp/certificates/operator.desk.key").stat().st_mode & 0o777 == 0o640
    assert (etc / "suturegrasp/certificates").stat().st_mode & 0o777 == 0o755
    assert sorted(p.name for p in (etc / "systemd" / "system").iterdir()) == [
        "suturegrasp-viewer.service", "suturegrasp.target",
    ]  # fmt: skip


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
    made, target = tmp_path / "made", tmp_path / key
    made.write_text("a key")
    installing._put(made, target, installing._mode(PurePosixPath(target)), real=True)
    assert given == ([(f".{key}.new", group)] if group else [])
    assert target.stat().st_mode & 0o777 == mode


def test_nobody_but_root_installs_on_a_machine_and_nothing_is_touched_before(deployed, monkeypatch):
    def touched(*_):
        raise AssertionError("this would have changed the machine")

    monkeypatch.setattr(installing.os, "geteuid", lambda: 1000)
    for name in ("_make_users", "_put", "_remove_stale", "_tell_systemd"):
        monkeypatch.setattr(installing, name, touched)
    host = next(h for h in layout_of(load_config(LAB, RigConfig)).hosts if h.name == "desk")
    with pytest.raises(installing.InstallError, match="only root may install"):
        installing.install(deployed / "desk", host)


@pytest.mark.slow
def test_a_host_keeps_no_key_and_no_unit_of_what_runs_elsewhere_now(tmp_path, capfd):
    """A newer plan may have been copied over an older one."""
    etc, before, now = tmp_path / "root/etc", tmp_path / "before", tmp_path / "now"
    config = tmp_path / "rig.toml"
    moved = (
        LAB.read_text().replace(', "planner"]', "]").replace('"robot_bridge psm1"]', '"robot_bridge psm1", "planner"]')
    )
    for text, folder in ((LAB.read_text(), before), (moved, now)):
        config.write_text(text)
        for action in ("plan", "certificates"):
            assert suturegrasp("deploy", action, "--config", config, "--folder", folder) == 0
        host = shutil.copytree(folder / "strong", tmp_path / "strong", dirs_exist_ok=True)
        assert suturegrasp("deploy", "install", "--folder", host, "--root", tmp_path / "root") == 0
    said = capfd.readouterr().out
    for name in ("suturegrasp-planner.service", "planner.main.key", "planner.main.pem"):
        assert f"removed {name}" in said
    left = {path.name for path in etc.rglob("*") if path.is_file()}
    assert not [name for name in left if "planner" in name]
    assert {"suturegrasp-perception.service", "perception.main.key", "authority.pem"} <= left


def test_what_is_installed_is_this_hosts_own_part(deployed, tmp_path, capfd):
    host = shutil.copytree(deployed / "desk", tmp_path / "desk")
    rig = (host / "rig.toml").read_text()
    # this machine is robot, by its name
    (host / "rig.toml").write_text(rig.replace('"10.0.0.13"', f'"{socket.gethostname()}"'))
    assert suturegrasp("deploy", "install", "--folder", host, "--root", tmp_path / "root") == 2
    (host / "rig.toml").write_text(rig.split("\n", 1)[1])
    assert suturegrasp("deploy", "install", "--folder", host, "--root", tmp_path / "root") == 2
    another, nobodys = capfd.readouterr().err.splitlines()
    assert "is the part of host desk, and this machine is robot; install robot's here" in another
    assert "is no host's part of a rig" in nobodys
    assert not (tmp_path / "root").exists()


CERTIFICATES = PurePosixPath("/etc/suturegrasp/certificates")


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
    processes = (*LAYOUT.hosts[0].processes, Process("operator", "video"))
    expected = sorted(f"suturegrasp-{unit}.service" for unit in units)
    assert affected(changed, Host("video", "10.0.0.1", processes)) == expected


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda host: shutil.rmtree(host / "certificates"), "holds no certificates; suturegrasp deploy certificates"),
        (lambda host: (host / "rig.toml").unlink(), "has no rig.toml"),
        (lambda host: (host / "certificates" / "viewer.desk.pem").unlink(), "viewer.desk.pem: No such file"),
        (
            lambda host: (host / "systemd" / "suturegrasp-viewer.service").unlink(),
            "viewer.service is missing; take the",
        ),
    ],
)
def test_what_is_not_complete_is_not_installed(deployed, tmp_path, capfd, spoil, said):
    host = shutil.copytree(deployed / "desk", tmp_path / "desk")
    spoil(host)
    assert suturegrasp("deploy", "install", "--folder", host, "--root", tmp_path / "root") == 2
    (complaint,) = capfd.readouterr().err.splitlines()
    assert said in complaint
    assert not (tmp_path / "root").exists()


@pytest.mark.parametrize(
    ("days", "said"),
    [
        (-31, "operator.desk.pem has expired; renew it"),
        (1, "operator.desk.pem is not valid yet; set this machine's clock"),
    ],
)
def test_certificates_that_do_not_hold_now_are_not_installed(deployed, tmp_path, capfd, days, said):
    host = shutil.copytree(deployed / "desk", tmp_path / "desk")
    shutil.rmtree(host / "certificates")
    processes = (Process("viewer", "desk"), Process("operator", "desk"))
    layout = Layout("lab", LAYOUT.endpoint, (Host("desk", "10.0.0.14", processes),), 30, 3650)
    issue(layout, tmp_path, datetime.datetime.fromtimestamp(now_ns() * 1e-9, datetime.UTC) + datetime.timedelta(days))
    assert suturegrasp("deploy", "install", "--folder", host, "--root", tmp_path / "root") == 2
    (complaint,) = capfd.readouterr().err.splitlines()
    assert said in complaint
    assert not (tmp_path / "root").exists()


@needs_systemd
def test_units_that_systemd_would_not_take_are_not_installed(deployed, tmp_path, capfd):
    host = shutil.copytree(deployed / "desk", tmp_path / "desk")
    unit = host / "systemd" / "suturegrasp-viewer.service"
    unit.write_text(unit.read_text().replace("Type=notify", "Type=notfy"))
    assert suturegrasp("deploy", "install", "--folder", host, "--root", tmp_path / "root") == 2
    (complaint,) = capfd.readouterr().err.splitlines()
    assert "systemd would not take the units" in complaint
    assert not (tmp_path / "root").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[camera]", "has no [hosts]"),
        (LAB.read_text() + '[topics."camera/frame"]\nrecorded = false', "there is no topic 'camera/frame'"),
        (LAB.read_text().replace('"planner"]', '"planner", "camera"]'), "would have two owners"),
        (LAB.read_text().replace(', "planner"]', "]"), "no host runs 'planner'"),
        ('host = "video"\n' + LAB.read_text(), "the copy for host video"),
        (
            LAB.read_text().replace('source = "scene"', 'source = "images"\nleft = "l"\ncalibration = "c.yaml"'),
            "c.yaml",
        ),
    ],
)
def test_a_rig_that_cannot_be_planned_is_one_sentence(tmp_path, capfd, text, said):
    config = tmp_path / "rig.toml"
    config.write_text(text)
    assert suturegrasp("deploy", "plan", "--config", config, "--folder", tmp_path / "out") == 2
    (complaint,) = capfd.readouterr().err.splitlines()
    assert said in complaint
    assert not (tmp_path / "out").exists()


def test_a_rig_that_nobody_can_command_is_planned_and_told(tmp_path, capfd):
    (tmp_path / "rig.toml").write_text(LAB.read_text().replace('"operator", ', ""))
    assert suturegrasp("deploy", "plan", "--config", tmp_path / "rig.toml", "--folder", tmp_path / "out") == 0
    assert 'no host runs "operator", so nobody may give commands' in capfd.readouterr().out


def test_a_calibration_goes_to_the_cameras_host(tmp_path):
    text = LAB.read_text().replace('source = "scene"', IMAGES.format("own/c.yaml"))
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "c.yaml").write_text("what it says is read on that host")
    (tmp_path / "rig.toml").write_text(text)
    assert suturegrasp("deploy", "plan", "--config", tmp_path / "rig.toml", "--folder", tmp_path / "out") == 0
    found = [path.relative_to(tmp_path / "out") for path in (tmp_path / "out").rglob("c.yaml")]
    assert found == [Path("video/own/c.yaml")]
    assert "./own/c.yaml:/etc/suturegrasp/own/c.yaml:ro" in (tmp_path / "out/video/compose.yaml").read_text()


def expiries(folder):
    read = {p.name: x509.load_pem_x509_certificate(p.read_bytes()) for p in folder.rglob("*.pem")}
    return {name: certificate.not_valid_after_utc - NOW for name, certificate in read.items()}


def test_certificates_are_short_lived_and_made_anew_in_time(tmp_path):
    assert {made.reason for made in issue(LAYOUT, tmp_path, NOW)} == {"it was missing"}
    days = {name: left.days for name, left in expiries(tmp_path).items()}
    assert days == {n: 3650 if n == "authority.pem" else 30 for n in days}
    assert {made.reason for made in issue(LAYOUT, tmp_path, NOW + datetime.timedelta(days=19))} == {""}
    later = issue(LAYOUT, tmp_path, NOW + datetime.timedelta(days=21))
    assert {made.reason for made in later} == {"little of its time was left"}
    assert {made.reason for made in issue(LAYOUT, tmp_path, NOW + datetime.timedelta(days=90))} == {"it had expired"}
    assert {made.reason for made in issue(LAYOUT, tmp_path, NOW, all_anew=True)} == {"all are made anew"}
    shutil.rmtree(tmp_path / "authority")
    assert {made.reason for made in issue(LAYOUT, tmp_path, NOW)} == {"it was another authority's"}


def test_what_doctor_asks_to_be_renewed_is_however_short_its_time(tmp_path):
    short = dataclasses.replace(LAYOUT, leaf_days=9)
    issue(short, tmp_path, NOW)
    asked_for = NOW + datetime.timedelta(days=9, seconds=1 - EXPIRES_SOON_S)
    assert {made.reason for made in issue(short, tmp_path, asked_for)} == {"little of its time was left"}


def test_a_certificate_that_does_not_fit_any_more_is_made_anew(tmp_path):
    issue(LAYOUT, tmp_path, NOW)
    video, robot, desk = LAYOUT.hosts
    moved = Layout("lab", "tls/10.0.0.9:7447", (Host("video", "10.0.0.9", video.processes), robot, desk), 30, 3650)
    (tmp_path / "video" / "certificates" / "camera.main.key").write_text("nothing")
    robots, desks = tmp_path / "robot" / "certificates", tmp_path / "desk" / "certificates"
    (robots / "robot_bridge.psm1.key").write_bytes((desks / "operator.desk.key").read_bytes())
    reasons = {made.common_name: made.reason for made in issue(moved, tmp_path, NOW)}
    assert reasons == {
        "router.main": "its host's address has changed",
        "camera.main": "it could not be read",
        "recorder.video": "",
        "robot_bridge.psm1": "its key was another one's",
        "operator.desk": "",
    }
    # what left a host leaves no key there
    less = dataclasses.replace(moved, hosts=(Host("video", "10.0.0.9", video.processes[:1]), robot, desk))
    issue(less, tmp_path, NOW)
    assert [p.name for p in (tmp_path / "video" / "certificates").glob("*.key")] == ["router.main.key"]


def test_an_authority_that_cannot_sign_is_told(tmp_path):
    issue(LAYOUT, tmp_path, NOW)
    with pytest.raises(AuthorityError, match="before a new certificate would"):
        issue(LAYOUT, tmp_path, NOW + datetime.timedelta(days=3640))
    (tmp_path / "authority" / "authority.key").unlink()
    with pytest.raises(AuthorityError, match="put its two files back"):
        issue(LAYOUT, tmp_path, NOW)


def test_the_plan_of_a_host_has_its_realtime_and_its_own_certificate():
    files = plan(LAYOUT, "")
    texts = {path.name: text for path, text in files.items() if path.parts[0] == "robot"}
    unit = texts["suturegrasp-robot-bridge-psm1.service"]
    assert "LimitRTPRIO=50" in unit
    assert "RestrictRealtime" not in unit
    assert unit.count("LoadCredential=") == 3
    camera = next(text for path, text in files.items() if path.name == "suturegrasp-camera.service")
    assert "RestrictRealtime=yes" in camera
    assert "char-video4linux" in camera


def test_a_machine_that_is_none_of_the_hosts_is_told_so_and_nothing_is_written(deployed, capfd):
    assert suturegrasp("deploy", "install", "--folder", deployed / "desk") == 2
    assert "the part of host desk (10.0.0.14), and this machine has neither that address" in capfd.readouterr().err
