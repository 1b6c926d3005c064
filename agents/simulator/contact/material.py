"""What thread, fingers and tissue are made of. Millimetre, gram, second: a pascal is 1 g/(mm s²), a newton 1e6 g mm/s².

docs/simulator.md gives the source of each figure.
"""

from dataclasses import dataclass

import numpy as np

NEWTON = 1e6
GRAVITY = 9810.0
"""Along the camera's z: it looks straight down."""


@dataclass(frozen=True)
class Material:
    """Fields:
    bending_modulus: of the thread, E in E I; a monofilament's.
    density: of the thread.
    finger_friction: between thread and the serrated faces of the fingers.
    tissue_friction: between thread and wet tissue.
    tissue_modulus: Young's modulus of the tissue, which is incompressible.
    stitch_mm: radius of the tissue that yields with the end of the thread that is stitched into it.
    grip_n: force at the tips with which the jaw closes at most.
    segment_mm: length of the rod's segments, about.
    step_s: the time step; `joint_steps`: in how many of them a bent joint of the rod relaxes.
    """

    bending_modulus: float = 1e9
    density: float = 1.2e-3
    finger_friction: float = 0.5
    tissue_friction: float = 0.3
    tissue_modulus: float = 15e3
    stitch_mm: float = 1.5
    grip_n: float = 3.0
    segment_mm: float = 3.0
    step_s: float = 5e-4
    joint_steps: float = 2.5

    def second_moment(self, radius_mm: float) -> float:
        """Of area of a round thread, in mm⁴."""
        return float(np.pi * radius_mm**4 / 4.0)

    def weight(self, radius_mm: float) -> float:
        """Of a millimetre of thread, in g/s²."""
        return float(self.density * np.pi * radius_mm**2 * GRAVITY)

    @property
    def joint_s(self) -> float:
        """How fast a bent joint of the rod relaxes: as fast as the time step can follow."""
        return self.joint_steps * self.step_s

    @property
    def plane_strain_modulus(self) -> float:
        """Of incompressible tissue, E / (1 − ν²)."""
        return self.tissue_modulus / 0.75

    def line_stiffness(self, length_mm: float) -> float:
        """Force that presses a line of that length a millimetre into the tissue, in g/s²; Johnson (1985), chapter 5."""
        return 0.25 * np.pi * self.plane_strain_modulus * length_mm

    @property
    def stitch_stiffness(self) -> float:
        """Force that draws a stitch a millimetre out of its place, in g/s²: as a disc of that radius (Sneddon 1965)."""
        return 2.0 * self.plane_strain_modulus * self.stitch_mm

    def foundation(self, area_mm2: float) -> float:
        """Pressure per depth under a flat punch of that area, in g/(mm² s²).

        A rigid punch of radius a needs F = 2 E* a δ (Sneddon 1965); spread over its face, that is 2 E* / (π a) a depth.
        """
        return 2.0 * self.plane_strain_modulus / (np.pi * float(np.sqrt(area_mm2 / np.pi)))


SUTURE = Material()
