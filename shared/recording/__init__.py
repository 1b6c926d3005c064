"""Recordings as files: what a session leaves behind, for all who write and read it."""
