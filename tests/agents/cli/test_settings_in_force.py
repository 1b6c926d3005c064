"""Which settings the outputs of a replayed recording are of: for any agents that ran anew, and any settings."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.cli.main import main
from agents.cli.recordings.config import attached_config, changed, in_force, settings_otherwise
from agents.cli.recordings.recompute import EXIT_UNUSABLE
from agents.configuration.rig import simulated_rig
from agents.inspection.table import decimal
from shared.recording.completeness import completeness

EXAMPLE = Path(__file__).parents[3] / "docs" / "example" / "session.mcap"
RECORDED = simulated_rig()
CHANGES = {
    "camera.rate_hz": ("12.0", "20.0"),
    "perception.segmenter": ("threshold", "network"),
    "perception.matching": ("true",),
    "reconstruction.tracking": ("false",),
    "planner.least_probability": ("0.25", "0.75"),
    "planner.attempts": ("1", "2"),
    "robot.psm1.speed_share": ("0.5",),
    "simulator.seed": ("7",),
}
AGENT_OF = {"robot": "robot_bridge/psm1"}
AGENT_KIND = {"robot_bridge/psm1": "robot"}
AGENTS = ("camera", "perception", "reconstruction", "planner", "simulator", "robot_bridge/psm1")


@given(st.sets(st.sampled_from(AGENTS)), st.sets(st.sampled_from(sorted(CHANGES))), st.integers(0, 1))
def test_settings_are_in_force_for_the_agents_that_ran_with_them_and_for_no_others(anew, settings, which):
    told = {key: CHANGES[key][min(which, len(CHANGES[key]) - 1)] for key in settings}
    used = changed(RECORDED, [f"{key}={value}" for key, value in told.items()])
    effective = in_force(RECORDED, used, sorted(anew))
    otherwise = settings_otherwise(RECORDED, effective)
    expected = {key for key in told if AGENT_OF.get(key.split(".")[0], key.split(".")[0]) in anew}
    assert set(otherwise) == expected
    assert all(otherwise[key].endswith(f"-> {told[key]}") for key in expected)
    # of agents that did not run anew the file says what was recorded, and no setting of today
    old = json.dumps({"rig": "lab", "planner": {"least_probability": 0.1}}).encode()
    attached = json.loads(attached_config(old, effective, sorted(anew)))
    assert attached["rig"] == "lab"
    if "planner" not in anew:
        assert attached["planner"] == {"least_probability": 0.1}
    assert set(attached) - {"rig", "planner"} <= {AGENT_KIND.get(name, name) for name in anew}
    # what is attached is read back as the same, and a replay of it begins from there
    assert in_force(effective, effective, AGENTS) == effective


def run(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code


def test_a_setting_that_no_replayed_agent_reads_is_refused_and_so_is_none_that_one_reads(capsys):
    for agent, setting, reads in (
        ("planner", "perception.segmenter=threshold", False),
        ("planner", "planner.attempts=1", True),
    ):
        assert (run("recompute", EXAMPLE, "--through", agent, "--set", setting) == EXIT_UNUSABLE) is not reads
        refused = f"--set {setting} changes nothing, for planner does not read it"
        assert (refused in capsys.readouterr().err) is not reads


def test_of_a_damaged_recording_what_can_be_read_is_replayed_and_the_damage_is_told(tmp_path, capsys):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(EXAMPLE.read_bytes()[:6_000_000])
    assert run("recompute", cut, "--through", "planner") != EXIT_UNUSABLE
    told = capsys.readouterr()
    assert "cut off at" in told.err
    assert "planner: 1 of 1 outputs repeated" in told.out


def test_two_recordings_are_compared_by_the_steps_that_made_what_they_hold(tmp_path, capsys):
    derived = tmp_path / "derived.mcap"
    run("recompute", EXAMPLE, "--through", "planner", "--output", derived)
    anew = completeness(derived).ran_anew["planner"]
    capsys.readouterr()
    run("inspect", EXAMPLE, derived)
    row = next(line.split() for line in capsys.readouterr().out.splitlines() if "replayed p99" in line)
    # of live steps and of a replay's, which are no figures of one kind, none is told beside the other
    assert row[3:] == ["-", decimal(anew.step_ms_p99)]


def test_what_a_cut_off_recording_was_made_of_goes_on_through_cuts_and_replays(tmp_path):
    derived, off = tmp_path / "derived.mcap", tmp_path / "off.mcap"
    run("recompute", EXAMPLE, "--through", "planner", "--set", "planner.tool_error_mm=1", "--output", derived)
    off.write_bytes(derived.read_bytes()[:6_000_000])
    run("cut", off, "--output", tmp_path / "cut.mcap")
    run("recompute", off, "--through", "reconstruction", "--output", tmp_path / "again.mcap")
    for name in ("cut.mcap", "again.mcap"):
        told = completeness(tmp_path / name).derived
        assert [one.source for one in told] == ["found_10.mcap", EXAMPLE.name, off.name]
        assert told[1].settings == {"planner.tool_error_mm": "not recorded -> 1.0"}
        assert "planner" in completeness(tmp_path / name).ran_anew


def test_a_replay_of_a_recording_that_is_damaged_within_says_so_and_so_does_what_it_writes(tmp_path, capsys):
    damaged, output = tmp_path / "damaged.mcap", tmp_path / "output.mcap"
    spoilt = bytearray(EXAMPLE.read_bytes())
    spoilt[5_000_000:5_002_000] = b"\xff" * 2000
    damaged.write_bytes(spoilt)
    assert run("recompute", damaged, "--through", "planner", "--output", output) != EXIT_UNUSABLE
    assert "is damaged; only what lies before the damage can be read" in capsys.readouterr().err
    assert completeness(output).complete is False
    assert "is damaged" in completeness(output).sentence


def test_an_agent_that_said_nothing_does_not_stop_the_replay_of_another(tmp_path, capsys):
    early = tmp_path / "early.mcap"
    run("cut", EXAMPLE, "--to", "0.6", "--output", early)
    capsys.readouterr()
    assert run("recompute", early, "--through", "reconstruction,planner") != EXIT_UNUSABLE
    assert "planner: said nothing in this recording" in capsys.readouterr().out
    assert run("recompute", early, "--through", "planner") == EXIT_UNUSABLE
    assert "the recording holds no output of planner; it has some of: camera" in capsys.readouterr().err


def test_a_cut_names_as_run_anew_only_what_it_holds(tmp_path):
    derived, early, late = (tmp_path / f"{name}.mcap" for name in ("derived", "early", "late"))
    run("recompute", EXAMPLE, "--through", "planner", "--output", derived)
    made = completeness(derived).ran_anew["planner"].outputs
    run("cut", derived, "--to", "0.4", "--output", early)
    run("cut", derived, "--from", "0.7", "--output", late)
    assert completeness(early).ran_anew["planner"].outputs == 0
    assert "nothing in it is of planner" in completeness(early).derived[-2].sentence
    assert 0 < completeness(late).ran_anew["planner"].outputs <= made
    assert "ran anew: planner;" in completeness(late).derived[-2].sentence


def test_a_cut_knows_which_of_its_outputs_could_not_be_repeated(tmp_path):
    derived, early, late = (tmp_path / f"{name}.mcap" for name in ("derived", "early", "late"))
    run("recompute", EXAMPLE, "--through", "reconstruction", "--output", derived)
    run("cut", derived, "--to", "0.8", "--output", early)
    run("cut", derived, "--from", "0.8", "--output", late)
    kept = [completeness(path).ran_anew["reconstruction"].kept for path in (derived, early, late)]
    assert kept == [1, 1, 0]
    outputs = [completeness(path).ran_anew["reconstruction"].outputs for path in (derived, early, late)]
    assert outputs[0] == outputs[1] + outputs[2]


@pytest.mark.parametrize("command", [("cut", "--output", "short.mcap"), ("recompute", "--through", "planner")])
def test_a_file_that_ends_before_its_first_message_is_told_as_that(command, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "off.mcap"
    path.write_bytes(EXAMPLE.read_bytes()[:40_000])
    assert run(command[0], path, *command[1:]) == EXIT_UNUSABLE
    assert f"{path} is cut off before its first message" in capsys.readouterr().err
