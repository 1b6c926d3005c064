"""The angle at which the jaw of an instrument closes: found in its motion, and as a file."""
