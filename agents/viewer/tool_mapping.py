"""Where an arm's instrument is in the images as Rerun shows it, over both images and as curves in millimetres.

world/left/tool/{arm}/registered    its outline by registration and joints alone
world/left|right/tool/{arm}/found   its outline with the correction
tool/off/{arm}, deviation/{arm}     how far the tip is from where it is registered, and how sure that is, mm
lanes/tool_{arm}                    searched for, followed, lost
"""

import numpy as np
import rerun as rr
from jaxtyping import Float64

from agents.viewer import colours
from agents.viewer.entity import Entity
from agents.viewer.session_mapping import lane, said
from agents.viewer.units import MM_PER_METRE
from schemas.messages import ToolCorrection, ToolStatus

LANES = {ToolStatus.CONVERGING: "started", ToolStatus.CONVERGED: "ok", ToolStatus.LOST: "lost"}
RADIUS_PX = 1.5


def tool_entities(told: ToolCorrection, changed: bool) -> list[Entity]:
    """Outlines and figures of one look; the lane and words where the status has `changed`."""
    arm = rr.escape_entity_path_part(told.arm)
    entities: list[Entity] = [
        (f"world/left/tool/{arm}/registered", [_outline(told.registered_left_px, colours.WARNING)]),
        (f"world/left/tool/{arm}/found", [_outline(told.found_left_px, colours.CHOSEN)]),
        (f"world/right/tool/{arm}/found", [_outline(told.found_right_px, colours.CHOSEN)]),
    ]
    if told.T_correction is not None:
        entities += [
            (f"tool/off/{arm}", [rr.Scalars(MM_PER_METRE * told.tip_off_m)]),
            (f"tool/deviation/{arm}", [rr.Scalars(MM_PER_METRE * told.tip_deviation_m)]),
        ]
    if not changed:
        return entities
    level = rr.TextLogLevel.WARN if told.status is ToolStatus.LOST else rr.TextLogLevel.INFO
    words = said(f"tool_tracker/{told.arm}", tool_sentence(told), level)
    return [*entities, lane(f"tool_{arm}", LANES[told.status]), words]


def tool_sentence(told: ToolCorrection) -> str:
    """How it stands with the instrument, in one sentence."""
    if told.T_correction is None:
        return f"the tool of {told.arm} is not followed in the images: {told.reason}"
    off = f"{MM_PER_METRE * told.tip_off_m:.1f} mm and {np.degrees(told.turned_rad):.1f} degrees"
    sure = f"(deviation {MM_PER_METRE * told.tip_deviation_m:.1f} mm)"
    return f"the tool of {told.arm} is {off} from where registration and joints have it {sure}"


def _outline(px: Float64[np.ndarray, "n 2"], rgb: tuple[int, int, int]) -> rr.Points2D:
    return rr.Points2D(px, colors=[rgb], radii=[RADIUS_PX], draw_order=30.0)
