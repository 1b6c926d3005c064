"""Names of the units of length that a calibration may be in."""

METRES_PER_UNIT = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}


def metres_per_unit(name: str) -> float:
    """How many metres a unit is.

    Raises:
        ValueError: where nobody calls a unit that; the text lists the known names.
    """
    if name not in METRES_PER_UNIT:
        raise ValueError(f"unknown unit {name!r}; choose from {', '.join(METRES_PER_UNIT)}")
    return METRES_PER_UNIT[name]


def unit_name(metres: float | None) -> str | None:
    """The name of a unit of so many metres, None where it is unknown or has no name."""
    return next((name for name, size in METRES_PER_UNIT.items() if size == metres), None)
