"""A second plan in the same folder: what an earlier one made and the rig has no more is removed, and nothing else."""

from pathlib import Path, PurePosixPath

import pytest

from agents.cli.main import main
from agents.deployment.leftovers import remove_leftovers

LAB = Path(__file__).parents[3] / "deploy" / "lab.toml"


def deploy(folder, text):
    """Plan and certificates of a rig's text."""
    (folder / "rig.toml").write_text(text)
    for action in ("plan", "certificates"):
        with pytest.raises(SystemExit) as ended:
            main(["deploy", action, "--config", str(folder / "rig.toml"), "--folder", str(folder / "out")])
        assert ended.value.code == 0


def files(folder):
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def planned(tmp_path):
    deploy(tmp_path, LAB.read_text())
    return tmp_path


def test_of_a_host_that_was_renamed_nothing_stays_but_a_persons_own_files(planned, capfd):
    before = files(planned / "out" / "strong")
    (planned / "out" / "strong" / "notes.txt").write_text("ask before moving it")
    (planned / "out" / "strong" / "systemd" / "own.service").write_text("[Unit]\n")
    deploy(planned, LAB.read_text().replace("[hosts.strong]", "[hosts.box]"))
    assert files(planned / "out" / "strong") == {"notes.txt", "systemd/own.service"}
    assert files(planned / "out" / "box") == before
    said = capfd.readouterr().out
    assert "notes.txt" not in said
    for place in ("rig.toml", "systemd/suturegrasp-perception.service", "certificates/perception.main.key"):
        assert f"removed strong/{place}, which is in the rig's plan no more\n" in said


def test_what_moves_to_another_host_leaves_its_unit_and_its_files(planned):
    # our unit by its name, which no list has
    (planned / "out" / "strong" / "systemd" / "suturegrasp-camera.service").write_text("[Unit]\n")
    moved = LAB.read_text().replace('host = "video"', 'host = "desk"').replace('"viewer"', '"viewer", "planner"')
    deploy(planned, moved.replace(', "planner"]', "]", 1))
    assert "router.json5" not in files(planned / "out" / "video")
    assert "router.json5" in files(planned / "out" / "desk")
    assert "systemd/suturegrasp-camera.service" not in files(planned / "out" / "strong")
    held = {path.name: path.parents[1].name for path in (planned / "out").rglob("suturegrasp-planner.service")}
    assert held == {"suturegrasp-planner.service": "desk"}


def test_a_rig_that_shares_the_folder_keeps_its_own(planned):
    before = files(planned / "out")
    north = LAB.read_text().replace('rig = "lab"', 'rig = "north"')
    for host in ("video", "strong", "robot", "desk"):
        north = north.replace(f"[hosts.{host}]", f"[hosts.{host}2]")
    deploy(planned, north.replace('host = "video"', 'host = "video2"'))
    assert files(planned / "out") >= before
    deploy(planned, LAB.read_text())
    assert (planned / "out" / "video2" / "rig.toml").is_file()


def test_a_list_that_names_other_places_removes_nothing_there(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "precious").write_text("x")
    (tmp_path / "out" / "lab.made").write_text(f"../precious\n{tmp_path / 'precious'}\nvideo/../../precious\n")
    assert remove_leftovers(tmp_path / "out", "lab", [PurePosixPath("video/rig.toml")]) == []
    assert (tmp_path / "precious").exists()
    assert (tmp_path / "out" / "lab.made").read_text() == "video/rig.toml\n"
