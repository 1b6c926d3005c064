"""The simulator: a field with a thread, and the judgement whether a jaw caught it."""
