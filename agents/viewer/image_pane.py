"""One rectified image with what was found in it, scaled to be looked at, and text on it.

OpenCV's stroke font knows ASCII only and wraps nothing, so text is spelled and wrapped here.
"""

import unicodedata
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from agents.viewer import colours
from agents.viewer.polyline import Polyline, Residuals, closeness, whiskers
from schemas.messages import Centrelines, Image, ImageEncoding

FONT = cv2.FONT_HERSHEY_SIMPLEX
SCALE = 0.5
LINE_HEIGHT_PX = 22

SPELLED = str.maketrans(
    {
        "°": " deg",
        "×": "x",
        "±": "+-",
        "−": "-",
        "–": "-",
        "—": "-",
        "‖": "|",
        "·": ".",
        "…": "...",
        "≤": "<=",
        "≥": ">=",
        "→": "->",
        "“": '"',
        "”": '"',
        "„": '"',
        "‘": "'",
        "’": "'",
        "α": "alpha",
        "β": "beta",
        "δ": "delta",
        "ε": "eps",
        "θ": "theta",
        "κ": "kappa",
        "λ": "lambda",
        "μ": "u",
        "σ": "sigma",
        "ß": "ss",
    }
)


def ascii_text(text: str) -> str:
    """The text in printable ASCII: signs are spelled out, accents dropped, and what remains becomes `?`."""
    spelled = unicodedata.normalize("NFKD", text.translate(SPELLED)).translate(SPELLED)
    plain = "".join(letter for letter in spelled if not unicodedata.combining(letter))
    return "".join(letter if " " <= letter <= "~" else "?" for letter in " ".join(plain.split()))


def text_width(text: str, scale: float = SCALE) -> int:
    """How wide the text is when drawn, in pixels."""
    return cv2.getTextSize(ascii_text(text), FONT, scale, 1)[0][0]


def wrapped(text: str, width_px: int) -> list[str]:
    """The text in lines that fit; a word that is longer than a line is broken."""
    lines: list[str] = []
    for word in ascii_text(text).split():
        if lines and text_width(f"{lines[-1]} {word}") <= width_px:
            lines[-1] = f"{lines[-1]} {word}"
        else:
            lines.extend(_broken(word, width_px))
    return lines


def _broken(word: str, width_px: int) -> list[str]:
    """The word in pieces that fit, of one letter at least."""
    pieces: list[str] = []
    while word:
        # no letter is narrower than a pixel
        most = min(len(word), width_px)
        fits = next((n for n in range(most, 1, -1) if text_width(word[:n]) <= width_px), 1)
        pieces.append(word[:fits])
        word = word[fits:]
    return pieces


def draw_text(
    canvas: UInt8[np.ndarray, "h w 3"],
    text: str,
    at: tuple[int, int],
    rgb: tuple[int, int, int],
    scale: float = SCALE,
) -> None:
    """Draw one line of text whose baseline starts at (x, y)."""
    cv2.putText(canvas, ascii_text(text), at, FONT, scale, rgb[::-1], 1, cv2.LINE_AA)


SHIFT = 4
"""OpenCV draws at sub-pixel places that are given as integers with this many binary digits."""

FAR_PX = 20_000
"""What lies farther out than this is not drawn where it is, but certainly outside of the picture."""

THINNEST_PX, THICKEST_PX = 2, 4
DASHES = 6
"""Thickness of thread at confidence 0 and 1, for those who do not tell red from green."""

LARGEST_MATCH_PX = 5
"""Side of the square for one matched pixel, in an image that is shown many times enlarged."""

EVERY_WHISKER = 3
"""Points of a centreline lie a pixel apart, and would make one area of all whiskers."""

Box = tuple[int, int, int, int]


@dataclass(frozen=True)
class Pane:
    """A canvas that shows an image enlarged `scale` times."""

    canvas: UInt8[np.ndarray, "h w 3"]
    scale: float

    def fixed(self, points_px: Float64[np.ndarray, "n 2"]) -> np.ndarray:
        """Where pixels of the image lie on the canvas, in OpenCV's fixed point."""
        at = (points_px + 0.5) * self.scale - 0.5
        return np.rint(np.clip(np.nan_to_num(at), -FAR_PX, FAR_PX) * 2**SHIFT).astype(np.int32)


def image_pane(image: UInt8[np.ndarray, "h w *c"], width: int, tallest: int) -> Pane:
    """The image in colour, as large as it gets within that width and height."""
    channels = image.reshape(*image.shape[:2], -1)
    colour = channels if channels.shape[2] == 3 else np.repeat(channels[:, :, :1], 3, axis=2)
    scale = min(width / colour.shape[1], tallest / colour.shape[0])
    size = (max(1, round(colour.shape[1] * scale)), max(1, round(colour.shape[0] * scale)))
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR if scale < 3 else cv2.INTER_NEAREST
    return Pane(np.ascontiguousarray(cv2.resize(np.ascontiguousarray(colour), size, interpolation=how)), scale)


def decoded_mask(mask: Image) -> UInt8[np.ndarray, "h w"] | None:
    """The coverage of a mask, None where its bytes are no image of the size that they claim."""
    data = np.frombuffer(mask.data, np.uint8)
    if mask.encoding is ImageEncoding.RAW:
        return data.reshape(mask.height, mask.width, mask.channels)[:, :, 0]
    try:
        decoded = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        return None
    return decoded if decoded is not None and decoded.shape == (mask.height, mask.width) else None


def tint_mask(pane: Pane, mask: UInt8[np.ndarray, "h w"]) -> None:
    """Tint what the mask covers, and draw its outline."""
    height, width = pane.canvas.shape[:2]
    covered = cv2.resize(np.ascontiguousarray(mask), (width, height), interpolation=cv2.INTER_LINEAR) >= 128
    bgr = np.array(colours.MASK[::-1], dtype=np.float64)
    pane.canvas[covered] = (0.8 * pane.canvas[covered] + 0.2 * bgr).astype(np.uint8)
    outlines, _ = cv2.findContours(covered.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(pane.canvas, outlines, -1, colours.MASK[::-1], 1, cv2.LINE_AA)


def enlarged(region: Bool[np.ndarray, "r c"], size: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """A region of a small copy, in an image of that width and height."""
    return np.asarray(cv2.resize(region.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)) >= 0.5


def draw_occluders(pane: Pane, kinds: UInt8[np.ndarray, "r c"]) -> None:
    """Tint what may hide thread."""
    height, width = pane.canvas.shape[:2]
    for kind, rgb in colours.OCCLUDERS.items():
        region = enlarged(kinds == kind.value, (width, height))
        pane.canvas[region] = (0.7 * pane.canvas[region] + 0.3 * np.array(rgb[::-1])).astype(np.uint8)


def draw_candidates(pane: Pane, lines_px: list[Float64[np.ndarray, "n 2"]], labels: list[str]) -> None:
    """Draw the threads that are not meant, which begin with number 2, with a label at the middle of each.

    Args:
        labels: one for each line, or none.
    """
    for number, line in enumerate(lines_px, 1):
        if len(line) < 2:
            continue
        bgr, at = colours.candidate_rgb(number)[::-1], pane.fixed(line)
        cv2.polylines(pane.canvas, [at], False, (0, 0, 0), 4, cv2.LINE_AA, SHIFT)
        cv2.polylines(pane.canvas, [at], False, bgr, 2, cv2.LINE_AA, SHIFT)
        if labels:
            u, v = at[len(at) // 2] // 2**SHIFT
            text = labels[number - 1]
            draw_label(pane, text, (int(u) + 8, int(v) - 10, int(u) + 16 + text_width(text), int(v) + 10))


def draw_matches(pane: Pane, matched_px: Float64[np.ndarray, "p 2"], kept: Bool[np.ndarray, "p"]) -> None:
    """Mark matched pixels, those that were kept over those that were rejected."""
    height, width = pane.canvas.shape[:2]
    side = min(max(2, round(pane.scale)), LARGEST_MATCH_PX)
    corner = pane.fixed(matched_px) // 2**SHIFT - side // 2
    for chosen, rgb in ((~kept, colours.REJECTED), (kept, colours.KEPT)):
        for across, down in np.ndindex(side, side):
            u, v = corner[chosen].T + np.array([[across], [down]])
            inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
            pane.canvas[v[inside], u[inside]] = rgb[::-1]


def draw_observations(
    pane: Pane, observed_px: Float64[np.ndarray, "n 2"], half_size_px: Float64[np.ndarray, "n 2"]
) -> None:
    """Mark the observations, with the bounds that each has in the image."""
    faint = pane.canvas.copy()
    low, high = pane.fixed(observed_px - half_size_px), pane.fixed(observed_px + half_size_px)
    for corner, opposite in zip(low.tolist(), high.tolist(), strict=True):
        cv2.rectangle(faint, corner, opposite, colours.OBSERVATION[::-1], 1, cv2.LINE_AA, SHIFT)
    cv2.addWeighted(faint, 0.6, pane.canvas, 0.4, 0, dst=pane.canvas)
    for centre in pane.fixed(observed_px).tolist():
        cv2.circle(pane.canvas, centre, 4 << SHIFT, (0, 0, 0), cv2.FILLED, cv2.LINE_AA, SHIFT)
        cv2.circle(pane.canvas, centre, 5 << SHIFT - 1, colours.OBSERVATION[::-1], cv2.FILLED, cv2.LINE_AA, SHIFT)


def draw_thread(pane: Pane, thread: Polyline, thread_px: Float64[np.ndarray, "n 2"]) -> None:
    """Draw the thread in the colours and thickness of its confidence, dashed and grey where not both images show it."""
    at = pane.fixed(thread_px).tolist()
    dashed = thread.unseen & (np.arange(len(at)) // 4 % 2 == 1)
    segments = np.flatnonzero(~dashed[:-1]).tolist()
    confidence = 0.5 * (thread.confidence[:-1] + thread.confidence[1:])
    bgr = colours.thread_rgb(confidence, thread.unseen[:-1] & thread.unseen[1:])[:, ::-1].tolist()
    thickness = line_thickness(confidence)
    for i in segments:
        cv2.line(pane.canvas, at[i], at[i + 1], (0, 0, 0), thickness[i] + 2, cv2.LINE_AA, SHIFT)
    for i in segments:
        cv2.line(pane.canvas, at[i], at[i + 1], bgr[i], thickness[i], cv2.LINE_AA, SHIFT)


def draw_elsewhere(pane: Pane, ends_px: Float64[np.ndarray, "k 2 2"]) -> None:
    """Draw where the next likeliest course leads otherwise, dashed."""
    for start, end in ends_px:
        dashes = start + np.linspace(0.0, 1.0, 2 * DASHES)[:, None] * (end - start)
        for one, other in pane.fixed(dashes).reshape(-1, 2, 2).tolist():
            cv2.line(pane.canvas, one, other, (0, 0, 0), THICKEST_PX + 2, cv2.LINE_AA, SHIFT)
            cv2.line(pane.canvas, one, other, colours.WARNING[::-1], THICKEST_PX, cv2.LINE_AA, SHIFT)


def draw_centrelines(pane: Pane, line: Centrelines) -> None:
    """Draw the middle of the thread, piece by piece."""
    cuts = np.flatnonzero(np.diff(line.piece)) + 1
    pieces = np.split(pane.fixed(line.point_px), cuts)
    cv2.polylines(pane.canvas, pieces, False, colours.CENTRELINE[::-1], 1, cv2.LINE_AA, SHIFT)


def draw_residuals(pane: Pane, found: Residuals) -> None:
    """Draw a whisker from the projected thread toward each point of the centrelines, many times exaggerated."""
    lines = whiskers(found)[::EVERY_WHISKER]
    ends = pane.fixed(lines.reshape(-1, 2)).reshape(-1, 2, 2).tolist()
    bgr = colours.confidence_rgb(closeness(found)[::EVERY_WHISKER])[:, ::-1].tolist()
    for (foot, tip), colour in zip(ends, bgr, strict=True):
        cv2.line(pane.canvas, foot, tip, colour, 1, cv2.LINE_AA, SHIFT)


def line_thickness(confidence: Float64[np.ndarray, "n"]) -> list[int]:
    """Thickness in pixels of thread with these confidences; unknown ones count as none."""
    span = THICKEST_PX - THINNEST_PX
    return np.rint(THINNEST_PX + span * np.nan_to_num(confidence)).astype(int).tolist()


def label_ends(pane: Pane, thread_px: Float64[np.ndarray, "n 2"], taken: list[Box]) -> None:
    """Mark both ends of the thread with their s, beside the line and clear of what is taken."""
    at = pane.fixed(thread_px) / 2**SHIFT
    for end, inner, text in ((at[0], at[min(8, len(at) - 1)], "s=0"), (at[-1], at[-min(9, len(at))], "s=1")):
        centre = (int(end[0]), int(end[1]))
        cv2.circle(pane.canvas, centre, 6, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.circle(pane.canvas, centre, 6, colours.OBSERVATION[::-1], 1, cv2.LINE_AA)
        draw_label(pane, text, _free_place(pane, end, end - inner, text_width(text) + 8, taken))


def draw_label(pane: Pane, text: str, box: Box) -> None:
    """Draw text on a dark ground within that box (left, top, right, bottom)."""
    cv2.rectangle(pane.canvas, box[:2], box[2:], colours.BACKGROUND[::-1], cv2.FILLED)
    draw_text(pane.canvas, text, (box[0] + 4, box[3] - 5), colours.TEXT)


def _free_place(pane: Pane, end: np.ndarray, outward: np.ndarray, width: int, taken: list[Box]) -> Box:
    """The first of a ring of places about an end, beginning outward, that is inside and not taken."""
    height = 20
    start = np.arctan2(outward[1], outward[0])
    places = []
    for turn in (0, 1, -1, 2, -2, 3, -3, 4):
        angle = start + turn * np.pi / 4
        centre = end + np.array([np.cos(angle) * (width / 2 + 12), np.sin(angle) * (height / 2 + 12)])
        left, top = int(centre[0] - width / 2), int(centre[1] - height / 2)
        places.append((left, top, left + width, top + height))
    free = (p for p in places if _is_inside(pane, p) and not any(_overlap(p, other) for other in taken))
    place = next(free, places[0])
    taken.append(place)
    return place


def _is_inside(pane: Pane, box: Box) -> bool:
    height, width = pane.canvas.shape[:2]
    return box[0] >= 0 and box[1] >= 0 and box[2] < width and box[3] < height


def _overlap(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
