"""The operator: goals, arming with a heartbeat, hold."""
