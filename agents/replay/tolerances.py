"""How much the outputs of two versions or settings may differ before it counts, by message type and field.

Chosen between two figures, both of which `docs/recordings.md` has with their commands: what another processor makes
of the same session (well below), and what a small but real change makes of it (above). Fields without a rule must be
the same. Of one version and installation everything must be: there these rules only say how differences are shown.
"""

from dataclasses import replace

from agents.replay import measures
from agents.replay.compare import Rule, Rules
from schemas.messages import (
    GraspCheck,
    GraspPlan,
    RobotState,
    SimulatorState,
    Tail,
    ThreadObservations,
    ThreadReconstruction,
    TissueSurface,
)

CONSUMED = {"consumed": Rule(ignored="it says what the output was made from, which a replay repeats as it was")}


def _centrelines(side: str) -> dict[str, Rule]:
    return {
        f"{side}.point_px": Rule(0.1, "px", measures.most_apart),
        f"{side}.width_px": Rule(0.05, "px", measures.medians_apart),
        f"{side}.deviation_px": Rule(0.02, "px", measures.medians_apart),
        f"{side}.piece": Rule(ignored="where pieces are cut depends on single pixels; their points are compared"),
    }


def _trail(side: str) -> dict[str, Rule]:
    return {
        f"{side}.{name}": Rule(ignored="what the next frame is followed by; its centrelines are compared")
        for name in ("loose_start", "loose_end", "length_px", "colour_bgr", "told_start", "told_end")
    }


_OBSERVATIONS: dict[str, Rule] = {
    "points": Rule(0.5, "mm", measures.points_apart_mm, told=measures.told("points_camera", "points")),
    "points_camera": Rule(ignored="compared as `points`: a line may have other corners"),
    "half_size_px": Rule(ignored="one for each point, of which there may be others"),
    "matched_px": Rule(ignored="tens of thousands, of which the points are the sum"),
    "match_cost": Rule(ignored="one for each matched pixel"),
    "inlier": Rule(ignored="one for each matched pixel"),
    "gaps": Rule(0.0, "gaps", measures.counts_apart),
    "mask_left": Rule(5e-4, "share", measures.images_apart),
    "mask_right": Rule(5e-4, "share", measures.images_apart),
    "judgements": Rule(0.0, "", measures.findings_apart),
    "reason": Rule(0.0, "", measures.words_apart),
    "prompt_px": Rule(0.5, "px"),
    "picture_left": Rule(0.0, "", measures.same_or_other),
    "picture_right": Rule(0.0, "", measures.same_or_other),
    "candidates": Rule(0.0, "threads", measures.counts_apart),
    "occluders.left": Rule(5e-3, "share", measures.images_apart),
    "occluders.right": Rule(5e-3, "share", measures.images_apart),
    "score_map": Rule(0.02, "share", measures.images_apart),
    **_centrelines("centrelines_left"),
    **_centrelines("centrelines_right"),
    **_trail("trail_left"),
    **_trail("trail_right"),
}

_CURVE = measures.told("control_points_camera", "control points")

_RECONSTRUCTION: dict[str, Rule] = {
    "curve": Rule(0.1, "mm", measures.curves_apart_mm, told=_CURVE),
    "ends": Rule(0.2, "mm", measures.ends_apart_mm, told=_CURVE),
    "deviation": Rule(0.15, "mm", measures.deviation_apart_mm, told=measures.told("posterior_s", "places")),
    "confidence_along_s": Rule(0.1, "", measures.confidence_apart, told=measures.told("confidence_s", "places")),
    "knots": Rule(ignored="compared as `curve`: one curve has many descriptions"),
    "control_points_camera": Rule(ignored="compared as `curve`"),
    "posterior_s": Rule(ignored="compared as `deviation`"),
    "posterior_covariance": Rule(ignored="compared as `deviation`"),
    "confidence_s": Rule(ignored="compared as `confidence_along_s`"),
    "confidence": Rule(ignored="compared as `confidence_along_s`"),
    "regions": Rule(ignored="what the curve was made from, not what it is"),
    "track.innovation": Rule(0.2, ""),
    "track.found_share": Rule(0.05, "share"),
    "track.reason": Rule(0.0, "", measures.words_apart),
    "track.smoothing": Rule(ignored="a part of the fit, whose curve is compared"),
    "track.span_weight": Rule(ignored="a part of the fit, whose curve is compared"),
    "track.covariance": Rule(ignored="compared as `deviation`"),
    "track.knots": Rule(ignored="compared as `curve`"),
    "track.control_points_camera": Rule(ignored="compared as `curve`"),
    "track.row_offset_px": Rule(0.05, "px"),
    "track.row_slopes_px": Rule(0.5, "px"),
    "track.velocity_camera": Rule(ignored="two curves, which are compared as `curve`, apart"),
    "track.length": Rule(0.02, "share", measures.relative),
    "track.material_s": Rule(0.02, "s"),
    "unseen": Rule(0.03, "s", measures.stretches_apart),
    "crossings": Rule(0.02, "s", measures.crossings_apart),
    "other_threads_px": Rule(0.0, "threads", measures.counts_apart),
    "other_threads": Rule(0.0, "threads", measures.counts_apart),
    "hidden": Rule(0.03, "s", measures.stretches_apart),
    "left_over_share": Rule(0.02, "share"),
    "course.joins": Rule(0.02, "s", measures.stretches_apart),
    "course.probability": Rule(ignored="of joins, which are compared"),
    "course.other": Rule(ignored="what was less likely"),
    "left_over_px": Rule(ignored="where what `left_over_share` says lies"),
    "reason": Rule(0.0, "", measures.words_apart),
}

_PLAN: dict[str, Rule] = {
    "tool_path": Rule(0.5, "mm", measures.tool_paths_apart_mm, told=measures.told("waypoints", "waypoints")),
    "tool_turned": Rule(5.0, "deg", measures.tool_turned_deg, told=measures.phases_told),
    "waypoints": Rule(ignored="compared as `tool_path` and `tool_turned`"),
    "alternatives": Rule(ignored="what was not chosen; that shows in `s_capture` and `probability`"),
    "s_goal": Rule(0.01, "s"),
    "s_capture": Rule(0.02, "s"),
    "probability": Rule(0.05, ""),
    "slide_m": Rule(0.5, "mm", measures.metres_in_mm),
    "tissue.clearance_m": Rule(0.5, "mm", measures.metres_in_mm),
    "tissue.deviation_m": Rule(0.2, "mm", measures.metres_in_mm),
    "tissue.known_share": Rule(0.05, "share"),
    "tissue.unchecked": Rule(0.0, "", measures.words_apart),
    "tissue.place_camera": Rule(ignored="of places that are about as near another one may be the nearest"),
    "tissue.phase": Rule(ignored="likewise"),
    "tissue.s": Rule(ignored="likewise"),
    "reason": Rule(0.0, "", measures.words_apart),
    "thread.clearance_m": Rule(0.5, "mm", measures.metres_in_mm),
    "thread.obstructed": Rule(0.0, "", measures.words_apart),
    "thread.place_camera": Rule(ignored="of places that are about as near another one may be the nearest"),
    "thread.phase": Rule(ignored="likewise"),
    "thread.s": Rule(ignored="likewise"),
    "around.s": Rule(1e-9, "s"),
    "around.points_camera": Rule(ignored="the thread that was planned on, which is compared where it is made"),
    "around.covariance": Rule(ignored="likewise"),
    "depth_m": Rule(1.0, "mm", measures.metres_in_mm),
    "offset_camera": Rule(0.0005, "m"),
    "offset_covariance": Rule(1e-6, "m²"),
}

_CHECK: dict[str, Rule] = {
    "tool_moved_m": Rule(0.2, "mm", measures.metres_in_mm),
    "thread_moved_m": Rule(0.5, "mm", measures.metres_in_mm),
    "deviation_m": Rule(0.3, "mm", measures.metres_in_mm),
    "held_probability": Rule(0.05, ""),
    "sentence": Rule(ignored="the same in words"),
}

_TAIL: dict[str, Rule] = {
    "tail.length_m": Rule(0.5, "mm", measures.metres_in_mm),
    "tail.deviation_m": Rule(0.3, "mm", measures.metres_in_mm),
    "ran_m": Rule(0.5, "mm", measures.metres_in_mm),
    "travelled_m": Rule(0.5, "mm", measures.metres_in_mm),
    "sentence": Rule(ignored="the same in words"),
}

_SURFACE: dict[str, Rule] = {
    "typical_depth": Rule(0.2, "mm", measures.depths_apart_mm, told=measures.cells_told),
    "depth": Rule(ignored="compared as `typical_depth`: single cells may be matched otherwise"),
    "valid": Rule(ignored="single cells may be matched otherwise"),
    "deviation": Rule(ignored="likewise"),
}

_ROBOT: dict[str, Rule] = {
    "T_base_tool": Rule(1e-6, "m or 1"),
    "joints": Rule(1e-6, "rad or m"),
    "jaw_rad": Rule(1e-6, "rad"),
    "jaw_zero_rad": Rule(ignored="of the instrument of a real arm, which no replay reaches"),
    "jaw_set_point_rad": Rule(ignored="likewise"),
    "jaw_effort": Rule(ignored="likewise"),
    "instrument": Rule(ignored="likewise"),
}

_FIELD: dict[str, Rule] = {
    "control_points_camera": Rule(1e-6, "m"),
    "knots": Rule(1e-9, ""),
    "held": Rule(1e-6, "s"),
}

TOLERANCES: dict[type, dict[str, Rule]] = {
    ThreadObservations: _OBSERVATIONS,
    TissueSurface: _SURFACE,
    ThreadReconstruction: _RECONSTRUCTION,
    GraspPlan: _PLAN,
    GraspCheck: _CHECK,
    Tail: _TAIL,
    RobotState: _ROBOT,
    SimulatorState: _FIELD,
}


def tolerant(message: type) -> Rules:
    """The rules for comparing versions and settings."""
    return {**TOLERANCES.get(message, {}), **CONSUMED}


def exact(message: type) -> Rules:
    """The rules for one version: nothing may differ, and what differs is shown as it is, and as what it stands for."""
    stated = set(message.__dataclass_fields__)
    shown = {
        n: replace(r, tolerance=0.0) for n, r in TOLERANCES.get(message, {}).items() if n not in stated and "." not in n
    }
    return {**shown, **CONSUMED}
