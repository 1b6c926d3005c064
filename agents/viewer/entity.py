"""What every mapping gives: paths with what to log there."""

from collections.abc import Sequence

import rerun as rr

Entity = tuple[str, Sequence[rr.AsComponents]]

HALF_PX = 0.5
"""Integers are pixel centres with us, and pixel corners with Rerun."""
