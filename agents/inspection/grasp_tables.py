"""What became of goals, as tables of text."""

from agents.inspection.grasps import Arming, Grasp, event_name
from agents.inspection.session import Session
from agents.inspection.table import Row, Table
from schemas.messages import CommandAnswer, GraspGoal, Hold, Outcome, Prompt


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
    return str(number), at_s, goal, plan, ended + (_as_of(session) if of_arm else "")


def _kinds_anew(session: Session) -> set[str]:
    return {name.partition("/")[0] for name in session.said.ran_anew}


def _as_of(session: Session) -> str:
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
        _phase_row(session, number, arming)
        for number, grasp in enumerate(session.grasps, 1)
        for arming in grasp.armings
    )
    return Table("armed", (" grasp", " at s", "clock", "answer", "what followed, at s", "judgement"), tuple(rows))


def _phase_row(session: Session, number: int, arming: Arming) -> Row:
    followed = ", ".join(f"{event_name(event)} {session.since_start_s(event.at_ns):.2f}" for event in arming.events)
    at_s, clock = "", ""
    if arming.at_ns is not None:
        at_s, clock = f"{session.since_start_s(arming.at_ns):.2f}", session.clock(arming.at_ns)
    judged = arming.judgement.sentence + _as_of(session) if arming.judgement else ""
    return str(number), at_s, clock, answer_text(arming.answer), followed, judged


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
