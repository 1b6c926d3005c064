"""What is read from a recording: contents, gaps, latencies, agents, grasps, facts; of files in every condition."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.planner.agent import Planner
from agents.planner.config import PlannerConfig
from agents.session_report.contents import gaps_of
from agents.session_report.document import document
from agents.session_report.grasps import GraspCollector
from agents.session_report.page import session_page
from agents.session_report.session import read_session
from agents.session_report.tables import grasps, head_lines, pulls, session_tables
from schemas import messages
from schemas.topics import ARM, CONFIGURATION, EXECUTION, FRAMES, HEALTH, HOLD, LOG, PLAN, SET, key, topic_of
from shared.recording.derivation import Anew, Derivation
from shared.recording.entry import Entry
from shared.recording.writer import RecordingWriter
from tests.agents.planner.pulling.bench import Field
from tests.agents.session_report.conftest import ZERO_NS, event, frame, health, ns, plan

FRAMES_KEY = key("lab", FRAMES)


def rows_of(session, title):
    (table,) = [table for table in session_tables(session) if table.title == title]
    return table.rows


def test_counts_rates_times_gaps_and_latencies_are_those_of_the_messages(recording):
    session = read_session(recording)
    (frames,) = [one for one in session.contents if one.key == FRAMES_KEY]
    assert (frames.count, frames.topic, frames.runs) == (57, "camera/frames", 1)
    assert frames.rate_hz == pytest.approx(56 / (59 / 30))
    assert session.duration_s == pytest.approx(59 / 30 + 0.06)
    assert session.size_bytes == recording.stat().st_size
    (gap,) = frames.gaps
    assert (gap.lost, session.since_start_s(gap.from_ns)) == (3, pytest.approx(19 / 30 + 0.01))
    assert (gap.to_ns - gap.from_ns) * 1e-9 == pytest.approx(4 / 30)
    # from capture until publication
    for stage, latency_ms in (("camera/frames", 10), ("reconstruction/thread", 60), ("robot_bridge/state psm1", 2)):
        assert session.stages[stage].latency_ms == pytest.approx(np.full(57, float(latency_ms)))


def test_what_the_recorder_noted_is_told(recording):
    session = read_session(recording)
    assert (session.said.complete, session.said.lost) == (False, {FRAMES_KEY: 3})
    assert session.facts["run.settings.planner.depth_m"] == "0.002"
    assert session.facts["calibration.baseline_mm"] == "5.5"
    assert rows_of(session, "noted by the recorder") == (("0.70", "lost", "camera/main/frames: 3: 20-22 on the way"),)
    named, lasted, lacks = head_lines(session)
    assert named.startswith(str(recording))
    assert "lasted 2.0 s" in lasted
    assert lacks == "not complete: lost 3 of camera/main/frames"


def test_agents_tell_step_times_drops_and_faults_and_failures_are_counted_without_their_numbers(recording):
    session = read_session(recording)
    perception, planner = session.agents
    assert (perception.name, planner.name) == ("perception", "planner")
    assert (perception.step_ms_p50, perception.step_ms_p99) == (pytest.approx(2.6), pytest.approx(21.1))
    assert [(one.topic, one.dropped) for one in perception.drops] == [("camera/frames", 4)]
    assert [(one.level, one.count) for one in session.remarks] == [("WARNING", 1), ("FAULT", 1)]
    assert session.quality.failed == {("reconstruction/thread", "only # observations"): 2}
    assert session.quality.length == pytest.approx(np.full(55, 40.0))
    assert session.quality.confidence == pytest.approx(np.full(55, 0.75))


def test_drops_of_all_runs_are_added_up_without_those_of_before_the_recording(a_session, tmp_path):
    whole = a_session()
    whole.put(HEALTH, health("perception", 1.5, dropped=7), 1.5, agent="perception", epoch=2)
    for before, dropped, at_s in ((40, 100, 1.7), (0, 107, 1.9)):
        told = health("perception", at_s, dropped, received=20 * dropped)
        whole.put(HEALTH, told, at_s, agent="perception", epoch=3, skip=before)
    perception = read_session(whole.write(tmp_path / "a.mcap")).agents[0]
    (drops,) = perception.drops
    assert (perception.runs, drops.dropped, drops.received) == (3, 4 + 7 + 7, 10 + 10 + 140)


def test_a_refused_goal_and_a_held_grasp_are_put_together(recording):
    refused, held = read_session(recording).grasps
    assert (refused.outcome, refused.plan) == ("goal refused", None)
    assert refused.ended == "goal refused (thread_stale): the thread was seen 2000 ms ago"
    assert (held.outcome, held.ended) == ("held", "grasp held: caught at 50 %")
    (arming,) = held.armings
    assert [event.phase for event in arming.events if event.phase] == list(messages.Phase)[:5]


def test_a_grasp_that_held_did_though_its_plan_is_armed_once_more_and_refused(a_session, tmp_path):
    whole = a_session()
    again = messages.Arm(messages.CommandHeader("a2", ns(99), "operator"), "psm1", "plan-g2")
    answer = messages.CommandAnswer("a2", messages.Outcome.REFUSED, "carried_out", "set a goal again")
    whole.command(ARM, again, answer, 1.8, "robot_bridge", "psm1")
    _, held = read_session(whole.write(tmp_path / "a.mcap")).grasps
    assert (held.outcome, held.ended, len(held.armings)) == ("held", "grasp held: caught at 50 %", 2)


def test_the_plan_of_a_grasp_is_the_one_that_was_carried_out_and_not_a_further_attempt(a_session, tmp_path):
    whole = a_session()
    whole.put(PLAN, dataclasses.replace(plan("g2", 18, 1.7), plan_id="plan-g2-2", slide_m=0.0), 1.75)
    _, held = read_session(whole.write(tmp_path / "a.mcap")).grasps
    assert held.plan is not None
    assert (held.plan.plan_id, held.plan.slide_m, held.outcome) == ("plan-g2", 0.004, "held")


def test_a_pause_between_two_runs_of_a_publisher_is_a_gap(maker, tmp_path):
    for number, at_s in enumerate(np.arange(0, 2, 0.2)):
        maker.put(FRAMES, frame(number, at_s), at_s)
        maker.put(FRAMES, frame(number, at_s + 5.0), at_s + 5.0, epoch=2)
    (frames,) = [one for one in read_session(maker.write(tmp_path / "a.mcap")).contents if one.key == FRAMES_KEY]
    (gap,) = frames.gaps
    assert (frames.runs, gap.lost) == (2, 0)
    assert (gap.to_ns - gap.from_ns) == pytest.approx(3.2e9, abs=1e7)


def test_a_grasp_whose_beginning_was_not_recorded_is_told_from_what_there_is(a_session, tmp_path):
    whole = a_session()
    whole.entries = [(topic, entry) for topic, entry in whole.entries if entry.published_ns > ns(1.15)]
    (grasp,) = read_session(whole.write(tmp_path / "late.mcap")).grasps
    assert (grasp.goal, grasp.plan, grasp.outcome) == (None, None, "held")
    assert grasp.armings[0].answer.outcome is messages.Outcome.UNKNOWN
    assert len(grasp.armings[0].events) == 5


def test_a_plan_from_before_a_stretch_is_no_plan_of_it_and_of_a_replay_it_is_told_whose_it_is(maker, tmp_path):
    maker.put(PLAN, plan("g2", 1, 0.5), 0.5, repeated=True)
    maker.put(FRAMES, frame(1, 1.0), 1.0)
    maker.put(EXECUTION, event(messages.ExecutionKind.ACCEPTED, 1.2), 1.2, instance="psm1")
    for began_s, whose in ((None, ""), (0.1, " (planned anew)"), (0.9, " (of the source)")):
        notes = [("losses", {"complete": "True"})]
        if began_s is not None:
            anew = {"planner": Anew((), 0, 0, None, None)}
            replayed = Derivation("replayed", "a.mcap", agents=anew, from_ns=ns(began_s))
            notes.append((replayed.note.name, replayed.note.facts))
        session = read_session(maker.write(tmp_path / f"{began_s}.mcap", notes))
        (grasp,) = session.grasps
        assert (grasp.plan_before, grasp.outcome) == (True, "execution accepted")
        goal, planned = grasps(session).rows[0][2:4]
        assert (goal, planned.endswith(f"{whose} (from before)")) == ("from before", True)
        assert "planner" not in session.stages


def test_what_an_arm_did_is_told_though_a_planner_that_ran_anew_finds_no_plan():
    found = GraspCollector()
    found.add(
        ns(1.0),
        dataclasses.replace(plan("g2", 1, 1.0), status=messages.Status.FAILED, reason="too unsure", waypoints=()),
    )
    found.add(ns(1.2), event(messages.ExecutionKind.ACCEPTED, 1.2))
    (grasp,) = found.grasps
    assert (grasp.ended, grasp.outcome) == ("no plan: too unsure; unfinished after accepted", "execution accepted")


def test_holds_and_what_was_set_while_it_ran_are_told_with_who_did_so_and_when(maker, tmp_path):
    def is_set(value, at_s):
        settable = (messages.SettableParameter("least_probability", "0 to 1", True),)
        told = messages.AgentConfiguration(
            "planner", "main", ns(at_s), f'{{"least_probability": {value}}}', settable, "c"
        )
        maker.put(CONFIGURATION, told, at_s, agent="planner", repeated=at_s < 0.2)

    maker.put(FRAMES, frame(1, 0.2), 0.2)
    is_set(0.6, 0.1)
    set_to = messages.SetParameter(messages.CommandHeader("s", 1, "anna"), "least_probability", "0.9")
    maker.command(SET, set_to, messages.CommandAnswer("s", messages.Outcome.ACCEPTED, "", ""), 1.2, "planner")
    is_set(0.9, 1.21)
    hold = messages.Hold(messages.CommandHeader("h", 1, "operator"), "psm1")
    maker.command(
        HOLD, hold, messages.CommandAnswer("h", messages.Outcome.ACCEPTED, "", ""), 1.5, "robot_bridge", "psm1"
    )
    session = read_session(maker.write(tmp_path / "a.mcap"))
    assert rows_of(session, "set while it ran") == (
        ("before", "planner", "least_probability", "0.6", "", "set"),
        ("1.00", "planner", "least_probability", "0.9", "anna", "set"),
    )
    assert session.facts["set while it ran.planner.least_probability"] == "0.6, then 0.9"
    assert rows_of(session, "other commands") == (("1.30", "operator/hold", "psm1", "accepted"),)


def test_a_cut_off_recording_says_so_and_what_there_is_is_told(recording, tmp_path):
    path = tmp_path / "cut.mcap"
    path.write_bytes(recording.read_bytes()[: recording.stat().st_size // 2])
    session = read_session(path)
    assert (session.said.finished, session.said.complete) == (False, None)
    assert 0 < sum(one.count for one in session.contents) < 200
    assert any(line.startswith("cut off at") for line in head_lines(session))
    assert session_tables(session)


def test_messages_that_cannot_be_read_are_counted_with_the_first_reason(maker, tmp_path):
    name, unknown = key("lab", LOG, agent="camera"), "suturegrasp/lab/camera/main/aura"
    for number in range(4):
        maker.put(
            LOG, messages.LogRecord(number, "camera", "main", messages.LogLevel.INFO, "x"), 0.1 * number, agent="camera"
        )
    maker.entries += [(LOG, Entry(name, 1, 4 + n, b"\xff" * 9, 10**18, 10**18)) for n in range(2)]
    maker.entries += [(LOG, Entry(unknown, 1, 0, b"", 10**18, 10**18))]
    session = read_session(maker.write(tmp_path / "a.mcap"))
    assert {one.key: (one.count, one.unreadable) for one in session.contents} == {name: (6, 2), unknown: (1, 1)}
    told = " ".join(head_lines(session))
    assert "2 of 6 messages of camera/main/log cannot be read: LogRecord cannot be read" in told
    assert "camera/main/aura cannot be read: this version has no such topic" in told


def test_what_was_repeated_from_before_the_file_began_counts_for_what_held_and_not_as_its_contents(a_session, tmp_path):
    whole = a_session()
    (topic, first), *others = whole.entries
    whole.entries = [(topic, dataclasses.replace(first, published_ns=1, repeated=True)), *others]
    session = read_session(whole.write(tmp_path / "part2.mcap"))
    assert first.key not in {one.key for one in session.contents}
    assert session.facts["calibration.image_px"] == "96x54"
    assert session.start_ns > ZERO_NS


@given(data=st.data())
def test_of_any_run_the_lost_numbers_are_those_that_are_not_there(data):
    begin = data.draw(st.integers(0, 2**32 - 1))
    present = sorted(data.draw(st.sets(st.integers(0, 300), min_size=1)))
    order = data.draw(st.permutations(present))
    sequence = np.array([(begin + n) % 2**32 for n in order], np.int64)
    found = gaps_of(np.array([n * 10**7 for n in order], np.int64), sequence, is_regular=False)
    assert sum(gap.lost for gap in found) == present[-1] - present[0] + 1 - len(present)
    assert all(gap.to_ns - gap.from_ns == (gap.lost + 1) * 10**7 for gap in found)


def test_a_silence_of_what_comes_regularly_is_a_gap_without_losses():
    at = np.concatenate((np.arange(50), np.arange(50) + 100)) * 10**7
    (gap,) = gaps_of(at, np.arange(100), is_regular=True)
    assert (gap.lost, gap.to_ns - gap.from_ns) == (0, 51 * 10**7)
    assert gaps_of(at, np.arange(100), is_regular=False) == []


def test_a_pull_is_told_with_what_its_tail_came_to_and_is_no_grasp(tmp_path):
    field = Field(30.0, Planner(PlannerConfig(pull_reach_m=0.026)))
    plan, answer = field.ask(0.012)
    assert plan is not None, answer
    field.arm(plan)
    assert field.to_the_end().ended[0] is messages.ExecutionKind.FINISHED
    rejected, _ = field.ask(0.004, name="g2")
    assert rejected is not None
    writer = RecordingWriter(tmp_path / "pull.mcap")
    for entry in field.steps.entries:
        writer.write(topic_of(entry.key), entry)
    writer.note("losses", {"complete": "True"})
    writer.close()
    session = read_session(tmp_path / "pull.mcap")
    told, other = pulls(session).rows
    assert other[3:] == ("4.0", "", "", "1", "0", f"no plan: {rejected.reason}")
    assert (session.grasps, told[2:4], told[7]) == ((), ("psm1", "12.0"), "2")
    assert told[4].startswith("30.0 (29.3")
    assert told[8].startswith("reached: the tail is 1")
    (armed,) = rows_of(session, "armed")
    assert (armed[0], "finished" in armed[4]) == ("pull 1", True)
    written = document(session)["pulls"][0]
    assert len(written["segments"]) == int(told[6]) == len(field.plans) - 1
    assert written["tail"][-1]["length_m"] < 0.0135
    assert "tail, mm" in "".join(session_page(session, []))
