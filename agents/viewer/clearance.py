"""How a plan's jaws stand to the tissue, in words."""

from agents.viewer.units import MM_PER_METRE
from schemas.messages import TissueClearance


def clearance_sentence(tissue: TissueClearance) -> str:
    """The least clearance with its deviation, place and phase, and what was not checked."""
    if tissue.clearance_m is None or tissue.deviation_m is None or tissue.phase is None or tissue.s is None:
        return tissue.unchecked
    off, sure = MM_PER_METRE * tissue.clearance_m, MM_PER_METRE * tissue.deviation_m
    where = f"in {tissue.phase.name.lower()} at {tissue.s:.0%}"
    near = f"jaws {abs(off):.1f} ± {sure:.1f} mm {'before' if off >= 0 else 'into'} the tissue, {where}"
    return f"{near}; {tissue.unchecked}" if tissue.unchecked else near
