"""What a replay of the shipped session is said to change, in words."""

from pathlib import Path

from agents.cli.recordings.options import Recompute
from agents.cli.recordings.recompute import replayed
from agents.cli.recordings.recompute_report import report, table
from agents.replay.differences import At, Compared, Comparison
from schemas.topics import PLAN, THREAD

SESSION = Path(__file__).parents[2] / "docs" / "example" / "session.mcap"


def told(*settings, through="planner"):
    return [line.strip() for line in report(replayed(Recompute(SESSION, through=through, set=settings)))]


def test_another_bound_of_the_planner_is_told_as_another_plan():
    (plan,) = [line for line in told("planner.least_probability=0.85") if line.startswith("once ")]
    before, after = plan.removeprefix("once ").split(" → ")
    assert before.startswith("capture ") and before.endswith("success 85%")
    assert after.startswith("capture ") and after != before


def test_what_the_older_version_did_not_know_is_named_and_is_no_difference():
    lines = told()
    (untold,) = [line for line in lines if line.startswith("empty as another version made it")]
    assert {"attempts", "around", "tissue"} <= set(untold.partition(": ")[2].split(", "))
    assert not [line for line in lines if line.startswith(("attempts", "around", "tissue"))]


def test_changes_that_differ_in_figures_alone_are_counted_together_and_told_without_any_one_s():
    at = At(0, None, None)
    said = ["ok → failed: both eyes see 77%", "ok → failed: both eyes see 72%", "ok → failed: no thread"]
    outputs = tuple(Compared(str(THREAD), at, False, (), words, True) for words in said)
    plans = [
        "capture 0.3, success 92% → capture 0.3, success 93%",
        "capture 0.8, success 95% → capture 0.8, success 94%",
    ]
    outputs += tuple(Compared(str(PLAN), at, False, (), words) for words in plans)
    lines = table(Comparison(outputs, (), 0, 0), 0)
    # a change that is one of figures is told with them
    assert all(f"  once {words}" in lines for words in plans)
    assert "  2 times ok → failed: both eyes see #%" in lines
    assert "  once ok → failed: no thread" in lines
