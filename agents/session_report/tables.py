"""What a session tells as tables of text, the same for the terminal and for the page."""

from datetime import UTC, datetime

from agents.session_report.contents import KeyContents
from agents.session_report.facts import is_of_a_moment
from agents.session_report.grasps import Arming, Grasp, event_name
from agents.session_report.pulls import Pulled
from agents.session_report.session import Session
from agents.session_report.stages import BEFORE, added_ms, percentiles
from agents.session_report.table import Row, Table, decimal, megabytes, short
from schemas.messages import CommandAnswer, GraspGoal, Hold, Outcome, Prompt, Tail
from shared.recording.losses import AT


def session_tables(session: Session) -> list[Table]:
    """All tables of a session that have rows."""
    tables = (
        recorded(session),
        gaps(session),
        latencies(session),
        agents(session),
        drops(session),
        results(session),
        grasps(session),
        pulls(session),
        phases(session),
        commands(session),
        settings(session),
        remarks(session),
        noted(session),
        Table("how it was run", ("name", "value"), tuple(session.facts.items())),
    )
    return [table for table in tables if table.rows]


def head_lines(session: Session) -> list[str]:
    """What kind of recording it is, and what it lacks, in sentences."""
    began = datetime.fromtimestamp(session.start_ns * 1e-9, UTC).astimezone().strftime("%Y-%m-%d %H:%M:%S %z")
    count = sum(one.count for one in session.contents)
    lines = [f"{session.path}: {megabytes(session.size_bytes)} MB, {count} messages on {len(session.contents)} keys"]
    if count:
        lines.append(f"it began at {began} and lasted {session.duration_s:.1f} s")
    derived = [one.sentence for one in session.said.derived]
    return [*lines, *derived, session.damage or session.said.sentence, *_unreadable(session)]


def _unreadable(session: Session) -> list[str]:
    return [
        f"{one.unreadable} of {one.count} messages of {short(one.key)} cannot be read: {one.unreadable_reason}"
        for one in session.contents
        if one.unreadable
    ]


def recorded(session: Session) -> Table:
    """Counts and rates by key."""
    columns = (
        "key",
        " messages",
        " a second",
        " MB",
        " runs",
        " lost",
        " gaps",
        " longest s",
        " first published at s",
        " last published at s",
        "as of",
    )
    return Table(
        "recorded", columns, tuple(_recorded_row(session, one, _whose(session, one)) for one in session.contents)
    )


def _whose(session: Session, one: KeyContents) -> str:
    """Whether messages are a replay's, or of its source, where there was one."""
    anew = session.said.ran_anew.values()
    if not any(agent.keys for agent in anew):
        return ""
    of_key = [agent for agent in anew if one.key in agent.keys]
    kept_ns = {at_ns for agent in of_key for at_ns in agent.kept_ns}
    kept = sum(at_ns in kept_ns for at_ns in one.received_ns)
    if not of_key or kept == one.count:
        return "the source"
    return f"the replay, {kept} the source" if kept else "the replay"


def _recorded_row(session: Session, one: KeyContents, as_of: str) -> Row:
    longest_ns = max((gap.to_ns - gap.from_ns for gap in one.gaps), default=0)
    return (
        short(one.key),
        str(one.count),
        f"{one.rate_hz:.1f}" if one.rate_hz else "",
        megabytes(one.payload_bytes),
        str(one.runs),
        str(one.lost) if one.lost else "",
        str(len(one.gaps)) if one.gaps else "",
        f"{longest_ns * 1e-9:.2f}" if one.gaps else "",
        _seconds(session.since_start_s(one.first_ns)),
        _seconds(session.since_start_s(one.last_ns)),
        as_of,
    )


def settings(session: Session) -> Table:
    """What was set while it ran."""
    rows = (
        (
            "before" if one.at_ns is None else _seconds(session.since_start_s(one.at_ns)),
            one.agent,
            one.name,
            one.value,
            one.by,
            f"refused: {one.refused}" if one.refused else "set",
        )
        for one in session.settings
    )
    return Table("set while it ran", (" at s", "agent", "parameter", "value", "by", "answer"), tuple(rows))


def _seconds(value: float) -> str:
    """With two decimals, and no minus before a zero."""
    return f"{round(value, 2) + 0.0:.2f}"


def gaps(session: Session) -> Table:
    """Where numbers are missing or a key was silent, the longest first."""
    found = [(gap, short(one.key)) for one in session.contents for gap in one.gaps]
    found.sort(key=lambda pair: pair[0].from_ns - pair[0].to_ns)
    rows = (
        (
            key,
            f"{session.since_start_s(gap.from_ns):.2f}",
            f"{(gap.to_ns - gap.from_ns) * 1e-9:.3f}",
            str(gap.lost) if gap.lost else "silent",
        )
        for gap, key in found
    )
    return Table("gaps, the longest first", ("key", " published at s", " lasted s", " messages lost"), tuple(rows))


def latencies(session: Session) -> Table:
    """Percentiles of each stage, from capture and from the stage before."""
    rows: list[Row] = []
    for name, times in session.stages.items():
        before = session.stages.get(BEFORE.get(name, ""))
        added = percentiles(added_ms(before, times)) if before else ()
        own = (f"{added[0]:.1f}", f"{added[2]:.1f}") if added else ("", "")
        all_of_it = (f"{value:.1f}" for value in percentiles(times.latency_ms))
        rows.append((_as_of(session, name), str(len(times.captured)), f"{times.rate_hz:.1f}", *all_of_it, *own))
    columns = ("stage", " messages", " a second", " p50", " p90", " p99", " max", " added p50", " added p99")
    return Table("from capture until published, ms; added since the stage before", columns, tuple(rows))


def _as_of(session: Session, stage: str) -> str:
    """The name of a stage; where others ran anew, with whose times these are: nothing is published in a replay."""
    ran_anew = {name.partition("/")[0] for name in session.said.ran_anew}
    return f"{stage}, as recorded" if stage.partition("/")[0] in ran_anew else stage


def agents(session: Session) -> Table:
    """Step times as the agents report them."""
    rows = [
        (one.name, str(one.runs), decimal(one.step_ms_p50), decimal(one.step_ms_p99), one.version, one.host)
        for one in session.agents
    ]
    replays = [one for one in session.said.derived if one.agents]
    for number, derivation in enumerate(replays, 1):
        which = f" ({number} of {len(replays)})" if len(replays) > 1 else ""
        rows += [
            (
                f"{name}, replayed{which}",
                "1",
                decimal(one.step_ms_p50),
                decimal(one.step_ms_p99),
                derivation.version,
                "",
            )
            for name, one in derivation.agents.items()
        ]
    return Table("agents, times of a step", ("agent", " runs", " p50 ms", " p99 ms", "version", "host"), tuple(rows))


def drops(session: Session) -> Table:
    """Inputs of which something was left out."""
    rows = (
        (one.topic, one.agent, str(one.received), str(one.dropped), str(one.missed), str(one.refused))
        for agent in session.agents
        for one in agent.drops
        if one.dropped or one.missed or one.refused
    )
    columns = ("topic", "taken by", " taken", " left out for newer", " lost", " not readable")
    return Table("dropped", columns, tuple(sorted(rows)))


def results(session: Session) -> Table:
    """Failures of perception and reconstruction by reason, and what became of the track."""
    quality = session.quality
    rows = [(topic, str(count), "results") for topic, count in sorted(quality.results.items())]
    rows += [(topic, str(count), f"failed: {reason}") for (topic, reason), count in quality.failed.most_common()]
    rows += [("reconstruction/thread", str(count), f"track {step}") for step, count in quality.steps.most_common()]
    return Table("what became of the frames", ("topic", " count", "what"), tuple(rows))


def remarks(session: Session) -> Table:
    """Warnings, errors and faults."""
    rows = (
        (
            f"{session.since_start_s(one.first_ns):.2f}",
            session.clock(one.first_ns),
            str(one.count),
            one.agent,
            one.level.lower(),
            one.text,
        )
        for one in session.remarks
    )
    return Table(
        "warnings, errors and faults", (" first at s", "clock", " times", "agent", "level", "text"), tuple(rows)
    )


def noted(session: Session) -> Table:
    """What the recorder noted on its way: losses, marks, clocks."""
    rows = (
        (
            f"{session.since_start_s(int(note.facts[AT])):.2f}" if session.start_ns else "",
            note.name,
            ", ".join(f"{short(name)}: {text}" for name, text in note.facts.items() if name != AT),
        )
        for note in session.notes
        if is_of_a_moment(note)
    )
    return Table("noted by the recorder", (" at s", "note", "facts"), tuple(rows))


def grasps(session: Session) -> Table:
    """Each goal with its plan and how it ended."""
    rows = tuple(_grasp_row(session, number, grasp) for number, grasp in enumerate(session.grasps, 1))
    return Table("grasps", (" grasp", " at s", "goal", "plan", "came of it"), rows)


def _grasp_row(session: Session, number: int, grasp: Grasp) -> Row:
    at_s = f"{session.since_start_s(grasp.at_ns):.2f}"
    plan, ended = "not recorded" if grasp.plan is None else grasp.plan.in_words, grasp.ended
    # one row may hold a plan of today and what became of that of the session
    if session.said.ran_anew and grasp.plan is not None:
        anew = "planner" in _kinds_anew(session)
        if grasp.plan_before:
            anew = session.said.is_anew("planner", grasp.plan_ns or 0)
        plan += " (planned anew)" if anew else " (of the source)"
    if grasp.plan_before:
        plan += " (from before)"
    # why there is no plan is the planner's to say
    of_arm = ended and (grasp.armings or not (grasp.plan is not None and grasp.plan.reason))
    goal = "from before" if grasp.goal is None and grasp.plan_before else goal_text(grasp.goal)
    return str(number), at_s, goal, plan, ended + (_if_of_source(session) if of_arm else "")


def pulls(session: Session) -> Table:
    """Each goal to pull with what its tail came to, and why it ended."""
    rows = tuple(_pull_row(session, number, pull) for number, pull in enumerate(session.pulls, 1))
    columns = (" pull", " at s", "arm", " asked mm", " tail mm", " to mm", " segments", " grasps", "came of it")
    return Table("pulls", columns, rows)


def _pull_row(session: Session, number: int, pull: Pulled) -> Row:
    lengths = [tail_text(tail) for _, tail in pull.tails]
    return (
        str(number),
        f"{session.since_start_s(pull.at_ns):.2f}",
        pull.arm,
        "lets go" if pull.asked_m is None else f"{1e3 * pull.asked_m:.1f}",
        *(lengths[i] if lengths else "" for i in (0, -1)),
        str(len(pull.segments)),
        str(pull.grasps),
        pull.ended + _if_of_source(session),
    )


def tail_text(tail: Tail) -> str:
    """A tail's length with its interval, in millimetres."""
    assert tail.tail is not None  # noqa: S101 - those that were not measured are left out
    low_m, high_m = tail.tail.interval_m
    if high_m is None:
        return f"at least {1e3 * low_m:.1f}"
    return f"{1e3 * tail.tail.length_m:.1f} ({1e3 * low_m:.1f} to {1e3 * high_m:.1f})"


def _kinds_anew(session: Session) -> set[str]:
    return {name.partition("/")[0] for name in session.said.ran_anew}


def _if_of_source(session: Session) -> str:
    """What is added to what an arm did, where others ran anew and the arm did not."""
    kinds = _kinds_anew(session)
    return " (of the source)" if kinds and "robot_bridge" not in kinds else ""


def goal_text(goal: GraspGoal | None) -> str:
    """A goal in a few words."""
    if goal is None:
        return "not recorded"
    if goal.s is not None:
        where = f"s {goal.s:.3f}"
    elif goal.pixel is not None:
        where = f"pixel {goal.pixel[0]:.0f} {goal.pixel[1]:.0f}"
    elif goal.point_camera is not None:
        where = f"point {' '.join(f'{1e3 * x:.1f}' for x in goal.point_camera)} mm"
    else:
        where = f"{1e3 * (goal.from_swage_m or 0.0):.1f} mm from the swage"
    return f"{goal.arm} {where} {goal.policy.name.lower()}"


def phases(session: Session) -> Table:
    """Each arming with what followed, in seconds since the start of the recording."""
    rows = (
        *(_phase_row(session, str(n), arming) for n, grasp in enumerate(session.grasps, 1) for arming in grasp.armings),
        *(
            _phase_row(session, f"pull {n}", arming)
            for n, pull in enumerate(session.pulls, 1)
            for arming in pull.armings.values()
        ),
    )
    return Table("armed", (" grasp", " at s", "clock", "answer", "what followed, at s", "judgement"), tuple(rows))


def _phase_row(session: Session, name: str, arming: Arming) -> Row:
    followed = ", ".join(f"{event_name(event)} {session.since_start_s(event.at_ns):.2f}" for event in arming.events)
    at_s, clock = "", ""
    if arming.at_ns is not None:
        at_s, clock = f"{session.since_start_s(arming.at_ns):.2f}", session.clock(arming.at_ns)
    judged = arming.judgement.sentence + _if_of_source(session) if arming.judgement else ""
    return name, at_s, clock, answer_text(arming.answer), followed, judged


def commands(session: Session) -> Table:
    """Holds and prompts."""
    rows = (
        (f"{session.since_start_s(one.at_ns):.2f}", one.topic, _command_text(one.command), answer_text(one.answer))
        for one in session.other_commands
    )
    return Table("other commands", (" at s", "command", "of", "answer"), tuple(rows))


def _command_text(command: Hold | Prompt) -> str:
    if isinstance(command, Hold):
        return command.arm
    return "any thread" if command.pixel is None else f"pixel {command.pixel[0]:.0f} {command.pixel[1]:.0f}"


def answer_text(answer: CommandAnswer) -> str:
    """An answer with its reason."""
    if answer.outcome is Outcome.ACCEPTED:
        return "accepted"
    return f"{answer.outcome.name.lower()} ({answer.code}): {answer.reason}"
