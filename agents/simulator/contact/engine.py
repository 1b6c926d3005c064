"""MuJoCo, loaded when the first field is laid: the one place that imports it."""

from functools import lru_cache
from typing import Any

MISSING = (
    "physics 'contact' is computed by MuJoCo, which is not installed; run make sim, or pip install 'suturegrasp[sim]', "
    "or set physics 'geometric'"
)


class PhysicsError(ValueError):
    """Contact physics cannot be computed; the text names the remedy."""


@lru_cache(maxsize=1)
def engine() -> Any:
    """MuJoCo.

    Raises:
        PhysicsError: where it is not installed; the text names the remedy.
    """
    try:
        import mujoco  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise PhysicsError(MISSING if error.name == "mujoco" else f"MuJoCo does not start: {error}") from error
    return mujoco
