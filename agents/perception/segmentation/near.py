"""What is known of a thread before it is looked for."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool


@dataclass(frozen=True)
class Near:
    """Where a thread may be, and how it looks.

    Fields:
        where: pixels that may be thread, in the image that is to be segmented.
        is_bright: whether it is brighter than its surroundings; else it is darker.
    """

    where: Bool[np.ndarray, "h w"]
    is_bright: bool
