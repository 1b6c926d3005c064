"""The paper's experiment on grasping: in which order to try, what came of it, and what that says."""
