"""What the trials of pulling come to: counts with Wilson's intervals, and why some failed."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from agents.simulated_trials.pulling.protocol import WITHIN_MM, PullCame, PullProtocol
from shared.success_rates import Interval, wilson


@dataclass(frozen=True)
class Share:
    """So many of so many, with Wilson's interval of 95 %; frames of one trial share its scene: believe it less."""

    what: str
    count: int
    of: int

    @property
    def interval(self) -> Interval | None:
        """None of nothing."""
        return wilson(self.count, self.of)


def shares(came: Sequence[PullCame]) -> list[Share]:
    """What is judged of trials."""
    tried = [one for one in came if one.outcome != "declined"]
    # a knot may keep the tail from becoming so short: then it is right to give up
    free = [one for one in tried if one.knot is None or one.knot < one.asked - WITHIN_MM]
    reached = [one for one in tried if one.code in ("COMPLETED", "WRONG_LENGTH") or one.wrongly_told]
    ended = [one for one in tried if one.end_covered is not None]
    return [
        Share("completed, of pulls that no knot prevents", _count(free, "completed"), len(free)),
        Share(f"true tail within {WITHIN_MM:g} mm at the end, of the same", sum(map(_is_right, free)), len(free)),
        Share("pulled out", sum(one.pulled_out for one in tried), len(tried)),
        Share("more force on the tissue than allowed", _coded(tried, "FORCE_EXCEEDED"), len(tried)),
        Share("told right and is not, of those told right", sum(one.wrongly_told for one in reached), len(reached)),
        Share("95 % interval at the end has the tail in it", sum(bool(o.end_covered) for o in ended), len(ended)),
        Share("95 % interval has it, of frames", sum(o.covered for o in came), sum(o.measured for o in came)),
        Share("tail told, of frames", sum(o.measured for o in came), sum(o.frames for o in came)),
        Share("declined, of all", len(came) - len(tried), len(came)),
    ]


def overview(protocol: PullProtocol, came: Sequence[PullCame]) -> str:
    """Everything in Markdown."""
    instrument = "; images show the instrument" if protocol.instrument else ""
    lines = [
        "# Pulling a thread through tissue",
        "",
        f"{protocol.trials} pulls by `{protocol.puller}`, seed {protocol.seed}; errors: tool tip "
        f"{protocol.tool_error_mm:g} mm on each axis, registration up to {protocol.hand_eye_mm:g} mm and "
        f"{protocol.hand_eye_deg:g} degrees; at most {protocol.force_limit_n:g} N on the tissue{instrument}.",
        "",
        "| | count | share | 95 % |",
        "|---|---|---|---|",
        *map(_row, shares(came)),
        "",
    ]
    done = [one for one in came if one.outcome == "completed"]
    if done:
        off = np.array([one.tail - one.asked for one in done])
        lines += [
            f"Completed pulls: tail {off.mean():+.2f} mm off on average, {np.abs(off).max():.2f} mm at most; "
            f"{np.mean([one.took_s for one in done]):.0f} s, force on tissue median "
            f"{np.median([one.peak_force for one in done]):.2f} N, most {max(one.peak_force for one in done):.2f} N.",
            "",
        ]
    causes = Counter(one.code for one in came if one.outcome == "failed")
    if causes:
        lines += ["Why pulls failed: " + ", ".join(f"{code} {count}" for code, count in causes.most_common()) + ".", ""]
    failed = [one for one in came if one.outcome != "completed"]
    lines += [f"- {one.trial.name}: {one.outcome}, {one.code}: {one.sentence}" for one in failed]
    return "\n".join(lines).rstrip() + "\n"


def document(protocol: PullProtocol, came: Sequence[PullCame]) -> dict[str, object]:
    """The same for programs."""
    told = [{**asdict(share), "interval": share.interval} for share in shares(came)]
    return {
        "protocol": protocol.model_dump(),
        "shares": told,
        "trials": [one.model_dump(exclude_none=True) for one in came],
    }


def _row(share: Share) -> str:
    interval = share.interval
    if interval is None:
        return f"| {share.what} | 0 of 0 | - | - |"
    low, high = (100 * bound for bound in interval)
    of = f"{share.count} of {share.of}"
    return f"| {share.what} | {of} | {100 * share.count / share.of:.1f} % | {low:.1f} to {high:.1f} % |"


def _count(came: Sequence[PullCame], outcome: str) -> int:
    return sum(one.outcome == outcome for one in came)


def _coded(came: Sequence[PullCame], code: str) -> int:
    return sum(one.code == code for one in came)


def _is_right(one: PullCame) -> bool:
    return abs(one.tail - one.asked) <= WITHIN_MM
