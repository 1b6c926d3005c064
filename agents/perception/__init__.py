"""The perception agent: from a stereo pair to ordered observations of the thread."""
