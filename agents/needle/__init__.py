"""The needle agent: from lines in both images to the pose of a curved needle."""
