"""Does the fast geometric judge say what contact physics says, and does that say the same with finer steps?

    .venv/bin/python -m benchmarks.grasp_physics                        (needs the extra sim: make sim)
    .venv/bin/python -m benchmarks.grasp_physics --converge

Random fields of all five configurations, goals anywhere along their threads, direct grasps and slides in turn, and
errors of the tool of 0 to 4 mm in any direction. The same motion is judged by both.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from agents.simulator.contact.material import SUTURE
from agents.simulator.contact.physics import ContactPhysics
from agents.simulator.geometric import GeometricPhysics
from agents.simulator.outcome import MeasuredArm, Outcome, Physics
from benchmarks.grasp_physics_trials import CONFIGS, ERROR_BINS_MM, PERIOD_S, Trial, drawn_field, trials_of
from schemas.messages import Verdict

FIRST_SEED = 500
VERDICTS = (Verdict.HELD, Verdict.LOST, Verdict.MISSED)
NO_LIMIT_N = 1e3
"""So that verdicts are compared, which the geometric judge gives without forces; the forces are told beside them."""
CONSOLE = Console(width=140)
Z = 1.96


@dataclass(frozen=True)
class Judged:
    """One trial, judged twice.

    Fields:
        error_mm: of the tool. `seconds`, `stepped_s`: of the motion, and of those computed by contact.
    """

    config: str
    seed: int
    goal: int
    policy: str
    error_mm: float
    seconds: float
    stepped_s: float
    contact: str
    contact_code: str
    geometric: str
    geometric_code: str
    force_n: float
    slipped_mm: float | None


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fields", type=int, default=4, help="of each configuration")
    parser.add_argument("--goals", type=int, default=10, help="on each of them")
    parser.add_argument("--seed", type=int, default=FIRST_SEED, help="of the first of them")
    parser.add_argument("--converge", action="store_true", help="compare finer steps instead of the geometric judge")
    parser.add_argument("--json", type=Path, default=Path("out/grasp_physics.json"), help="where the figures go")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    seeds = range(arguments.seed, arguments.seed + arguments.fields)
    if arguments.converge:
        print_converged(converged(seeds, arguments.goals))
        return
    found = [one for seed in seeds for config in CONFIGS for one in of_field(config, seed, arguments.goals)]
    print_found(found)
    arguments.json.parent.mkdir(parents=True, exist_ok=True)
    arguments.json.write_text(json.dumps([asdict(one) for one in found], indent=1) + "\n")


def of_field(config: str, seed: int, goals: int) -> Iterator[Judged]:
    """All trials on one field."""
    contact = ContactPhysics(drawn_field(config, seed), NO_LIMIT_N)
    field = contact.field
    for trial in trials_of(field, config, seed, goals):
        contact.lay()
        before_s = contact.stepped_s
        by_contact, by_geometry = judged(contact, trial), judged(GeometricPhysics(field), trial)
        slipped_m = by_contact.slipped_m
        yield Judged(
            config=config,
            seed=seed,
            goal=trial.goal,
            policy=trial.policy.name.lower(),
            error_mm=float(np.linalg.norm(trial.error_mm)),
            seconds=PERIOD_S * len(trial.jaw_rad),
            stepped_s=contact.stepped_s - before_s,
            contact=by_contact.verdict.name,
            contact_code=by_contact.code,
            geometric=by_geometry.verdict.name,
            geometric_code=by_geometry.code,
            force_n=by_contact.peak_tissue_force_n or 0.0,
            slipped_mm=None if slipped_m is None else 1e3 * slipped_m,
        )


def judged(physics: Physics, trial: Trial) -> Outcome:
    """What becomes of a trial; where the motion ends before it is settled, what it would be then."""
    outcome = None
    for i, (T_camera_tool, jaw_rad) in enumerate(zip(trial.T_camera_tool, trial.jaw_rad, strict=True), 1):
        outcome = physics.follow(MeasuredArm("psm1", "p", T_camera_tool, float(jaw_rad), round(1e9 * PERIOD_S * i)))
        if outcome.settled:
            break
    assert outcome is not None
    return outcome


def converged(seeds: range, goals: int) -> Iterator[tuple[str, str, str]]:
    """Verdicts as usual, at half the time step, and with segments of half the length."""
    finer = (replace(SUTURE, step_s=0.5 * SUTURE.step_s), replace(SUTURE, segment_mm=0.5 * SUTURE.segment_mm))
    for seed in seeds:
        for config in CONFIGS:
            drawn = drawn_field(config, seed)
            usual = ContactPhysics(drawn, NO_LIMIT_N)
            others = [ContactPhysics(drawn, NO_LIMIT_N, material) for material in finer]
            for trial in trials_of(usual.field, config, seed, goals):
                for physics in (usual, *others):
                    physics.lay()
                one, two, three = (judged(physics, trial).verdict.name for physics in (usual, *others))
                yield one, two, three


def print_found(found: list[Judged]) -> None:
    """The agreement as a whole, by error, and by policy and configuration."""
    whole = Table(title="Verdicts: rows by contact, columns by geometry", title_justify="left")
    for column in ("", *(verdict.name.lower() for verdict in VERDICTS)):
        whole.add_column(column, justify="right")
    for row in VERDICTS:
        own = [one for one in found if one.contact == row.name]
        whole.add_row(row.name.lower(), *(str(sum(one.geometric == column.name for one in own)) for column in VERDICTS))
    CONSOLE.print(whole)
    table = Table(title="Agreement (Wilson's interval at 95 %)", title_justify="left")
    for column in ("", "trials", "held by contact", "held by geometry", "same verdict", "held or not, the same"):
        table.add_column(column, justify="right")
    bins = list(pairwise(ERROR_BINS_MM))
    groups = [("all", found)]
    groups += [(f"{low:g} to {high:g} mm", [one for one in found if low <= one.error_mm < high]) for low, high in bins]
    for name in ("direct", "capture_slide_grasp"):
        groups.append((name, [one for one in found if one.policy == name]))
    for name in CONFIGS:
        groups.append((name, [one for one in found if one.config == name]))
    for name, group in groups:
        if group:
            table.add_row(name, str(len(group)), *shares(group))
    CONSOLE.print(table)
    force = np.array([one.force_n for one in found])
    stepped = sum(one.stepped_s for one in found) / max(sum(one.seconds for one in found), 1e-9)
    CONSOLE.print(
        f"force on tissue: median {np.median(force):.2f} N, 95 % {np.percentile(force, 95):.2f} N, "
        f"most {force.max():.2f} N; {stepped:.0%} of the time of motions was computed"
    )


def shares(group: list[Judged]) -> tuple[str, str, str, str]:
    """Held by each judge, the same verdict, and the same in whether it is held."""
    held = Verdict.HELD.name
    return (
        wilson([one.contact == held for one in group]),
        wilson([one.geometric == held for one in group]),
        wilson([one.contact == one.geometric for one in group]),
        wilson([(one.contact == held) == (one.geometric == held) for one in group]),
    )


def wilson(hits: list[bool]) -> str:
    """A share with its interval."""
    n, share = len(hits), sum(hits) / len(hits)
    middle = (share + Z**2 / (2 * n)) / (1 + Z**2 / n)
    half = Z / (1 + Z**2 / n) * np.sqrt(share * (1 - share) / n + Z**2 / (4 * n**2))
    return f"{share:.1%} ({max(middle - half, 0.0):.1%} to {min(middle + half, 1.0):.1%})"


def print_converged(found: Iterator[tuple[str, str, str]]) -> None:
    """How often finer steps change nothing, told anew after every trial: each takes most of a minute."""
    told: list[tuple[str, str, str]] = []
    for one in found:
        told.append(one)
        CONSOLE.print(f"{len(told)} trials ({', '.join(one)}); verdicts that stay the same:")
        CONSOLE.print(f"  half the time step      {wilson([usual == half for usual, half, _ in told])}")
        CONSOLE.print(f"  half the segment length {wilson([usual == half for usual, _, half in told])}")


if __name__ == "__main__":
    main()
