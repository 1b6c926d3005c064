"""Kinematics of arms."""
