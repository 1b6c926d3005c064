"""Text on images: OpenCV's stroke font knows ASCII only and wraps nothing."""

import unicodedata

import cv2
import numpy as np
from jaxtyping import UInt8

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
