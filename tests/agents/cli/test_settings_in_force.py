"""Which settings the outputs of a replayed recording are of, and what cuts and replays of it tell of it."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.cli.main import main
from agents.cli.recordings.config import attached_config, changed, in_force, settings_otherwise
from agents.configuration.rig import simulated_rig
from agents.launch.process import EXIT_UNUSABLE
from agents.session_report.table import decimal
from shared.recording.completeness import completeness
from tests.agents.cli.conftest import REPOSITORY

EXAMPLE = REPOSITORY / "docs" / "example" / "session.mcap"
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
AGENTS = ("camera", "perception", "reconstruction", "planner", "simulator", "robot_bridge/psm1")


@given(st.sets(st.sampled_from(AGENTS)), st.sets(st.sampled_from(sorted(CHANGES))), st.integers(0, 1))
def test_settings_are_in_force_for_the_agents_that_ran_with_them_and_for_no_others(anew, settings, which):
    sections = {agent.replace("robot_bridge/psm1", "robot") for agent in anew}
    told = {key: CHANGES[key][min(which, len(CHANGES[key]) - 1)] for key in settings}
    used = changed(RECORDED, [f"{key}={value}" for key, value in told.items()])
    effective = in_force(RECORDED, used, sorted(anew))
    otherwise = settings_otherwise(RECORDED, effective)
    assert set(otherwise) == {key for key in told if key.split(".")[0] in sections}
    assert all(otherwise[key].endswith(f"-> {told[key]}") for key in otherwise)
    # of agents that did not run anew the file says what was recorded, and no setting of today
    old = json.dumps({"rig": "lab", "planner": {"least_probability": 0.1}}).encode()
    attached = json.loads(attached_config(old, effective, sorted(anew)))
    assert attached["rig"] == "lab"
    if "planner" not in anew:
        assert attached["planner"] == {"least_probability": 0.1}
    assert set(attached) - {"rig", "planner"} <= sections
    # what is attached is read back as the same, and a replay of it begins from there
    assert in_force(effective, effective, AGENTS) == effective


@pytest.fixture
def run(capsys):
    """The exit status of a command, and what it says."""

    def end(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
        said = capsys.readouterr()
        return ended.value.code, said.out, said.err

    return end


def test_a_setting_that_no_replayed_agent_reads_is_refused_and_so_is_none_that_one_reads(run):
    for setting, reads in (("perception.segmenter=threshold", False), ("planner.attempts=1", True)):
        status, _, err = run("recompute", EXAMPLE, "--through", "planner", "--set", setting)
        assert (status == EXIT_UNUSABLE) is not reads
        assert (f"--set {setting} changes nothing, for planner does not read it" in err) is not reads


def test_of_a_damaged_recording_what_can_be_read_is_replayed_and_the_damage_is_told(run, tmp_path):
    damaged, output, content = tmp_path / "damaged.mcap", tmp_path / "output.mcap", EXAMPLE.read_bytes()
    damaged.write_bytes(content[:6_000_000])
    status, out, err = run("recompute", damaged, "--through", "planner")
    assert (status != EXIT_UNUSABLE, "cut off at" in err, "planner: 1 of 1 outputs repeated" in out) == (True,) * 3
    damaged.write_bytes(content[:5_000_000] + b"\xff" * 2000 + content[5_002_000:])
    status, _, err = run("recompute", damaged, "--through", "planner", "--output", output)
    assert status != EXIT_UNUSABLE
    assert "is damaged; only what lies before the damage can be read" in err
    assert completeness(output).complete is False
    assert "is damaged" in completeness(output).sentence
    damaged.write_bytes(content[:40_000])
    for command, *options in (("cut", "--output", tmp_path / "new.mcap"), ("recompute", "--through", "planner")):
        status, _, err = run(command, damaged, *options)
        assert (status, f"{damaged} is cut off before its first message" in err) == (EXIT_UNUSABLE, True)


def test_what_a_cut_off_recording_was_made_of_goes_on_through_cuts_and_replays(run, tmp_path):
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


def test_an_agent_that_said_nothing_does_not_stop_the_replay_of_another(run, tmp_path):
    early = tmp_path / "early.mcap"
    run("cut", EXAMPLE, "--to", "0.6", "--output", early)
    status, out, _ = run("recompute", early, "--through", "reconstruction,planner")
    assert (status != EXIT_UNUSABLE, "planner: said nothing in this recording" in out) == (True, True)
    status, _, err = run("recompute", early, "--through", "planner")
    assert status == EXIT_UNUSABLE
    assert "the recording holds no output of planner; it has some of: camera" in err


def test_a_cut_names_as_run_anew_and_as_kept_only_what_it_holds(run, tmp_path):
    derived, early, late = (tmp_path / f"{name}.mcap" for name in ("derived", "early", "late"))
    run("recompute", EXAMPLE, "--through", "planner,reconstruction", "--output", derived)
    run("cut", derived, "--to", "0.4", "--output", early)
    run("cut", derived, "--from", "0.4", "--output", late)
    anew = [completeness(path).ran_anew for path in (derived, early, late)]
    assert [one["planner"].outputs for one in anew] == [1, 0, 1]
    outputs, kept = ([getattr(one["reconstruction"], of) for one in anew] for of in ("outputs", "kept"))
    assert outputs[0] == outputs[1] + outputs[2]
    assert kept == [1, 1, 0]
    assert "ran anew, in " in completeness(early).derived[-2].sentence
    # of live steps and of a replay's, which are no figures of one kind, none is told beside the other
    _, out, _ = run("inspect", EXAMPLE, derived)
    rows = [line.split()[-2:] for line in out.splitlines() if "replayed p99" in line]
    assert rows == [["-", decimal(anew[0][agent].step_ms_p99)] for agent in ("reconstruction", "planner")]
