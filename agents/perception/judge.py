"""What observation asks about a pair before it trusts any thread in it.

Inputs go wrong more often than algorithms do: images exchanged, rows that do not correspond. Texture tells best, so
feature matches are asked first; on a plain ground the two masks are all there is, and a thread seen by both eyes
covers the same rows in both.
"""

from agents.perception.judging.alignment import about_distance, about_rotation, about_rows, about_sides, about_sizes
from agents.perception.judging.answers import judgements
from agents.perception.judging.correspondence import Correspondence, correspondence_of_texture
from agents.perception.judging.masks import correspondence_of_masks
from schemas.messages import Judgement, RectifiedStereo

__all__ = ["Correspondence", "correspondence_of_masks", "correspondence_of_texture", "judge"]


def judge(seen: Correspondence, shape: tuple[int, ...], camera: RectifiedStereo | None = None) -> tuple[Judgement, ...]:
    """What is wrong with a pair of images of that shape, each with its remedy.

    Args:
        camera: of the rectified pair, by which distances are told; None leaves them out.
    """
    height, width = shape[:2]
    answers = [
        about_rows(seen, height),
        about_rotation(seen, height, width),
        about_sizes(seen, height),
        about_sides(seen),
        *([] if camera is None else [about_distance(seen, camera)]),
    ]
    return judgements(answers)
