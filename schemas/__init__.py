"""What crosses the wire: message definitions, their frozen dataclasses, and one codec for all of them."""

__version__ = "0.2.0"
