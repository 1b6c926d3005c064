"""Rigs of several hosts: their lab runs until the last test of this package."""
