"""A puller that knows the true strands: it takes the standing one near its hole, pulls along the tissue, and again."""

import numpy as np

from agents.simulated_trials.pulling.driving import ArmState, Measured, Said, Segment, Stop, Waypoint
from agents.simulator.field import MM
from shared.rigid_transforms import transform

OPEN_RAD, CLOSED_RAD = 0.9, 0.0
TAKEN_MM, DEPTH_MM = 14.0, 8.5
ABOVE_MM, LIFT_MM = 25.0, 4.0
FARTHEST_MM = 40.0
STEP_MM = 2.0
NEAR_MM = 0.3


class TruePuller:
    """Pulls until the true tail is as long as asked, or nothing comes any more.

    Args:
        world: the true thread.
        heedless: goes on whatever the tail is.
    """

    def __init__(self, world, heedless=False):
        self.world, self.heedless = world, heedless
        self._before, self._stuck, self._T = None, 0, None

    def seen(self, thread, arm, goal_m):
        state = self.world.state
        measured = Measured(MM * state.tail_mm, 1e-4)
        over = state.tail_mm - goal_m / MM
        if over < NEAR_MM and not self.heedless:
            return Said(measured, Stop(True, "REACHED", f"the tail is {state.tail_mm:.1f} mm long", measured))
        if arm.moves:
            return Said(measured)
        if state.held is None:
            return Said(measured, self._taken(state))
        self._stuck = self._stuck + 1 if self._before is not None and self._before - state.tail_mm < 0.1 else 0
        self._before = state.tail_mm
        if self._stuck > 4 and not self.heedless:
            return Said(measured, Stop(False, "NOT_RUNNING", "the tail does not become shorter", measured))
        entry, tip = state.standing[0], self._tip(arm)
        if np.linalg.norm(tip - entry) > FARTHEST_MM:
            return Said(measured, self._let_go(arm))
        away = (tip - entry) * (1.0, 1.0, 0.0)
        step = STEP_MM if self.heedless else min(max(over, NEAR_MM), STEP_MM)
        return Said(measured, Segment((self._moved(arm, step * away / np.linalg.norm(away)),)))

    def _taken(self, state):
        """Down over the thread with open jaws, close, and up a little."""
        self._before, self._stuck = None, 0
        steps = np.linalg.norm(np.diff(state.standing, axis=0), axis=1)
        node = max(int(np.searchsorted(np.cumsum(steps), TAKEN_MM)), 1)
        along = (state.standing[node + 1] - state.standing[node - 1]) * (1.0, 1.0, 0.0)
        x, z = along / np.linalg.norm(along), np.array((0.0, 0.0, 1.0))
        R = np.column_stack((x, np.cross(z, x), z))

        def at(lift_mm, jaw_rad):
            return Waypoint(transform(R, MM * (state.standing[node] - (DEPTH_MM + lift_mm) * z)), jaw_rad)

        waypoints = (at(ABOVE_MM, CLOSED_RAD), at(ABOVE_MM, OPEN_RAD), at(0.0, OPEN_RAD))
        return Segment((*waypoints, at(0.0, CLOSED_RAD), at(LIFT_MM, CLOSED_RAD)))

    def _let_go(self, arm):
        up = self._moved(arm, np.array((0.0, 0.0, -ABOVE_MM)))
        return Segment((Waypoint(arm.T_camera_tool, OPEN_RAD), Waypoint(up.T_camera_tool, OPEN_RAD)))

    def _moved(self, arm, by_mm):
        T = arm.T_camera_tool.copy()
        T[:3, 3] += MM * by_mm
        return Waypoint(T, arm.jaw_rad)

    def _tip(self, arm):
        return (arm.T_camera_tool[:3, 3] + MM * DEPTH_MM * arm.T_camera_tool[:3, 2]) / MM


def parked(field):
    """An arm above the middle of the field."""
    T = transform(np.eye(3), MM * (field.stitch.holes.mean(axis=0) - (0.0, 0.0, 40.0)))
    return ArmState(T, CLOSED_RAD)
