"""What is answered to a prompt, by the last frame that was seen."""

from agents.perception.prompt import reach_px
from agents.perception.search import look_everywhere
from agents.perception.segmenter_names import PROMPTABLE
from schemas.messages import CommandAnswer, Prompt
from shared.rectification import RectifiedPair
from shared.runtime.commands import accepted, refused


def answer_to(prompt: Prompt, pair: RectifiedPair | str | None, segmenter: str | None) -> CommandAnswer:
    """Whether something like thread lies near the prompt; one without a pixel is always taken, and means any thread.

    Args:
        pair: the last frame; why it cannot be used, or None before the first.
        segmenter: as configured; None where it is chosen.
    """
    if prompt.pixel is None:
        return accepted(prompt.header.id)
    if pair is None:
        return refused(prompt.header.id, "no_frame", "there is no frame yet to find thread in; start the camera")
    if isinstance(pair, str):
        return refused(prompt.header.id, "unusable_frame", f"the last frame cannot be used: {pair}")
    height, width = pair.images[0].shape[:2]
    u, v = prompt.pixel
    if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
        reason = f"({u:.0f}, {v:.0f}) lies outside the left image of {width}x{height} pixels"
        return refused(prompt.header.id, "outside", reason)
    # the answer cannot wait for such a network; where it finds nothing, the next observations say so
    if segmenter != PROMPTABLE and not look_everywhere(pair.images, 0, segmenter, prompt.pixel).coverage[0].any():
        reason = f"nothing like thread lies within {reach_px(width):.0f} px of ({u:.0f}, {v:.0f}) in the left image"
        return refused(prompt.header.id, "no_thread", reason)
    return accepted(prompt.header.id)
