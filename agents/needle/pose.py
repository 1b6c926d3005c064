"""A curved needle's pose from the lines around it in both images.

A needle is an arc of a circle in space. Three places of lines that both eyes see fix a circle, and of many such circles
those are looked at more closely on which most lies of what looks like a needle (RANSAC: Fischler and Bolles, 1981).
Least squares bring them onto the lines of both eyes: of each point counts how far it lies across the projected circle.

Which part of a circle is the needle follows from what lies on each degree of it in each eye. A line that looks like
a needle speaks for it, one that looks like thread a little against it, and none at all more so, unless an instrument
hides it. The needle is the arc with the largest sum of log-odds. It goes on as far as lines lie on the circle. At one
end a line leaves the circle: that is the thread, and where its width and colour become a needle's is the swage (the
likeliest change of mean and variance). The other end is the point.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64

from schemas.messages import Centrelines, NeedleObservations, NeedlePose, NeedleView, RectifiedStereo, Status
from shared.camera import project
from shared.images import decode_image

RADII_M = 0.003, 0.016
"""Of curved needles from 10 to 50 mm of length."""
USUAL_DEG = 170.0, 30.0
"""From swage to point, with the deviation among needles: three eighths, a half, five eighths of a circle."""
KNOWN_RATIO, KNOWN_DEG = 0.03, 3.0
"""How far a needle is from the radius, as a ratio, and from the angle that its maker states."""

# what is drawn, scored, and refined
SAME_ROW_PX = 0.75
DRAWS, SCORED, REFINED = 4000, 300, 4
SUPPORT_STEP_DEG, LOOKS_LIKE = 6, 0.05
POINTS = 90
"""Of each eye, by which circles are scored and refined."""
ROUNDS, STEPS = 5, 6
LEAST_POINTS = 20

# how points lie on a circle
BOX_PX = 40.0
"""Around a circle, beside which no point lies on it while it is refined."""
NEAR_PX = 2.0
"""So near a circle a point lies on it."""
LEAST_SIGMA_PX, HUBER = 0.3, 1.5
ASIDE, MERGED, BESIDE_DEG, PART_STEP_DEG = 1.0, 1.3, 45, 5
"""Where two parts of a circle, so far apart along it, are nearer in an image than so many widths of the line, they show
as one, and its middle may be so many widths aside. Fitted on the training scenes, as all below."""
GAP_DEG = 2
"""A line goes on between two points of it that are so far apart."""
DEGREES = np.arange(360)

# which arc is the needle
ODDS_OF_SHARE = (0.0, 0.2, 0.8, 1.0), (-0.8, -0.4, 2.5, 3.5)
"""The log-odds of a degree on which a line lies, by how much it looks like needle."""
ODDS_OF_NOTHING = -2.5
"""Of one on which none lies, and nothing hides it."""
MOST_DEG = 300
LEAST_GAIN = 60.0
"""Of log-odds, below which nothing is a needle."""

# which end is the swage, and where both ends are
AROUND_POINTS, AROUND_M = 6, 0.004
"""By which the direction of a line is told, and how much of the thread tells what thread looks like."""
LEAST_PX_PER_DEGREE = 0.1
LEAVES_M = 0.0015
"""A line that goes on so far from the circle is the thread."""
LOOKS = 5
LEAST_SPREAD = np.array([0.08, 8.0, 8.0, 8.0, 0.15])
OF_NEEDLES = np.array([0.4, 60.0, 60.0, 60.0, 0.4])
"""Deviations of what a thread looks like, at the least, and of what needles look like: logarithm of the width, colour
in levels, share of needle."""
EARLY_M = 0.0003
"""So far before the point its line ends: it comes to nothing there."""
SWAGE_M, POINT_M = 0.0006, 0.0012
"""Deviations of both ends along the needle."""
SURE, GUESSED = 0.98, 0.6
"""That an end is the swage from which a thread leads on, and one that is just the wider one."""
HIDDEN_DEG, INSIDE_DEG = 6, 2.0

# how well it is known
CORRELATED = 3.0
"""Neighbouring points err alike, so that they tell as much as a third of them would."""
LEAST_RATIO = 0.05
"""Deviation of a radius that an earlier pair told, at the least, as a ratio: pairs in turn err alike."""
LEAST_SEEN_DEG = 130.0
"""Of the arc, by both eyes: of training needles of which less was seen seven in eight lay otherwise."""
MOST_TURN_DEG = 15.0


@dataclass(frozen=True)
class Eye:
    """What one eye sees, and which eye that is: 0 for the left one."""

    number: int
    view: NeedleView
    instruments: Bool[np.ndarray, "r c"]

    @property
    def point_px(self) -> Float64[np.ndarray, "n 2"]:
        """The middle of its lines."""
        return self.view.lines.point_px

    def beside(self, pixels: Float64[np.ndarray, "k 2"]) -> "Eye":
        """The same with those points alone that lie in the box around pixels."""
        low, high = pixels.min(axis=0) - BOX_PX, pixels.max(axis=0) + BOX_PX
        kept = ((self.point_px >= low) & (self.point_px <= high)).all(axis=1)
        lines = self.view.lines
        lines = Centrelines(lines.point_px[kept], lines.piece[kept], lines.width_px[kept], lines.deviation_px[kept])
        view = NeedleView(lines, self.view.needle[kept], self.view.colour_bgr[kept], self.view.instruments)
        return replace(self, view=view)

    def some(self, wanted: Bool[np.ndarray, "n"]) -> Int64[np.ndarray, "k"]:
        """At most POINTS of these points, evenly spaced along their lines."""
        index = np.flatnonzero(wanted)
        return index[:: max(1, len(index) // POINTS)]


Eyes = tuple[Eye, ...]
"""The left and the right one."""


@dataclass(frozen=True)
class Circle:
    """A circle in the camera frame; the columns of `axes` are two directions in its plane, and its normal."""

    centre: Float64[np.ndarray, "3"]
    axes: Float64[np.ndarray, "3 3"]
    radius: float

    def at(self, angle: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n 3"]:
        """Points at angles in radians."""
        return self.centre + self.radius * np.column_stack((np.cos(angle), np.sin(angle))) @ self.axes[:, :2].T

    def moved(self, step: Float64[np.ndarray, "7"]) -> "Circle":
        """Moved by `step[:3]`, turned about its middle by the rotation vector `step[3:6]`, larger by e^`step[6]`."""
        return Circle(
            self.centre + step[:3], cv2.Rodrigues(step[3:6])[0] @ self.axes, self.radius * float(np.exp(step[6]))
        )


def circles_through(
    a: Float64[np.ndarray, "n 3"], b: Float64[np.ndarray, "n 3"], c: Float64[np.ndarray, "n 3"]
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n"]]:
    """Middles, unit normals and radii of the circles through three points each; inf for three in a line."""
    u, v = b - a, c - a
    normal = np.cross(u, v)
    square = (normal**2).sum(axis=1)
    line = square <= 1e-12 * (u**2).sum(axis=1) * (v**2).sum(axis=1)
    square = np.where(line, 1.0, square)
    to_middle = (u**2).sum(axis=1)[:, None] * np.cross(v, normal) + (v**2).sum(axis=1)[:, None] * np.cross(normal, u)
    to_middle /= 2.0 * square[:, None]
    radius = np.where(line, np.inf, np.linalg.norm(to_middle, axis=1))
    return a + to_middle, normal / np.sqrt(square)[:, None], radius


def drawn(camera: RectifiedStereo, eyes: Eyes, rng: np.random.Generator) -> list[Circle]:
    """Circles through three places each that both eyes see, drawn by how much they look like needle."""
    points, weight = _places(camera, eyes)
    if len(points) < 3:
        return []
    chosen = rng.choice(len(points), (DRAWS, 3), p=weight / weight.sum())
    corners = [points[chosen[:, k]] for k in range(3)]
    centre, normal, radius = circles_through(*corners)
    sides = [np.linalg.norm(corners[k] - corners[k - 1], axis=1) for k in range(3)]
    least, most = np.array(RADII_M) / (camera.metres_per_unit or 1.0)
    # places near each other say little of their circle
    good = (radius > least) & (radius < most) & (np.min(sides, axis=0) > 0.3 * radius) & (centre[:, 2] > 2 * radius)
    kept = np.flatnonzero(good)[:SCORED]
    return [Circle(centre[k], _axes(normal[k]), float(radius[k])) for k in kept]


def _places(camera: RectifiedStereo, eyes: Eyes) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n"]]:
    """Where points of both eyes in the same row would lie, and how much they look like needle."""
    left, right = eyes
    order = np.argsort(right.point_px[:, 1], kind="stable")
    row = right.point_px[order, 1]
    first = np.searchsorted(row, left.point_px[:, 1] - SAME_ROW_PX)
    last = np.searchsorted(row, left.point_px[:, 1] + SAME_ROW_PX)
    i = np.repeat(np.arange(len(first)), last - first)
    within = np.arange(len(i)) - np.repeat(np.cumsum(last - first) - (last - first), last - first)
    j = order[first[i] + within]
    disparity = left.point_px[i, 0] - right.point_px[j, 0]
    weight = left.view.needle[i] + right.view.needle[j]
    known = (disparity > 1.0) & (weight > 0.3)
    i, j, disparity, weight = i[known], j[known], disparity[known], weight[known]
    u, v = left.point_px[i, 0], 0.5 * (left.point_px[i, 1] + right.point_px[j, 1])
    z = camera.fx_px * camera.baseline / disparity
    return np.column_stack(((u - camera.cx_px) * z / camera.fx_px, (v - camera.cy_px) * z / camera.fy_px, z)), weight


def _axes(normal: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    return np.column_stack((first, np.cross(normal, first), normal))


@dataclass(frozen=True)
class OnCircle:
    """How points of one image stand to a projected circle.

    Fields:
        angle: of the place that is nearest.
        across_px: how far they lie from it, signed along `normal`.
    """

    angle: Float64[np.ndarray, "n"]
    across_px: Float64[np.ndarray, "n"]
    normal: Float64[np.ndarray, "n 2"]

    @property
    def near(self) -> Bool[np.ndarray, "n"]:
        """Whether they lie on it."""
        return np.abs(self.across_px) < NEAR_PX


def on_circle(
    camera: RectifiedStereo, circle: Circle, eye: int, point_px: Float64[np.ndarray, "n 2"], step_deg: int = 2
) -> OnCircle:
    """The places of a projected circle that are nearest to points."""
    angles = np.radians(np.arange(0.0, 360.0, step_deg))
    pixels = project(camera, circle.at(angles))[eye]
    apart = (point_px**2).sum(axis=1)[:, None] - 2.0 * point_px @ pixels.T + (pixels**2).sum(axis=1)[None]
    k = apart.argmin(axis=1)
    along = np.roll(pixels, -1, axis=0) - np.roll(pixels, 1, axis=0)
    along_k = along[k]
    share = ((point_px - pixels[k]) * along_k).sum(axis=1) / np.maximum((along_k**2).sum(axis=1), 1e-9)
    angle = angles[k] + 2.0 * np.radians(step_deg) * np.clip(share, -0.5, 0.5)
    at = project(camera, circle.at(angle))[eye]
    ahead = project(camera, circle.at(angle + 1e-3))[eye] - at
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-12)
    normal = np.column_stack((-ahead[:, 1], ahead[:, 0]))
    off = point_px - at
    # beside a turn of a circle that is seen edge-on, all of the way counts
    side = np.where((off * normal).sum(axis=1) < 0, -1.0, 1.0)
    return OnCircle(angle, side * np.linalg.norm(off, axis=1), normal)


def supports(camera: RectifiedStereo, eyes: Eyes, circles: list[Circle]) -> Float64[np.ndarray, "c"]:
    """How much of what looks like needle lies on each circle."""
    angles = np.radians(DEGREES[::SUPPORT_STEP_DEG])
    in_plane = np.column_stack((np.cos(angles), np.sin(angles)))
    axes = np.array([circle.radius * circle.axes[:, :2] for circle in circles]).reshape(-1, 3, 2)
    points = np.array([circle.centre for circle in circles]).reshape(-1, 1, 3) + in_plane @ axes.transpose(0, 2, 1)
    images = project(camera, points.reshape(-1, 3))
    total = np.zeros(len(circles))
    for eye in eyes:
        pixels = images[eye.number].reshape(len(circles), len(angles), 2)
        along = np.roll(pixels, -1, axis=1) - np.roll(pixels, 1, axis=1)
        along /= np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-9)
        some = eye.some(eye.view.needle > LOOKS_LIKE)
        for point, share in zip(eye.point_px[some], eye.view.needle[some], strict=True):
            off = point - pixels
            nearest = (off**2).sum(axis=2).argmin(axis=1)[:, None, None]
            off, way = (np.take_along_axis(each, nearest, axis=1)[:, 0] for each in (off, along))
            across = np.abs(off[:, 0] * way[:, 1] - off[:, 1] * way[:, 0])
            total += share * (across < NEAR_PX)
    return total


@dataclass(frozen=True)
class Fit:
    """A circle brought onto points, the information that they give of its seven numbers, and what is left, in px."""

    circle: Circle
    information: Float64[np.ndarray, "7 7"]
    residual_px: float


@dataclass(frozen=True)
class _Linear:
    """Weighted residuals with their Jacobian, and the residuals in px."""

    jacobian: Float64[np.ndarray, "m 7"]
    residual: Float64[np.ndarray, "m"]
    across_px: Float64[np.ndarray, "m"]

    @property
    def cost(self) -> float:
        return float(self.residual @ self.residual)


def fitted(
    camera: RectifiedStereo,
    eyes: Eyes,
    circle: Circle,
    used: list[Int64[np.ndarray, "k"]],
    radius: tuple[float, float] | None,
) -> Fit:
    """A circle brought onto points of both eyes by least squares with Huber's weights.

    Args:
        used: which points of each eye.
        radius: as it is known from elsewhere, and its deviation as a ratio; None where it is not.
    """
    damping = 1e-3
    now = _linear(camera, eyes, circle, used)
    cost = now.cost + _of_radius(circle, radius) ** 2
    for _ in range(STEPS):
        H, g = now.jacobian.T @ now.jacobian, now.jacobian.T @ now.residual
        if radius is not None:
            H[6, 6] += radius[1] ** -2
            g[6] -= _of_radius(circle, radius) / radius[1]
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)) + 1e-9 * np.eye(7), g)
        # no farther at once than a step is good for
        longest = float(np.linalg.norm(step[:3])) / (0.5 * circle.radius)
        trial = circle.moved(step / max(1.0, longest, abs(float(step[6])) / 0.3))
        if trial.centre[2] < 2 * trial.radius:
            damping *= 10
            continue
        then = _linear(camera, eyes, trial, used)
        gained = cost - then.cost - _of_radius(trial, radius) ** 2
        if gained <= 0:
            damping *= 10
            continue
        circle, now, cost, damping = trial, then, cost - gained, 0.3 * damping
        if gained < 1e-4 * cost:
            break
    information = now.jacobian.T @ now.jacobian
    if radius is not None:
        information[6, 6] += radius[1] ** -2
    return Fit(circle, information, float(np.sqrt((now.across_px**2).mean())))


def _of_radius(circle: Circle, radius: tuple[float, float] | None) -> float:
    return 0.0 if radius is None else float(np.log(circle.radius / radius[0]) / radius[1])


def _linear(camera: RectifiedStereo, eyes: Eyes, circle: Circle, used: list[Int64[np.ndarray, "k"]]) -> _Linear:
    """How far points lie across a circle, and how that changes with it; angles along the circle are free."""
    rows, left, plain = [], [], []
    for eye, index in zip(eyes, used, strict=True):
        seen = on_circle(camera, circle, eye.number, eye.point_px[index])
        X = circle.at(seen.angle)
        x, y, z = X.T
        shift = camera.baseline * eye.number
        to_pixel = np.zeros((len(X), 2, 3))
        to_pixel[:, 0, 0], to_pixel[:, 0, 2] = camera.fx_px / z, -camera.fx_px * (x - shift) / z**2
        to_pixel[:, 1, 1], to_pixel[:, 1, 2] = camera.fy_px / z, -camera.fy_px * y / z**2
        across = np.einsum("ni,nij->nj", seen.normal, to_pixel)
        arm = X - circle.centre
        jacobian = np.column_stack((across, np.cross(arm, across), (across * arm).sum(axis=1)))
        width_px = eye.view.lines.width_px[index]
        merged = _to_another_part(camera, circle, eye.number, seen.angle) < MERGED * width_px
        # where two parts of it show as one, the middle of what shows is neither's
        aside_px = np.where(merged, ASIDE * width_px, 0.0)
        sigma = np.sqrt(eye.view.lines.deviation_px[index] ** 2 + LEAST_SIGMA_PX**2 + aside_px**2)
        off = np.abs(seen.across_px) / sigma
        weight = np.sqrt(np.minimum(1.0, HUBER / np.maximum(off, 1e-9))) / sigma
        rows.append(jacobian * weight[:, None])
        left.append(seen.across_px * weight)
        plain.append(seen.across_px)
    return _Linear(np.vstack(rows), np.concatenate(left), np.concatenate(plain))


def _to_another_part(
    camera: RectifiedStereo, circle: Circle, eye: int, angle: Float64[np.ndarray, "n"]
) -> Float64[np.ndarray, "n"]:
    """How far it is in an image, from places on a circle, to the nearest one that is not beside it, in px."""
    degrees = DEGREES[::PART_STEP_DEG]
    pixels = project(camera, circle.at(np.radians(degrees)))[eye]
    apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=2)
    turn = np.abs((degrees[:, None] - degrees[None] + 180) % 360 - 180)
    nearest = np.where(turn >= BESIDE_DEG, apart, np.inf).min(axis=1)
    return nearest[np.rint(np.degrees(angle) / PART_STEP_DEG).astype(np.int64) % len(degrees)]


@dataclass(frozen=True)
class Along:
    """What lies on each degree of a circle.

    Fields:
        seen: of either eye, whether a line lies there.
        hidden: likewise, whether nothing can be seen there.
        log_odds: that it is needle, by both.
    """

    seen: Bool[np.ndarray, "2 360"]
    hidden: Bool[np.ndarray, "2 360"]
    log_odds: Float64[np.ndarray, "360"]


def along(camera: RectifiedStereo, eyes: Eyes, circle: Circle) -> Along:
    """What both eyes see on each degree of a circle."""
    seen, hidden = np.zeros((2, 360), bool), np.zeros((2, 360), bool)
    log_odds = np.zeros(360)
    middles = project(camera, circle.at(np.radians(DEGREES + 0.5)))
    for eye, pixels in zip(eyes, middles, strict=True):
        on = on_circle(camera, circle, eye.number, eye.point_px)
        degree = np.floor(np.degrees(on.angle[on.near])).astype(np.int64) % 360
        count = np.bincount(degree, minlength=360)
        share = np.bincount(degree, eye.view.needle[on.near], 360) / np.maximum(count, 1)
        here = np.flatnonzero(count)
        if len(here):
            apart = np.abs((DEGREES[:, None] - here[None] + 180) % 360 - 180)
            bridged = apart.min(axis=1) <= GAP_DEG
            share = np.where(bridged, share[here[apart.argmin(axis=1)]], 0.0)
            seen[eye.number] = bridged
        hidden[eye.number] = _is_hidden(camera, eye, pixels) & ~seen[eye.number]
        known = np.where(seen[eye.number], np.interp(share, *ODDS_OF_SHARE), ODDS_OF_NOTHING)
        log_odds += np.where(hidden[eye.number], 0.0, known)
    return Along(seen, hidden, log_odds)


def _is_hidden(camera: RectifiedStereo, eye: Eye, pixels: Float64[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
    """Whether pixels lie behind an instrument, or out of view."""
    size = np.array([camera.image_width, camera.image_height])
    inside = ((pixels >= 1) & (pixels < size - 2)).all(axis=1)
    scale = np.array(eye.instruments.shape[::-1]) / size
    column, row = np.clip((pixels * scale).astype(np.int64), 0, np.array(eye.instruments.shape[::-1]) - 1).T
    return ~inside | eye.instruments[row, column]


def likeliest_arc(log_odds: Float64[np.ndarray, "360"]) -> tuple[float, int, int]:
    """The sum, the first degree and the number of degrees of the arc with the largest sum; at most 300."""
    sums = np.concatenate(([0.0], np.cumsum(np.tile(log_odds, 2))))
    windows = np.lib.stride_tricks.sliding_window_view(sums, 301)[:360]
    gains = windows[:, 1:] - windows[:, :1]
    first, count = np.unravel_index(int(gains.argmax()), gains.shape)
    return float(gains[first, count]), int(first), int(count) + 1


def within(degree: Float64[np.ndarray, "n"], low: float, high: float) -> Bool[np.ndarray, "n"]:
    """Whether degrees lie on an arc; an arc of nothing holds none."""
    return (degree - low) % 360.0 < high - low


@dataclass(frozen=True)
class Found:
    """A circle with what lies along it, and the likeliest arc.

    Fields:
        gain: log-odds that a needle lies on that arc.
        low, high: where the arc begins and ends, in degrees.
    """

    fit: Fit
    along: Along
    gain: float
    low: float
    high: float


def found(camera: RectifiedStereo, eyes: Eyes, circle: Circle, radius: tuple[float, float] | None) -> Found | None:
    """A circle refined by what is needle along it; None where hardly anything is."""
    fit = None
    pixels = project(camera, circle.at(np.radians(DEGREES)))
    eyes = tuple(eye.beside(pixels[eye.number]) for eye in eyes)
    for round_ in range(ROUNDS):
        here = along(camera, eyes, circle)
        _, first, count = likeliest_arc(here.log_odds)
        # at first, it is still a little beside the lines
        reach = (2.0 if round_ < ROUNDS // 2 else 1.0) * NEAR_PX
        used = _used(camera, eyes, circle, float(first), float(first + count), reach)
        if sum(map(len, used)) < LEAST_POINTS:
            return None
        fit = fitted(camera, eyes, circle, used, radius)
        circle = fit.circle
    if fit is None:
        return None
    here = along(camera, eyes, circle)
    gain, first, count = likeliest_arc(here.log_odds)
    return Found(fit, here, gain, float(first), float(first + count))


def _used(
    camera: RectifiedStereo, eyes: Eyes, circle: Circle, low: float, high: float, reach_px: float = NEAR_PX
) -> list[Int64[np.ndarray, "k"]]:
    """The points of each eye that lie on an arc."""
    used = []
    for eye in eyes:
        on = on_circle(camera, circle, eye.number, eye.point_px)
        near = np.abs(on.across_px) < reach_px
        used.append(eye.some(near & within(np.degrees(on.angle), low, high)))
    return used


def extended(here: Along, low: float, high: float) -> tuple[float, float]:
    """From which to which degree lines lie on the circle, with what is hidden between; the given arc is part of it."""
    lies = np.asarray(here.seen.any(axis=0))
    hidden = np.asarray(here.hidden.all(axis=0))
    ends: list[int] = []
    for start, step in ((round(low), -1), (round(high) - 1, 1)):
        last = degree = start
        while abs(degree - start) < 0.5 * (MOST_DEG - (high - low)):
            degree += step
            if lies[degree % 360]:
                last = degree
            elif not hidden[degree % 360]:
                break
        ends.append(last)
    return float(ends[0]), float(ends[1] + 1)


@dataclass(frozen=True)
class Line:
    """The line along one side of an arc, and beyond it, in one eye.

    Fields:
        degree: of its points, from the middle of the arc outwards; beyond the circle by length.
        looks: logarithm of the width, colour, and share of needle of each.
        reaches: the last degree at which it lies on the circle.
    """

    degree: Float64[np.ndarray, "n"]
    looks: Float64[np.ndarray, "n 5"]
    reaches: float

    @property
    def leaves(self) -> float:
        """How far it goes on from the circle, in degrees of it."""
        return float(self.degree.max() - self.reaches)


def line_towards(camera: RectifiedStereo, eye: Eye, circle: Circle, low: float, high: float, side: int) -> Line | None:
    """The line of one eye towards the low (-1) or the high side (1) of an arc; None where there is none."""
    middle = 0.5 * (low + high)
    on = on_circle(camera, circle, eye.number, eye.point_px)
    degree = side * ((np.degrees(on.angle) - middle + 180.0) % 360.0 - 180.0)
    inner = np.flatnonzero(on.near & (degree >= 0.0) & (degree <= 0.5 * (high - low) + 1.0))
    if not len(inner):
        return None
    outermost = int(inner[degree[inner].argmax()])
    beyond = _beyond(eye, outermost, degree)
    turn = np.radians(middle + side * (degree[outermost] - np.array([1.0, 0.0])))
    px_per_degree = np.linalg.norm(np.diff(project(camera, circle.at(turn))[eye.number], axis=0))
    steps = np.linalg.norm(np.diff(eye.point_px[np.r_[outermost, beyond]], axis=0), axis=1)
    further = degree[outermost] + np.cumsum(steps) / max(float(px_per_degree), LEAST_PX_PER_DEGREE)
    index = np.r_[inner, beyond]
    view = eye.view
    looks = np.column_stack((np.log(view.lines.width_px[index]), view.colour_bgr[index], view.needle[index]))
    return Line(np.r_[degree[inner], further], looks, float(degree[outermost]))


def _beyond(eye: Eye, outermost: int, degree: Float64[np.ndarray, "n"]) -> Int64[np.ndarray, "k"]:
    """The points of the same piece that follow a point, in the direction in which degrees grow."""
    same = np.flatnonzero(eye.view.lines.piece == eye.view.lines.piece[outermost])
    place = int(np.searchsorted(same, outermost))
    around = degree[same[max(0, place - AROUND_POINTS) : place + AROUND_POINTS + 1]]
    return same[place + 1 :] if around[-1] >= around[0] else same[:place][::-1]


def change_of_looks(
    lines: list[Line], low: float, high: float, reach: float
) -> tuple[Float64[np.ndarray, "g"], Float64[np.ndarray, "g"]]:
    """Degrees between `low` and `high`, and by how much more likely what lies on either side is of two kinds.

    Each kind has a mean and a variance of its own of all looks; twice the gain in log-likelihood over one kind.

    Args:
        reach: so many degrees beyond are looked at.
    """
    at = np.arange(low, high, 0.5)
    gain = np.zeros(len(at))
    for line in lines:
        order = np.argsort(-line.degree, kind="stable")
        order = order[line.degree[order] < high + reach]
        degree, looks = line.degree[order], line.looks[order]
        # from the thread inwards
        sums = np.vstack((np.zeros(LOOKS), np.cumsum(looks, axis=0)))
        squares = np.vstack((np.zeros(LOOKS), np.cumsum(looks**2, axis=0)))
        count = np.searchsorted(-degree, -at, side="right")
        mean = sums[count] / np.maximum(count, 1)[:, None]
        variance = np.maximum(squares[count] / np.maximum(count, 1)[:, None] - mean**2, 0.0) + LEAST_SPREAD**2
        gain += count * (2.0 * np.log(OF_NEEDLES) - np.log(variance)).sum(axis=1)
    return at, gain


@dataclass(frozen=True)
class Arc:
    """The part of a circle that is a needle, in degrees from swage to point.

    Fields:
        side: in which the point lies from the swage: 1 where degrees grow towards it, and -1.
        swage, point: where they are.
        swage_deviation, point_deviation: of both.
        ends_seen: whether they are in view.
        probability: that the swage is where it is said to be, and not at the other end.
    """

    side: int
    swage: float
    point: float
    swage_deviation: float
    point_deviation: float
    ends_seen: tuple[bool, bool]
    probability: float


def arc_on(
    camera: RectifiedStereo,
    eyes: Eyes,
    circle: Circle,
    here: Along,
    low: float,
    high: float,
    usual: tuple[float, float],
) -> Arc:
    """Which end of an arc is the swage, and where both ends are.

    Args:
        usual: how many degrees from swage to point a needle has, and their deviation.
    """
    middle, degree_m = 0.5 * (low + high), np.radians(1.0) * circle.radius * (camera.metres_per_unit or 1.0)
    sides = {
        side: [line for eye in eyes if (line := line_towards(camera, eye, circle, low, high, side)) is not None]
        for side in (-1, 1)
    }
    leaves_m = {side: degree_m * max((line.leaves for line in lines), default=0.0) for side, lines in sides.items()}
    to_swage = max(sides, key=lambda side: leaves_m[side])
    hidden = {side: _goes_on_hidden(here, low if side < 0 else high, side) for side in (-1, 1)}
    leaves = leaves_m[to_swage] > LEAVES_M
    probability = SURE if leaves else GUESSED
    if not leaves and hidden[-1] != hidden[1]:
        # what ends in view without a thread is the point
        to_swage = -1 if hidden[-1] else 1
    elif not leaves:
        to_swage = max(sides, key=lambda side: _width_at_end(sides[side]))
    reach = {side: max((line.reaches for line in lines), default=0.0) for side, lines in sides.items()}
    swage = _swage(sides[to_swage], high - low, degree_m) if leaves else reach[to_swage]
    point = reach[-to_swage] + EARLY_M / degree_m
    swage_deviation, point_deviation = SWAGE_M / degree_m, POINT_M / degree_m
    seen = not hidden[to_swage] and leaves, not hidden[-to_swage]
    missing = max(usual[0] - swage - point, 0.0)
    if not seen[1]:
        point, point_deviation = point + missing, usual[1]
    elif not seen[0]:
        swage, swage_deviation = swage + missing, usual[1]
    ends = middle + to_swage * swage, middle - to_swage * point
    return Arc(-to_swage, *ends, swage_deviation, point_deviation, seen, probability)


def _swage(lines: list[Line], width_deg: float, degree_m: float) -> float:
    """Where lines begin to look like a needle, in degrees from the middle of the arc."""
    last = max(line.reaches for line in lines) + LEAVES_M / degree_m
    at, gain = change_of_looks(lines, 0.1 * width_deg, last, AROUND_M / degree_m)
    return float(at[gain.argmax()])


def _goes_on_hidden(here: Along, end: float, side: int) -> bool:
    """Whether an instrument, or the border of the view, hides from either eye what follows an end."""
    following = (round(end) - (side < 0) + side * np.arange(HIDDEN_DEG)) % 360
    return bool(here.hidden[:, following].any())


def _width_at_end(lines: list[Line]) -> float:
    """How wide lines are where they end, as a ratio to how wide they are in general."""
    ratios = [0.0]
    for line in lines:
        last = line.degree > line.reaches - 10.0
        ratios.append(float(np.exp(np.median(line.looks[last, 0]) - np.median(line.looks[:, 0]))))
    return max(ratios)


NO_NEEDLE = "no needle is in view of both eyes"
TOO_LITTLE = "too little of the needle is in view of both eyes to tell how it lies: turn it, or take the tool aside"
NO_UNIT = "the calibration does not say its unit of length, by which a needle is known: name it"


def needle_pose(
    observed: NeedleObservations,
    last: NeedlePose | None = None,
    radius_mm: float | None = None,
    arc_deg: float | None = None,
) -> NeedlePose:
    """The pose of the needle in a pair.

    Args:
        last: the pose in an earlier pair: where the needle is looked for first, and what is known of its size.
        radius_mm, arc_deg: of the needle, where somebody knows.
    """
    camera = observed.camera
    if camera.metres_per_unit is None:
        return _unknown(observed, NO_UNIT)
    eyes = tuple(
        Eye(number, view, decode_image(view.instruments) > 0)
        for number, view in enumerate((observed.left, observed.right))
    )
    if not all(len(eye.point_px) for eye in eyes):
        return _unknown(observed, NO_NEEDLE)
    radius, usual = _radius_of(last), _arc_of(last)
    if radius_mm is not None:
        radius = 1e-3 * radius_mm / camera.metres_per_unit, KNOWN_RATIO
    if arc_deg is not None:
        usual = arc_deg, KNOWN_DEG
    if last is not None and last.T_camera_needle is not None:
        T = last.T_camera_needle
        tracked = _best(camera, eyes, [Circle(T[:3, 3], T[:3, :3], last.radius)], radius)
        if tracked is not None:
            pose = _told(observed, *_settled(camera, eyes, tracked, radius, usual))
            if pose.status is Status.OK:
                return pose
    circles = drawn(camera, eyes, np.random.default_rng(observed.stamp.sequence))
    ranked = np.argsort(-supports(camera, eyes, circles), kind="stable")
    detected = _best(camera, eyes, [circles[k] for k in ranked[:REFINED]], radius)
    if detected is None:
        return _unknown(observed, NO_NEEDLE)
    return _told(observed, *_settled(camera, eyes, detected, radius, usual))


def _best(
    camera: RectifiedStereo, eyes: Eyes, circles: list[Circle], radius: tuple[float, float] | None
) -> Found | None:
    """The circle, refined, on which a needle most likely lies; None where none does."""
    refined = [one for circle in circles if (one := found(camera, eyes, circle, radius)) is not None]
    best = max(refined, key=lambda one: one.gain, default=None)
    return None if best is None or best.gain < LEAST_GAIN else best


def _settled(
    camera: RectifiedStereo, eyes: Eyes, best: Found, radius: tuple[float, float] | None, usual: tuple[float, float]
) -> tuple[Fit, Along, Arc]:
    """The circle brought onto all that is needle, and nothing else, with its arc: each tells the other."""
    fit, here = best.fit, best.along
    arc = arc_on(camera, eyes, fit.circle, here, *extended(here, best.low, best.high), usual)
    for _ in range(2):
        ends = sorted((arc.swage, arc.point))
        used = _used(camera, eyes, fit.circle, ends[0] + INSIDE_DEG, ends[1] - INSIDE_DEG)
        if sum(map(len, used)) < LEAST_POINTS:
            break
        fit = fitted(camera, eyes, fit.circle, used, radius)
        here = along(camera, eyes, fit.circle)
        arc = arc_on(camera, eyes, fit.circle, here, *extended(here, *_core(*ends)), usual)
    return fit, here, arc


def _core(low: float, high: float) -> tuple[float, float]:
    """An arc without what is next to its ends, of which lines lie at least on the middle."""
    aside = min(4.0, 0.4 * (high - low))
    return low + aside, high - aside


def _radius_of(last: NeedlePose | None) -> tuple[float, float] | None:
    """The radius that an earlier pair told, and its deviation as a ratio."""
    if last is None or last.T_camera_needle is None:
        return None
    return last.radius, max(float(np.sqrt(last.covariance[6, 6])) / last.radius, LEAST_RATIO)


def _arc_of(last: NeedlePose | None) -> tuple[float, float]:
    """How many degrees a needle has, and their deviation: as an earlier pair told that saw both ends, or usual ones."""
    if last is None or last.T_camera_needle is None or not last.ends_seen.all():
        return USUAL_DEG
    return float(np.degrees(last.arc_rad)), float(np.degrees(np.sqrt(last.covariance[7, 7])))


def _unknown(observed: NeedleObservations, reason: str) -> NeedlePose:
    return NeedlePose(
        observed.stamp,
        observed.camera,
        Status.FAILED,
        reason,
        None,
        0.0,
        0.0,
        np.zeros((8, 8)),
        np.zeros(2, bool),
        0.0,
        0.0,
        0.0,
    )


def _told(observed: NeedleObservations, fit: Fit, here: Along, arc: Arc) -> NeedlePose:
    """A circle and its arc as they travel; a failure where too little is seen to tell how the needle lies."""
    circle = fit.circle
    angle = np.radians(arc.swage)
    x = np.cos(angle) * circle.axes[:, 0] + np.sin(angle) * circle.axes[:, 1]
    z = arc.side * circle.axes[:, 2]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack((x, np.cross(z, x), z)), circle.centre
    swage_rad, point_rad = np.radians(arc.swage_deviation), np.radians(arc.point_deviation)
    information = fit.information / CORRELATED
    # a turn in its own plane moves no line across the circle: only the ends tell it
    information[3:6, 3:6] += np.outer(z, z) / swage_rad**2
    covariance = np.zeros((8, 8))
    covariance[:7, :7] = np.linalg.inv(information + 1e-12 * np.eye(7))
    covariance[6] *= circle.radius
    covariance[:, 6] *= circle.radius
    covariance[7, 7] = swage_rad**2 + point_rad**2
    # a swage that lies farther on makes the arc shorter
    covariance[3:6, 7] = covariance[7, 3:6] = -z * swage_rad**2
    covariance = 0.5 * (covariance + covariance.T)
    ends = sorted((arc.swage, arc.point))
    on_arc = within(DEGREES.astype(np.float64), ends[0], ends[1])
    seen_deg = np.count_nonzero(here.seen.all(axis=0) & on_arc)
    turn_deg = float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[3:6, 3:6])[-1])))
    if seen_deg < LEAST_SEEN_DEG or turn_deg > MOST_TURN_DEG:
        return _unknown(observed, TOO_LITTLE)
    return NeedlePose(
        observed.stamp,
        observed.camera,
        Status.OK,
        "",
        T,
        circle.radius,
        float(np.radians(abs(arc.point - arc.swage))),
        covariance,
        np.array(arc.ends_seen),
        arc.probability,
        float(np.radians(seen_deg)),
        fit.residual_px,
    )
