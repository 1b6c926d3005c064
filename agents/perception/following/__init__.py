"""Frames after a good look: the thread is found again where its curve is expected, and nothing is segmented."""
