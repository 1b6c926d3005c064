"""Trials of grasps on a rig, as the paper did: in which order to try, what came of it, and what that says."""
