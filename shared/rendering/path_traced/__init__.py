"""Path-traced stereo scenes of suture thread (Mitsuba, extra `sim`), with exactly known centrelines."""
