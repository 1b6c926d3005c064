"""A light renderer: a stereo pair of a thread with an exactly known centreline over procedural tissue."""
