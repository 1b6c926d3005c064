"""How it stands with the instruments that perception looks for in the images: found, drifted, lost."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from agents.diagnostics.status.gathered import ArmHeard
from agents.diagnostics.status.health_watch import span_of
from agents.diagnostics.status.wrong import Wrong
from agents.robot_bridge.correction import FRESH_S
from schemas.messages import ToolCorrection, ToolStatus

DRIFTED_M = 0.003
"""A registration that is farther off than this has drifted; as much as `track-tool` allows by itself."""
OLD_S = 5.0


def judge_tool(arm: ArmHeard, at_ns: int) -> Iterator[Wrong]:
    """What is wrong with an arm's instrument or registration, by the images; a note where the bridge corrects it."""
    tool = arm.tool
    if tool is None:
        return
    age_s = (at_ns - tool.stamp.capture_left_ns) * 1e-9
    if age_s > OLD_S:
        yield Wrong("tool", arm.arm, f"the tool of {arm.arm} was last looked for {span_of(age_s)} ago in the images")
    elif tool.status is not ToolStatus.CONVERGED:
        lost = tool.status is ToolStatus.LOST
        yield Wrong("tool", arm.arm, f"the tool of {arm.arm} is not followed in the images: {tool.reason}", grave=lost)
    elif tool.tip_off_m > DRIFTED_M:
        yield _drifted(arm, tool)
    yield from _held(arm, at_ns)


def _held(arm: ArmHeard, at_ns: int) -> Iterator[Wrong]:
    """A base that is corrected by an older look, which the bridge holds."""
    looked_ns = arm.state.correction_looked_ns if arm.state is not None else 0
    age_s = (at_ns - looked_ns) * 1e-9
    if looked_ns and age_s > FRESH_S:
        by = f"by a look of {span_of(age_s)} ago, which is held: looks come late, or the tool is not seen"
        yield Wrong("held", arm.arm, f"the base of {arm.arm} is corrected {by}", grave=False)


def tool_told(arm: ArmHeard) -> dict[str, Any] | None:
    """The same as JSON can hold it."""
    tool = arm.tool
    if tool is None:
        return None
    told = {"status": tool.status.name.lower(), "reason": tool.reason, "usable": tool.T_correction is not None}
    return told | {"off_mm": round(1e3 * tool.tip_off_m, 2), "deviation_mm": round(1e3 * tool.tip_deviation_m, 2)}


def _drifted(arm: ArmHeard, tool: ToolCorrection) -> Wrong:
    off = f"{1e3 * tool.tip_off_m:.1f} mm and {np.degrees(tool.turned_rad):.1f} degrees"
    corrected = arm.state is not None and arm.state.T_camera_base_registered is not None
    advice = "calibrate hand-eye again, or set correction = 'tool_tracker'"
    remedy = "which its bridge corrects" if corrected else advice
    text = f"the registration of {arm.arm} is {off} off by the images (drifted); {remedy}"
    return Wrong("drifted", arm.arm, text, grave=not corrected)
