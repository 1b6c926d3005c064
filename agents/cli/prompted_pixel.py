"""A pixel on the thread that is meant, as a person writes it on a command line."""

import math


def prompted_pixel(pixel: tuple[float, float] | None, at: str | None) -> tuple[float, float] | None:
    """U and v as either option gives them; None without one.

    Args:
        pixel: of --pixel.
        at: of --at.

    Raises:
        ValueError: where both are given, or one is no pixel.
    """
    if at is not None and pixel is not None:
        raise ValueError("give --at or --pixel, not both")
    found = pixel if at is None else _pixel_of(at)
    if found is not None and not all(map(math.isfinite, found)):
        raise ValueError(f"({found[0]:g}, {found[1]:g}) is no pixel; give two finite numbers")
    return found


def _pixel_of(text: str) -> tuple[float, float]:
    try:
        u, v = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"--at {text} is no pixel; give its column and row, such as --at 412,230") from None
    return u, v
