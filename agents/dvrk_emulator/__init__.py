"""An emulated robot: what a dVRK's computer says and does, for tests and for users without one."""
