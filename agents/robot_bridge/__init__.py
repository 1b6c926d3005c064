"""The robot bridge: carries out plans on an arm, and refuses what is not safe."""
