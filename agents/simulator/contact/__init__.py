"""Grasps decided by contact and friction: an elastic rod on soft tissue between two hinged fingers, in MuJoCo."""
