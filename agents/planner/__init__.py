"""The planner agent: from a thread and a goal to a grasp."""
