"""Frames after a good look: known centrelines are found again across themselves, and nothing is segmented."""
