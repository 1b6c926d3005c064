"""Light as a lab has it: a lamp beside the field whose shadows are soft, a scope's beam that ends in black, a room."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from schemas.messages import RectifiedStereo

SCOPE_BASELINE_MM = 15.0
"""Eyes farther apart than this are no endoscope's, and no light comes from between them."""

ROOM_SHAPE = (32, 64)
KINDS = ("scope", "beside", "both")


@dataclass(frozen=True)
class Disk:
    """A round lamp: its middle and what it faces, in mm; its radius in mm; its radiance, red first."""

    place_mm: tuple[float, float, float]
    towards_mm: tuple[float, float, float]
    radius_mm: float
    radiance: tuple[float, float, float]


@dataclass(frozen=True)
class Beam:
    """A spot: where it is and what it shines at, in mm; its intensity; full up to one angle, black from the other."""

    place_mm: tuple[float, float, float]
    towards_mm: tuple[float, float, float]
    intensity: tuple[float, float, float]
    full_deg: float
    black_deg: float


@dataclass(frozen=True)
class LabLight:
    """All light of a lab. `room` is what surrounds the field, as a map of directions, linear, red first."""

    disks: tuple[Disk, ...]
    beams: tuple[Beam, ...]
    room: Float32[np.ndarray, "h w 3"]


def lab_light(camera: RectifiedStereo, distance_mm: float, rng: np.random.Generator) -> LabLight:
    """Light on a field at that distance, of which a white card returns about one."""
    kind = str(rng.choice(KINDS, p=(0.4, 0.35, 0.25))) if camera.baseline < SCOPE_BASELINE_MM else "beside"
    target = np.array([0.5 * camera.baseline, 0.0, distance_mm])
    warmth = float(np.clip(rng.normal(1.0, 0.08), 0.8, 1.25))
    tint = np.array((warmth, 1.0, 2.0 - warmth))
    share = {"scope": 0.0, "beside": 1.0, "both": rng.uniform(0.2, 0.6)}[kind]
    disks = (
        tuple(_disk(target, share / 2**k * np.pi * tint, rng) for k in range(int(rng.integers(1, 3)))) if share else ()
    )
    beams = _beams(camera, distance_mm, target, (1.0 - share) * np.pi * tint, rng) if share < 1.0 else ()
    brightness = rng.uniform(0.08, 0.35) if kind == "beside" else rng.uniform(0.005, 0.06)
    return LabLight(disks, beams, _room(float(brightness), rng))


def _disk(target: Float64[np.ndarray, "3"], irradiance: Float64[np.ndarray, "3"], rng: np.random.Generator) -> Disk:
    """A lamp aside of the line of sight."""
    around, aside = rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(15.0, 60.0))
    away, radius = rng.uniform(250.0, 500.0), float(rng.uniform(12.0, 60.0))
    way = np.array([np.sin(aside) * np.cos(around), np.sin(aside) * np.sin(around), -np.cos(aside)])
    place = target + away * way
    radiance = irradiance * away**2 / (np.pi * radius**2)
    return Disk(_triple(place), _triple(target + rng.normal(0.0, 15.0, 3)), radius, _triple(radiance))


def _beams(
    camera: RectifiedStereo,
    distance_mm: float,
    target: Float64[np.ndarray, "3"],
    irradiance: Float64[np.ndarray, "3"],
    rng: np.random.Generator,
) -> tuple[Beam, ...]:
    """Two beams beside the lens, whose edge lies within the image or not far outside it."""
    corner = np.degrees(np.arctan(0.5 * np.hypot(camera.image_width, camera.image_height) / camera.fx_px))
    black = float(corner * rng.uniform(0.8, 1.7))
    full = black * float(rng.uniform(0.02, 0.3))
    apart, below, balance = rng.uniform(5.0, 16.0), rng.uniform(-3.0, 4.0), float(rng.uniform(0.25, 0.75))
    aim = target + np.array([*rng.normal(0.0, 0.08, 2), 0.0]) * distance_mm
    beams: list[Beam] = []
    for side, share in ((-1.0, balance), (1.0, 1.0 - balance)):
        place = np.array([0.5 * camera.baseline + 0.5 * side * apart, below, 0.0])
        beams.append(Beam(_triple(place), _triple(aim), _triple(share * irradiance * distance_mm**2), full, black))
    return tuple(beams)


def _room(brightness: float, rng: np.random.Generator) -> Float32[np.ndarray, "h w 3"]:
    """Grey walls, with a few bright windows and lamps which steel mirrors."""
    walls = 0.35 + cv2.resize(rng.uniform(0.0, 1.0, (4, 8)).astype(np.float32), ROOM_SHAPE[::-1])
    for _ in range(int(rng.integers(3, 8))):
        row, column = int(rng.integers(0, ROOM_SHAPE[0] - 3)), int(rng.integers(0, ROOM_SHAPE[1] - 4))
        high, wide = int(rng.integers(1, 5)), int(rng.integers(1, 8))
        walls[row : row + high, column : column + wide] += rng.uniform(2.0, 12.0)
    tint = np.clip(rng.normal(1.0, 0.06, 3), 0.8, 1.2)
    room = cv2.GaussianBlur(walls, (0, 0), 0.6)[..., None] * tint
    return (brightness * room / room.mean()).astype(np.float32)


def _triple(values: Float64[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
