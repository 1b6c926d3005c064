"""Everything that a scene's images depend on, in the left camera's frame and in mm, before any light is traced."""

from dataclasses import dataclass, field

from schemas.messages import RectifiedStereo
from shared.rendering.path_traced.ground import Ground
from shared.rendering.path_traced.lab_light import LabLight
from shared.rendering.path_traced.solids import Needle, Solid
from shared.rendering.path_traced.splines import Strand


@dataclass(frozen=True)
class Lamp:
    """A spot that shines along z: where it is in mm, and its intensity, red first (a grey card at 95 mm turns 1)."""

    place_mm: tuple[float, float, float]
    intensity: tuple[float, float, float]


@dataclass(frozen=True)
class Field:
    """What both eyes look at. The first strand is the one that the truth is about.

    Fields:
        lamps: each traced on its own; where there is light of a lab, that is traced instead, as it comes and goes.
    """

    camera: RectifiedStereo
    ground: Ground
    strands: list[Strand]
    needle: Needle | None = None
    tools: list[Solid] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    lab_light: LabLight | None = None
