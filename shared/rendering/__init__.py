"""Synthetic stereo pairs of thread with exactly known truth, by a light renderer and path-traced."""
