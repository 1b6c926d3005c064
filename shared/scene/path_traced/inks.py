"""What is written on suture pads: printed or raised letters, lines and dots of a pen, specks; none of it is thread."""

import cv2
import numpy as np

from shared.scene.path_traced.cuts import FINE_BITS, Line
from shared.scene.path_traced.ground import Grid

INKS = {
    "black": (0.02, 0.02, 0.025),
    "blue": (0.03, 0.05, 0.22),
    "violet": (0.10, 0.03, 0.17),
    "red": (0.42, 0.03, 0.04),
}
FONTS = (
    cv2.FONT_HERSHEY_SIMPLEX,
    cv2.FONT_HERSHEY_DUPLEX,
    cv2.FONT_HERSHEY_COMPLEX,
    cv2.FONT_HERSHEY_TRIPLEX,
)
LETTERS = "ABCDEFGHKLMNPRSTUVXYZ0123456789-."


def letters(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Grid:
    """Cover, 0 to 1, of one or two words or numbers at any angle, thick or thin."""
    image = np.zeros(shape, dtype=np.uint8)
    for _ in range(int(rng.integers(1, 4))):
        word = "".join(rng.choice(list(LETTERS), int(rng.integers(1, 9))))
        high = rng.uniform(3.0, 12.0) * mm
        font, thick = FONTS[int(rng.integers(len(FONTS)))], max(int(high * rng.uniform(0.04, 0.16)), 1)
        scale = high / cv2.getTextSize(word, font, 1.0, thick)[0][1]
        (wide, tall), _ = cv2.getTextSize(word, font, scale, thick)
        line = np.zeros((2 * tall, wide + tall), dtype=np.uint8)
        cv2.putText(line, word, (tall // 2, int(1.5 * tall)), font, scale, 255, thick, cv2.LINE_AA)
        middle = rng.uniform(0.15, 0.85, 2) * (shape[1], shape[0])
        turn = cv2.getRotationMatrix2D((0.5 * line.shape[1], 0.5 * line.shape[0]), rng.uniform(-180.0, 180.0), 1.0)
        turn[:, 2] += middle - (0.5 * line.shape[1], 0.5 * line.shape[0])
        image = np.maximum(image, cv2.warpAffine(line, turn, shape[::-1]))
    return image.astype(np.float32) / 255.0


def pen_marks(rng: np.random.Generator, shape: tuple[int, int], mm: float, lines: list[Line]) -> Grid:
    """Cover, 0 to 1, of a pen's lines: along cuts, across them as ladders, pairs of dots, and lines on their own."""
    image = np.zeros(shape, dtype=np.uint8)
    width = max(round(rng.uniform(0.3, 1.0) * mm), 1)
    for line in lines:
        way = line[-1] - line[0]
        side = np.array([-way[1], way[0]]) / max(float(np.linalg.norm(way)), 1e-6)
        reach = rng.uniform(2.5, 8.0) * mm
        kind = str(rng.choice(("none", "ladder", "dots", "beside"), p=(0.4, 0.2, 0.2, 0.2)))
        places = line[
            :: max(round(rng.uniform(4.0, 10.0) * mm / max(float(np.linalg.norm(line[1] - line[0])), 1e-6)), 1)
        ]
        if kind == "ladder":
            for place in places:
                _stroke(image, np.vstack((place - reach * side, place + reach * side)), width)
        if kind == "dots":
            for place in (*(places - reach * side), *(places + reach * side)):
                cv2.circle(image, (int(place[0]), int(place[1])), width, 255, -1, cv2.LINE_AA)
        if kind == "beside":
            _stroke(image, line + reach * side, width)
    for _ in range(int(rng.poisson(0.8))):
        start, heading = rng.uniform(0.1, 0.9, 2) * (shape[1], shape[0]), rng.uniform(0.0, 2.0 * np.pi)
        end = start + rng.uniform(15.0, 80.0) * mm * np.array([np.cos(heading), np.sin(heading)])
        _stroke(image, np.vstack((start, end)), width)
    worn = cv2.resize(rng.uniform(0.5, 1.0, (40, 60)).astype(np.float32), shape[::-1])
    return cv2.GaussianBlur(image.astype(np.float32) / 255.0, (0, 0), 0.7) * worn


def specks(rng: np.random.Generator, shape: tuple[int, int], mm: float) -> Grid:
    """Cover, 0 to 1, of dust and of holes that needles left."""
    image = np.zeros(shape, dtype=np.uint8)
    area = shape[0] * shape[1] / mm**2
    for _ in range(int(rng.poisson(min(area * rng.uniform(0.0, 0.02), 400.0)))):
        x, y = (int(value) for value in rng.uniform(0.0, 1.0, 2) * (shape[1] * 16, shape[0] * 16))
        cv2.circle(image, (x, y), int(16 * rng.uniform(0.08, 0.3) * mm), int(rng.uniform(80, 255)), -1, cv2.LINE_AA, 4)
    return image.astype(np.float32) / 255.0


def _stroke(image: np.ndarray, points: np.ndarray, width: int) -> None:
    fine = np.rint(points * 2**FINE_BITS).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(image, [fine], False, 255, width, cv2.LINE_AA, FINE_BITS)


def ink(rng: np.random.Generator) -> tuple[float, float, float]:
    """Its linear albedo, red first."""
    return INKS[str(rng.choice(list(INKS), p=(0.4, 0.2, 0.15, 0.25)))]
