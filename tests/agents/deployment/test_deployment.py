"""From one file to each host's configuration, certificates, units and containers, as a person would do it."""

import json
import shutil
import subprocess
from pathlib import Path, PurePosixPath

import pytest
from cryptography import x509

from agents.configuration.rig import RigConfig
from agents.deployment.containers import IMAGE_USER
from agents.deployment.install import verify
from agents.deployment.leftovers import remove_leftovers
from shared.runtime.access import access_control
from shared.runtime.config import load_config
from tests.agents.deployment.conftest import LAB, REPOSITORY, deploy, made

HOSTS = ("video", "strong", "robot", "desk")
TEXT = LAB.read_text()
FAR = REPOSITORY / "deploy" / "emulated_far.toml"


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    return made(LAB, tmp_path_factory.mktemp("lab"))


@pytest.fixture(scope="module")
def far(tmp_path_factory):
    """A rig with an arm whose bridge is not on its computer, but its guard is."""
    return made(FAR, tmp_path_factory.mktemp("far"))


def files(folder):
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_every_host_gets_what_it_runs_and_nothing_else(lab):
    assert {host: sorted(p.stem for p in (lab / host / "certificates").glob("*.key")) for host in HOSTS} == {
        "video": ["camera.main", "recorder.video", "router.main", "simulator.main"],
        "strong": ["perception.main", "planner.main", "reconstruction.main"],
        "robot": ["robot_bridge.psm1"],
        "desk": ["operator.desk", "viewer.desk"],
    }
    assert {host for host in HOSTS if (lab / host / "router.json5").exists()} == {"video"}
    for host in HOSTS:
        assert load_config(lab / host / "rig.toml", RigConfig).host == host


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze here")
def test_systemd_takes_the_units_and_finds_them_well_confined(lab, far):
    folders = (*(lab / host for host in HOSTS), far / "robot")
    for folder in folders:
        assert verify((folder / "systemd").iterdir()) == []
    for unit in [unit for folder in folders for unit in folder.glob("systemd/*.service")]:
        rating = ["systemd-analyze", "security", "--offline=yes", "--threshold=35", str(unit)]
        rated = subprocess.run(rating, capture_output=True, text=True, check=False)
        assert rated.returncode == 0, (unit.name, rated.stdout.splitlines()[-1:], rated.stderr)


def test_the_robots_computer_gets_its_guard_and_what_its_zenoh_is_told(far):
    robot = far / "robot"
    assert {path.name for path in (robot / "systemd").iterdir()} == {
        "suturegrasp-guard-psm1.service",
        "suturegrasp.target",
    }
    assert "guard --arm psm1 --config" in (robot / "systemd" / "suturegrasp-guard-psm1.service").read_text()
    assert {path.stem for path in (robot / "certificates").glob("*.key")} == {"guard.psm1", "robot_zenoh.robot"}
    assert "guard-psm1:" in (robot / "compose.yaml").read_text()
    server = x509.load_pem_x509_certificate((robot / "certificates" / "robot_zenoh.robot.pem").read_bytes())
    names = server.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert [str(name.value) for name in names] == ["10.214.0.2"]
    told = json.loads((robot / "robot-zenoh.json5").read_text().split("\n", 1)[1])
    assert told["listen"]["endpoints"] == ["tls/10.214.0.2:7448"]
    tls = told["transport"]["link"]["tls"]
    assert (tls["enable_mtls"], tls["close_link_on_expiration"]) == (True, True)
    assert {s["id"] for s in told["access_control"]["subjects"]} == {"robot_bridge.psm1", "guard.psm1"}
    assert "/PSM1/jaw/servo_jp" in told["plugins"]["ros2dds"]["allow"]["subscribers"]


def test_the_containers_router_is_told_what_ours_is(lab):
    told = json.loads((lab / "video" / "router.json5").read_text().split("\n", 1)[1])
    assert told["access_control"] == access_control("lab", load_config(LAB, RigConfig).common_names())
    assert told["listen"]["endpoints"] == ["tls/10.0.0.11:7447"]
    assert told["transport"]["link"]["tls"]["enable_mtls"] is True
    assert told["transport"]["link"]["tx"]["lease"] == 2000


def test_the_image_is_built_from_files_that_are_there_and_its_user_owns_the_certificates():
    image = (REPOSITORY / "deploy" / "Dockerfile").read_text()
    copying = [line.split()[1:-1] for line in image.splitlines() if line.startswith("COPY ")]
    copied = [name for names in copying for name in names if not name.startswith("--")]
    assert copied
    assert all((REPOSITORY / name).exists() for name in copied)
    assert f"useradd --uid {IMAGE_USER} --gid {IMAGE_USER} " in image
    page = (REPOSITORY / "docs" / "deployment.md").read_text()
    assert f"chown --recursive {IMAGE_USER} video/certificates" in page


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[camera]", "has no [hosts]"),
        (TEXT + '[topics."camera/frame"]\nrecorded = false', "there is no topic 'camera/frame'"),
        (TEXT.replace('"planner"]', '"planner", "camera"]'), "would have two owners"),
        (TEXT.replace(', "planner"]', "]"), "no host runs 'planner'"),
        ('host = "video"\n' + TEXT, "the copy for host video"),
        (TEXT.replace('source = "scene"', 'source = "images"\nleft = "l"\ncalibration = "c.yaml"'), "c.yaml"),
    ],
)
def test_a_rig_that_cannot_be_planned_is_one_sentence(tmp_path, capfd, text, said):
    (tmp_path / "rig.toml").write_text(text)
    assert deploy("plan", "--config", tmp_path / "rig.toml", "--folder", tmp_path / "out") == 2
    (complaint,) = capfd.readouterr().err.splitlines()
    assert said in complaint
    assert not (tmp_path / "out").exists()


def test_a_rig_that_nobody_can_command_is_told_and_a_calibration_goes_to_the_cameras_host(tmp_path, capfd):
    text = TEXT.replace('source = "scene"', 'source = "images"\nleft = "l"\ncalibration = "own/c.yaml"')
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "c.yaml").write_text("what it says is read on that host")
    (tmp_path / "rig.toml").write_text(text.replace('"operator", ', ""))
    assert deploy("plan", "--config", tmp_path / "rig.toml", "--folder", tmp_path / "out") == 0
    assert 'no host runs "operator", so nobody may give commands' in capfd.readouterr().out
    found = [path.relative_to(tmp_path / "out") for path in (tmp_path / "out").rglob("c.yaml")]
    assert found == [Path("video/own/c.yaml")]
    assert "./own/c.yaml:/etc/suturegrasp/own/c.yaml:ro" in (tmp_path / "out/video/compose.yaml").read_text()


def test_the_files_of_an_arm_go_to_the_host_of_its_bridge_and_one_that_is_not_there_is_told(tmp_path, capfd):
    (tmp_path / "base.json").write_text("what it says is read on that host")
    files_of = '\n[robot.psm1]\nT_camera_base_file = "base.json"\njaw_file = "own/jaw.json"\n'
    (tmp_path / "rig.toml").write_text(TEXT.replace("\n[robot.psm1]\n", files_of))
    assert deploy("plan", "--config", tmp_path / "rig.toml", "--folder", tmp_path / "out") == 0
    assert "robot.psm1.jaw_file own/jaw.json is no file beside" in capfd.readouterr().out
    assert [path.relative_to(tmp_path / "out") for path in (tmp_path / "out").rglob("base.json")] == [
        Path("robot/base.json")
    ]


def test_of_a_host_that_was_renamed_nothing_stays_but_a_persons_own_files(tmp_path, capfd):
    out = made(TEXT, tmp_path)
    before = files(out / "strong")
    (out / "strong" / "notes.txt").write_text("ask before moving it")
    (out / "strong" / "systemd" / "own.service").write_text("[Unit]\n")
    made(TEXT.replace("[hosts.strong]", "[hosts.box]"), tmp_path)
    assert files(out / "strong") == {"notes.txt", "systemd/own.service"}
    assert files(out / "box") == before
    said = capfd.readouterr().out
    for place in ("rig.toml", "systemd/suturegrasp-perception.service", "certificates/perception.main.key"):
        assert f"removed strong/{place}, which is in the rig's plan no more\n" in said


def test_what_moves_to_another_host_leaves_its_unit_and_its_files(tmp_path):
    out = made(TEXT, tmp_path)
    # our unit by its name, which no list has
    (out / "strong" / "systemd" / "suturegrasp-camera.service").write_text("[Unit]\n")
    moved = TEXT.replace('host = "video"', 'host = "desk"').replace('"viewer"', '"viewer", "planner"')
    made(moved.replace(', "planner"]', "]", 1), tmp_path)
    assert [path.parent.name for path in out.rglob("router.json5")] == ["desk"]
    assert [path.parents[1].name for path in out.rglob("suturegrasp-planner.service")] == ["desk"]
    assert [path.parents[1].name for path in out.rglob("suturegrasp-camera.service")] == ["video"]


def test_a_rig_that_shares_the_folder_keeps_its_own(tmp_path):
    out = tmp_path / "out"
    before = files(made(TEXT, out))
    north = TEXT.replace('rig = "lab"', 'rig = "north"').replace('host = "video"', 'host = "video2"')
    for host in HOSTS:
        north = north.replace(f"[hosts.{host}]", f"[hosts.{host}2]")
    made(north, out)
    assert files(out) >= before
    made(TEXT, out)
    assert (out / "video2" / "rig.toml").is_file()


def test_a_list_that_names_other_places_removes_nothing_there(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "precious").write_text("x")
    (tmp_path / "out" / "lab.made").write_text(f"../precious\n{tmp_path / 'precious'}\nvideo/../../precious\n")
    assert remove_leftovers(tmp_path / "out", "lab", [PurePosixPath("video/rig.toml")]) == []
    assert (tmp_path / "precious").exists()
    assert (tmp_path / "out" / "lab.made").read_text() == "video/rig.toml\n"
