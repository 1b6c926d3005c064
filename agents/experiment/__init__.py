"""The paper's experiment on a rig: in which order grasps are tried, what came of each, and what that says."""
