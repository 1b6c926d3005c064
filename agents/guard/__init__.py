"""The guard: sits on the robot's computer, and has the arm held when bridge, link or operator is gone."""
