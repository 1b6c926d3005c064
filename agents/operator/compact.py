"""Messages to pages as text: JSON without spaces, put together from parts that are the same for all pages."""

import json
from collections.abc import Mapping
from typing import Any

compact = json.JSONEncoder(separators=(",", ":")).encode
"""A document as text."""


def joined(document: Mapping[str, Any], parts: Mapping[str, str]) -> str:
    """A document of at least one key with further ones, whose values are texts already."""
    return compact(document)[:-1] + "".join(f',"{key}":{text}' for key, text in parts.items()) + "}"
