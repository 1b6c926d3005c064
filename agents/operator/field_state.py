"""What is known of the field: image, thread, tools, tissue, plans, and what was said, as the page is told it."""

from collections import OrderedDict
from dataclasses import replace
from itertools import zip_longest
from typing import Any

from agents.operator.drawn import (
    DrawnThread,
    draw_correction,
    draw_observations,
    draw_plan,
    draw_surface,
    draw_thread,
    draw_tool,
)
from agents.operator.pictures import Resample
from agents.operator.subscriptions import Subscriptions
from agents.operator.surroundings import Surroundings
from agents.operator.wire import compact
from agents.operator.words import OUT_OF_ORDER, Seen, arm_words
from schemas.messages import (
    ExecutionEvent,
    ExecutionKind,
    GraspCheck,
    GraspPlan,
    LogRecord,
    PullBounds,
    RectifiedStereo,
    RobotMode,
    RobotState,
    Severity,
    StereoFrame,
    ThreadObservations,
    ThreadReconstruction,
    ToolCorrection,
    TrackStep,
)
from schemas.topics import CALIBRATION, FRAMES, OBSERVATIONS, ROBOT_STATE, SURFACE, THREAD, TOOL
from shared.clock import monotonic_s, now_ns

THREADS_KEPT = 90
OLDEST_S = 60.0
"""Plans from older frames are history that came with the connection, and are not shown."""


class FieldState:
    """The newest of everything; filled from `Subscriptions` by one thread at a time.

    Fields:
        found: how often a thread was found anew, after which s names other places; see `is_followed`.
        surface, observed: of which frame, and as text for pages.
        states: the newest of each arm, and when it came, by this host's monotonic clock.
    """

    def __init__(self, subscriptions: Subscriptions, around: Surroundings) -> None:
        self._subscriptions, self._around = subscriptions, around
        self.frame: StereoFrame | None = None
        self.resample: Resample | None = None
        self.camera: RectifiedStereo | None = None
        self.threads: OrderedDict[int, DrawnThread] = OrderedDict()
        self.thread: DrawnThread | None = None
        self.states: dict[str, tuple[RobotState, float]] = {}
        self._came_s: dict[str, float] = {}
        self._track: ThreadReconstruction | None = None
        self.found = 0
        self.surface: tuple[int, str] | None = None
        self.observed: tuple[int, str] | None = None
        self.judgements: list[dict[str, str]] = []
        self.plans: dict[str, dict[str, Any]] = {}
        self._bounds: dict[str, PullBounds] = {}
        self.checks: dict[str, str] = {}
        self._stops: dict[str, tuple[str, int]] = {}
        self._warnings: dict[str, tuple[str, int]] = {}
        self.done: dict[str, str] = {}
        self.refused: dict[str, str] = {}
        self.corrections: dict[str, ToolCorrection] = {}
        self._drawn_s = float("-inf")
        self._tools: tuple[list[Any], str] | None = None
        self.said = ""

    def take_calibration(self) -> None:
        """The newest calibration; may take a while."""
        for calibration in self._subscriptions.newest(CALIBRATION):
            self.resample = self._around.resample(calibration)

    def take_frame(self) -> StereoFrame | None:
        """The newest frame."""
        for frame in self._subscriptions.newest(FRAMES):
            self._came_s["frame"] = monotonic_s()
            self.frame = frame
        return self.frame

    def take_thread(self, after_s: float) -> None:
        """The newest thread, as it is drawn; not where one was drawn less than `after_s` before."""
        now_s = monotonic_s()
        if now_s - self._drawn_s < after_s:
            return
        for thread in self._subscriptions.newest(THREAD):
            self.camera, self._drawn_s, self._came_s["thread"] = thread.camera, now_s, now_s
            self.found += not is_followed(self._track, thread)
            self._track = thread
            drawn = draw_thread(thread)
            self.said = "" if drawn is not None else thread.reason
            if drawn is None:
                self.thread = None
                continue
            self.thread = self.threads[drawn.frame] = replace(drawn, found=self.found)
            while len(self.threads) > THREADS_KEPT:
                self.threads.popitem(last=False)

    def take_states(self) -> None:
        """The newest state of each arm."""
        for state in self._subscriptions.newest(ROBOT_STATE):
            self.states[state.arm] = state, monotonic_s()
        for correction in self._subscriptions.newest(TOOL):
            self.corrections[correction.arm] = correction

    def newest_challenge(self, arm: str) -> int:
        """Of an arm's bridge; 0 where none was heard."""
        state, _ = self.states.get(arm, (None, 0))
        return 0 if state is None else state.challenge_ns

    def sight(self, arm: str, at_ns: int | None = None) -> dict[str, Any]:
        """What a page judges its picture by, before it answers a challenge: the time by the clock of the arm's bridge.

        Args:
            at_ns: the bridge's challenge; without one, the newest that was heard and how long ago that was.
        """
        state, heard_s = self.states.get(arm, (None, 0.0))
        if at_ns is None:
            newest_ns = self.newest_challenge(arm)
            at_ns = newest_ns and newest_ns + round((monotonic_s() - heard_s) * 1e9)
        return {
            "arm": arm,
            # numbers of a browser do not hold nanoseconds since 1970
            "at_ns": str(at_ns),
            "limit_ms": 0 if state is None else round(1e3 * state.maximum_frame_age_s),
            "real": state is None or state.is_real,
        }

    def take_surface(self) -> None:
        """The newest surface of the tissue."""
        for surface in self._subscriptions.newest(SURFACE):
            self.camera = self.camera or surface.camera
            self.surface = surface.stamp.sequence, compact(draw_surface(surface))

    def take_observations(self) -> None:
        """What perception saw last, and what it says of its input."""
        for observations in self._subscriptions.newest(OBSERVATIONS):
            self.observed = observations.stamp.sequence, compact(draw_observations(observations))
            self.judgements = _judgements(observations)

    def note_plan(self, plan: GraspPlan) -> bool:
        """Keep a plan; False where it is long past."""
        age_s = (now_ns() - plan.stamp.capture_left_ns) * 1e-9
        if age_s > OLDEST_S or self.camera is None:
            return False
        drawn, last = draw_plan(plan, self.camera), self.plans.get(plan.arm)
        # what was found after a miss is why there is another plan for the same goal
        if last is None or last["goal_id"] != plan.goal_id:
            self.checks.pop(plan.arm, None)
        self._came_s[f"plan {plan.arm}"] = monotonic_s()
        self.plans[plan.arm] = drawn | {"captured_ms": plan.stamp.capture_left_ns * 1e-6}
        self._bounds.pop(plan.arm, None)
        if plan.pull is not None and plan.pull.bounds is not None:
            self._bounds[plan.arm] = plan.pull.bounds
        return True

    def pull_bounds(self, arm: str, plan_id: str) -> PullBounds | None:
        """Within which bounds that plan is armed, which pages show; None where it is no pull, or not the newest."""
        plan = self.plans.get(arm)
        return self._bounds.get(arm) if plan is not None and plan["id"] == plan_id else None

    def note_check(self, check: GraspCheck) -> bool:
        """Keep what a look after a grasp found; False where it is of no goal whose plan is shown."""
        plan = self.plans.get(check.arm)
        if plan is None or check.goal_id != plan["goal_id"]:
            return False
        self.checks[check.arm] = check.sentence
        return True

    def note_execution(self, event: ExecutionEvent) -> None:
        """Keep why an arm was stopped last, until it is armed again, and which plan it carried out last."""
        if event.kind is ExecutionKind.FINISHED:
            self.done[event.arm] = event.plan_id
        stopped = event.kind in (ExecutionKind.HELD, ExecutionKind.REFUSED)
        self._stops[event.arm] = event.reason if stopped else "", event.at_ns
        self.refused.pop(event.arm, None)
        if event.kind is ExecutionKind.REFUSED:
            self.refused[event.arm] = event.plan_id

    def note_warning(self, record: LogRecord) -> None:
        """Keep what an arm's bridge warned of last: an arm that gets a fault while it is disarmed ends no plan."""
        self._warnings[record.instance] = record.text.splitlines()[0].rstrip("."), record.at_ns

    def why(self, arm: str) -> str:
        """Why an arm was stopped last, or what is wrong with it since; empty where nobody said."""
        stopped = self._stops.get(arm, ("", 0))
        warned = self._warnings.get(arm, ("", 0)) if self.mode(arm) in OUT_OF_ORDER else ("", 0)
        return max(stopped, warned, key=lambda told: told[1])[0]

    def arms(self) -> list[str]:
        """Arms that are configured or that report."""
        return sorted({*self._around.arms, *self.states})

    def tools(self) -> str:
        """Every arm's jaw, as text for pages; an arm that rests tells of itself more rarely than a camera does."""
        camera = self.camera
        if camera is None:
            return "[]"
        told = [(state, self.corrections.get(arm)) for arm, (state, _) in list(self.states.items())]
        made_of = [camera, *(each for pair in told for each in pair)]
        if self._tools is None or any(a is not b for a, b in zip_longest(self._tools[0], made_of)):
            self._tools = made_of, compact([draw_tool(state, camera) | draw_correction(found) for state, found in told])
        return self._tools[1]

    def mode(self, arm: str) -> str:
        """What an arm is doing; empty where it has not been heard lately."""
        state, heard_s = self.states.get(arm, (None, 0.0))
        if state is None or monotonic_s() - heard_s > 2.0:
            return ""
        return state.mode.name.lower()

    def moves(self, arm: str) -> bool:
        """Whether an arm is carrying something out."""
        state, _ = self.states.get(arm, (None, 0))
        return state is not None and state.mode is RobotMode.MOVING

    def arms_told(self) -> list[dict[str, Any]]:
        """Each arm, what it is doing in words, and what a page judges its picture by."""
        told: list[dict[str, Any]] = []
        for arm in self.arms():
            state, mode = self.states.get(arm, (None, 0))[0], self.mode(arm)
            words = arm_words(mode, self.why(arm), state, self.corrections.get(arm))
            told.append({"mode": mode, "words": words} | self.sight(arm))
        return told

    def is_done(self, plan: dict[str, Any] | None) -> bool:
        """Whether a plan was carried out, which it is once."""
        return plan is not None and self.done.get(plan["arm"]) == plan["id"]

    def seen(self, arm: str) -> Seen:
        """What sentences are made of."""
        plan = self.plans.get(arm)
        return Seen(
            frame_age_s=None if self.frame is None else self._age_s("frame", self.frame.stamp.capture_left_ns),
            thread_age_s=None if self.thread is None else self._age_s("thread", self.thread.capture_ns),
            mode=self.mode(arm),
            plan=plan,
            plan_age_s=None if plan is None else self._age_s(f"plan {arm}", round(plan["captured_ms"] * 1e6)),
            said=self.said,
            why=self.why(arm),
            done=self.is_done(plan),
            refused=plan is not None and self.refused.get(arm) == plan["id"],
        )

    def _age_s(self, what: str, captured_ns: int) -> float:
        """How old something is: no younger than since it came, whatever a clock that was set back says."""
        return max((now_ns() - captured_ns) * 1e-9, monotonic_s() - self._came_s[what])


def is_followed(before: ThreadReconstruction | None, thread: ThreadReconstruction) -> bool:
    """Whether s names the same places on a thread as on the one that was taken before it.

    Not all that came between was taken: what is not followed for certain counts as found anew. Of threads that nobody
    follows from frame to frame nothing is known, and the planner takes those too.
    """
    if before is None or before.track is None or thread.track is None:
        return True
    if thread.track.step in (TrackStep.STARTED, TrackStep.RESTARTED):
        return False
    since = thread.stamp.sequence - before.stamp.sequence
    return thread.track.frames >= since and thread.track.frames > before.track.frames


def _judgements(observations: ThreadObservations) -> list[dict[str, str]]:
    told = [
        {"code": j.code, "severity": j.severity.name.lower(), "finding": j.finding, "remedy": j.remedy}
        for j in observations.judgements
        if j.severity is not Severity.NOTE
    ]
    if observations.reason:
        told.insert(0, {"code": "none", "severity": "fault", "finding": observations.reason, "remedy": ""})
    return told
