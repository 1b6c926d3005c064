"""Hypothesis strategies for messages of every type of the schema.

What a field may hold follows from its annotation and, of whole numbers, from its protobuf twin. What the messages' own
checks ask beyond that stands in `CHECKED`.
"""

import dataclasses
import enum
import typing

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from schemas import messages
from schemas.checks import fields_of, is_array, without_none
from schemas.wire import wire_type

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
some_text = texts.filter(bool)
names = st.text("abcxyz_019", min_size=1, max_size=8)
numbers = st.floats(-1e6, 1e6)
positive = st.floats(1e-3, 1e6)
shares = st.floats(0, 1)
sizes = st.integers(1, 12)
lengths = st.integers(0, 4)
SCALARS = {float: numbers, str: texts, bool: st.booleans(), bytes: st.binary(max_size=40)}
WHOLE_NUMBERS = {
    FieldDescriptor.CPPTYPE_INT64: st.integers(-(2**63), 2**63 - 1),
    FieldDescriptor.CPPTYPE_UINT64: st.integers(0, 2**64 - 1),
    FieldDescriptor.CPPTYPE_UINT32: st.integers(0, 2**32 - 1),
}


def array(*shape, elements=numbers):
    return arrays(np.float64, shape, elements=elements)


def message(message_type) -> st.SearchStrategy:
    """A message of that type."""
    return CHECKED[message_type] if message_type in CHECKED else with_fields(message_type)


@st.composite
def with_fields(draw, message_type, **given):
    """A message with the given fields (values, or strategies for them), and all others as they are annotated."""
    values, axes = {}, {}
    for name, annotation in fields_of(message_type).items():
        declared = without_none(annotation)
        if name in given:
            value = given[name]
            values[name] = draw(value) if isinstance(value, st.SearchStrategy) else value
        elif declared is not annotation and draw(st.booleans()):
            values[name] = None
        elif is_array(declared):
            values[name] = draw(any_array(declared, axes))
        elif declared is int:
            on_the_wire = wire_type(message_type).DESCRIPTOR.fields_by_name[name]
            values[name] = draw(WHOLE_NUMBERS[on_the_wire.cpp_type])
        else:
            values[name] = draw(any_value(declared))
    return message_type(**values)


@st.composite
def any_array(draw, declared, axes):
    """An array as it is annotated; `axes` holds the length of each named axis that the message has so far."""
    for axis in declared.dim_str.split():
        if axis not in axes:
            axes[axis] = int(axis) if axis.isdigit() else draw(lengths)
    shape = tuple(axes[axis] for axis in declared.dim_str.split())
    dtype = np.dtype(declared.dtypes[0])
    return draw(arrays(dtype, shape, elements=numbers if dtype.kind == "f" else None))


def any_value(declared) -> st.SearchStrategy:
    if typing.get_origin(declared) is tuple:
        return st.lists(message(typing.get_args(declared)[0]), max_size=2).map(tuple)
    if dataclasses.is_dataclass(declared):
        return message(declared)
    if issubclass(declared, enum.Enum):
        return st.sampled_from(declared)
    return SCALARS[declared]


outcomes = st.just((messages.Status.OK, "")) | some_text.map(lambda reason: (messages.Status.FAILED, reason))
"""A status, and the reason that goes with it."""


@st.composite
def images(draw, width=sizes, height=sizes):
    width, height = draw(width), draw(height)
    channels, encoding = draw(st.sampled_from([1, 3])), draw(st.sampled_from(messages.ImageEncoding))
    count = width * height * channels
    raw = encoding is messages.ImageEncoding.RAW
    data = draw(st.binary(min_size=count, max_size=count) if raw else st.binary(min_size=1, max_size=40))
    return messages.Image(encoding, width, height, channels, data)


@st.composite
def stereo_frames(draw):
    width, height = st.just(draw(sizes)), st.just(draw(sizes))
    return draw(with_fields(messages.StereoFrame, left=images(width, height), right=images(width, height)))


@st.composite
def poses(draw):
    """Rigid transforms from random quaternions."""
    w, x, y, z = draw(array(4, elements=st.floats(0.1, 1))) * draw(st.sampled_from([1, -1]))
    q = np.array([w, x, y, z]) / np.linalg.norm([w, x, y, z])
    K = np.array([[0, -q[3], q[2]], [q[3], 0, -q[1]], [-q[2], q[1], 0]])
    T = np.eye(4)
    T[:3, :3] = np.eye(3) + 2 * q[0] * K + 2 * K @ K
    T[:3, 3] = draw(array(3))
    return T


@st.composite
def camera_matrices(draw):
    return np.array([[draw(positive), draw(numbers), draw(numbers)], [0, draw(positive), draw(numbers)], [0, 0, 1]])


@st.composite
def calibrations(draw):
    left, right = (array(draw(st.sampled_from([0, 4, 5, 8, 12, 14]))) for _ in range(2))
    T = draw(poses())
    T[0, 3] = draw(positive)
    given = {"K_left": camera_matrices(), "K_right": camera_matrices(), "T_right_left": T}
    given |= {"distortion_left": left, "distortion_right": right, "metres_per_unit": st.none() | positive}
    given["covariance"] = st.none() | arrays(np.float64, 8, elements=positive).map(np.diag)
    return draw(with_fields(messages.StereoCalibration, image_width=sizes, image_height=sizes, **given))


@st.composite
def centrelines(draw):
    n = draw(lengths)
    piece = np.sort(draw(arrays(np.int64, n, elements=st.integers(0, 3))))
    return messages.Centrelines(
        draw(array(n, 2)), piece, draw(array(n, elements=positive)), draw(array(n, elements=positive))
    )


@st.composite
def trails(draw):
    n = draw(lengths)
    ends = dict.fromkeys(("loose_start", "loose_end", "told_start", "told_end"), arrays(np.bool_, n))
    return draw(with_fields(messages.Trail, length_px=array(n), **ends))


@st.composite
def observations(draw):
    n = draw(lengths)
    points = draw(array(n, 3))
    points[:, 2] = draw(array(n, elements=positive))
    status, reason = draw(outcomes)
    gaps = arrays(np.int64, draw(lengths), elements=st.integers(0, n - 2)) if n > 1 else np.zeros(0, np.int64)
    places = {"points_camera": points, "half_size_px": array(n, 2, elements=positive), "gaps": gaps}
    return draw(with_fields(messages.ThreadObservations, status=status, reason=reason, **places))


@st.composite
def clamped_knots(draw, control_points, degree):
    within = control_points - degree - 1
    inner = draw(st.lists(st.floats(0.01, 0.99), min_size=within, max_size=within, unique=True))
    return np.concatenate((np.zeros(degree + 1), np.sort(inner), np.ones(degree + 1)))


@st.composite
def surfaces(draw):
    rows, columns = draw(lengths), draw(lengths)
    valid = draw(arrays(np.bool_, (rows, columns)))
    known = array(rows, columns, elements=positive).map(lambda values: np.where(valid, values, 0.0))
    middles = {"u_px": np.arange(columns) * 8.0, "v_px": np.arange(rows) * 8.0}
    return draw(with_fields(messages.TissueSurface, depth=known, valid=valid, deviation=st.none() | known, **middles))


@st.composite
def needle_views(draw):
    lines = draw(centrelines())
    n = len(lines.point_px)
    colours = arrays(np.uint8, (n, 3))
    return draw(with_fields(messages.NeedleView, lines=lines, needle=array(n, elements=shares), colour_bgr=colours))


@st.composite
def needle_poses(draw):
    known = draw(st.booleans())
    return draw(
        with_fields(
            messages.NeedlePose,
            status=messages.Status.OK if known else messages.Status.FAILED,
            reason="" if known else some_text,
            T_camera_needle=poses() if known else None,
            radius=positive,
            arc_rad=st.floats(0.1, 6.2),
            swage_probability=shares,
        )
    )


@st.composite
def regions(draw):
    n = draw(lengths)
    bounds = draw(array(n, 2, elements=positive)), draw(array(n, elements=positive))
    slack = draw(array(n, elements=st.floats(0, 10)))
    return messages.ReliabilityRegions(np.sort(draw(array(n, elements=shares))), draw(array(n, 3)), *bounds, slack)


@st.composite
def thread_courses(draw):
    n, m = draw(lengths), draw(lengths)
    joins = np.sort(draw(array(n, 2, elements=shares)), axis=1)
    return messages.ThreadCourse(joins, draw(array(n, elements=shares)), draw(array(m, 2, elements=shares)))


@st.composite
def tracks(draw):
    step, m, first = draw(st.sampled_from(messages.TrackStep)), draw(st.integers(4, 7)), draw(numbers)
    return draw(
        with_fields(
            messages.ThreadTrack,
            step=step,
            reason="" if step in (messages.TrackStep.STARTED, messages.TrackStep.CONTINUED) else some_text,
            knots=clamped_knots(m, 3),
            control_points_camera=array(m, 3),
            covariance=array(m, 4, 3, 3),
            smoothing=positive,
            span_weight=array(m - 3, elements=positive),
            length=positive,
            velocity_camera=st.none() | array(m, 3),
            material_s=np.array((first, first + draw(positive))),
        )
    )


@st.composite
def reconstructions(draw):
    status, reason = draw(outcomes)
    degree, of_confidence, of_posterior = draw(st.integers(1, 5)), draw(lengths), draw(lengths)
    m = draw(st.integers(degree + 1, degree + 4)) if status is messages.Status.OK else 0
    return draw(
        with_fields(
            messages.ThreadReconstruction,
            status=status,
            reason=reason,
            degree=degree,
            knots=clamped_knots(m, degree) if m else np.zeros(0),
            control_points_camera=array(m, 3),
            confidence_s=array(of_confidence, elements=shares),
            confidence=array(of_confidence, elements=shares),
            posterior_s=array(of_posterior, elements=shares),
            posterior_covariance=array(of_posterior, 3, 3),
            unseen=array(draw(lengths), 2, elements=shares),
            hidden=st.none() | array(draw(lengths), 2, elements=shares),
            left_over_share=st.none() | shares,
        )
    )


@st.composite
def answers(draw):
    outcome = draw(st.sampled_from(messages.Outcome))
    code = "" if outcome is messages.Outcome.ACCEPTED else some_text
    return draw(with_fields(messages.CommandAnswer, outcome=outcome, code=code))


@st.composite
def host_clocks(draw):
    ahead_ms, within_ms = draw(st.just((None, None)) | st.tuples(numbers, positive))
    return draw(with_fields(messages.HostClock, ahead_ms=ahead_ms, within_ms=within_ms))


@st.composite
def goals(draw):
    place = draw(
        st.sampled_from([{"s": shares}, {"pixel": array(2)}, {"point_camera": array(3)}, {"from_swage_m": positive}])
    )
    given = {"s": None, "pixel": None, "point_camera": None, "from_swage_m": None} | place
    return draw(with_fields(messages.GraspGoal, arm=names, attempts=st.none() | st.integers(1, 9), **given))


@st.composite
def tissue_clearances(draw):
    told = {"clearance_m": numbers, "deviation_m": positive, "place_camera": array(3)}
    told |= {"phase": st.sampled_from(messages.Phase), "s": shares}
    if draw(st.booleans()):
        return draw(with_fields(messages.TissueClearance, unchecked=some_text, known_share=0.0, **dict.fromkeys(told)))
    return draw(with_fields(messages.TissueClearance, known_share=st.floats(0.01, 1), **told))


@st.composite
def grasp_checks(draw):
    told = {"tool_moved_m": numbers, "thread_moved_m": numbers, "deviation_m": positive, "held_probability": shares}
    verdict, attempt = draw(st.sampled_from(messages.Checked)), draw(st.integers(0, 3))
    if verdict is messages.Checked.UNKNOWN and draw(st.booleans()):
        told = dict.fromkeys(told)
    told |= {"attempt": attempt, "attempts": st.integers(attempt, 6)}
    return draw(with_fields(messages.GraspCheck, arm=names, verdict=verdict, **told))


@st.composite
def plans(draw):
    status, reason = draw(outcomes)
    path = draw(st.lists(message(messages.Waypoint), min_size=1, max_size=3)) if status is messages.Status.OK else []
    return draw(
        with_fields(
            messages.GraspPlan,
            arm=names,
            status=status,
            reason=reason,
            probability=shares,
            waypoints=tuple(sorted(path, key=lambda waypoint: waypoint.phase.value)),
            attempt=st.integers(0, 2),
            attempts=st.integers(2, 4),
        )
    )


tables = st.integers(0, 255).map(lambda first: np.arange(first, first + 16**3).astype(np.uint8).reshape(16, 16, 16))


@st.composite
def corrections(draw):
    status, misses = draw(st.sampled_from(messages.ToolStatus)), draw(st.integers(0, 2))
    followed = status is messages.ToolStatus.CONVERGED
    usable = followed and misses == 0
    return draw(
        with_fields(
            messages.ToolCorrection,
            arm=names,
            status=status,
            reason="" if usable else some_text,
            T_correction=poses() if usable else None,
            candidates=st.lists(message(messages.ToolCandidate), min_size=followed, max_size=1).map(tuple),
            misses=misses,
        )
    )


@st.composite
def events(draw):
    kind = draw(st.sampled_from(messages.ExecutionKind))
    stopped = kind in (messages.ExecutionKind.REFUSED, messages.ExecutionKind.HELD)
    return draw(with_fields(messages.ExecutionEvent, arm=names, kind=kind, code=some_text if stopped else ""))


@st.composite
def simulator_states(draw):
    m = draw(st.integers(4, 7))
    curve = {"knots": array(m + 4), "control_points_camera": array(m, 3)}
    return draw(with_fields(messages.SimulatorState, distance_m=positive, radius_m=positive, **curve))


CHECKED: dict[type, st.SearchStrategy] = {
    messages.Image: images(),
    messages.Consumed: with_fields(messages.Consumed, key=some_text),
    messages.RectifiedStereo: with_fields(
        messages.RectifiedStereo,
        image_width=sizes,
        image_height=sizes,
        fx_px=positive,
        fy_px=positive,
        baseline=positive,
        metres_per_unit=st.none() | positive,
    ),
    messages.ThreadCandidate: with_fields(messages.ThreadCandidate, score=shares, width_px=positive),
    messages.RightEye: with_fields(
        messages.RightEye, rows_px=st.floats(-1e4, 1e4), turned_deg=st.floats(-360, 360), magnified=st.floats(0.5, 2)
    ),
    messages.Crossing: with_fields(messages.Crossing, s_first=st.floats(0, 0.4), s_second=st.floats(0.5, 1)),
    messages.ClockReading: with_fields(messages.ClockReading, host=some_text),
    messages.CommandHeader: with_fields(messages.CommandHeader, id=some_text),
    messages.ReplayClock: with_fields(messages.ReplayClock, rate=positive),
    messages.SettableParameter: with_fields(messages.SettableParameter, name=some_text),
    messages.SetParameter: with_fields(messages.SetParameter, name=some_text),
    messages.TopicOverride: with_fields(messages.TopicOverride, topic=some_text, setting=some_text),
    messages.RigSection: with_fields(messages.RigSection, name=some_text, digest=some_text),
    messages.AgentConfiguration: with_fields(messages.AgentConfiguration, agent=some_text),
    messages.AgentFacts: with_fields(messages.AgentFacts, agent=some_text, host=some_text),
    messages.Arm: with_fields(messages.Arm, arm=names, plan_id=some_text),
    messages.Hold: with_fields(messages.Hold, arm=names),
    messages.ChangeState: with_fields(messages.ChangeState, arm=names),
    messages.Heartbeat: with_fields(messages.Heartbeat, arm=names, arming_id=some_text),
    messages.Waypoint: with_fields(messages.Waypoint, T_camera_tool=poses()),
    messages.RobotState: with_fields(
        messages.RobotState,
        arm=names,
        T_base_tool=poses(),
        T_camera_base=poses(),
        T_camera_base_registered=st.none() | poses(),
    ),
    messages.ToolCandidate: with_fields(messages.ToolCandidate, table=tables, fits=shares),
    messages.ThreadClearance: st.builds(messages.ThreadClearance, texts)
    | st.builds(messages.ThreadClearance, texts, numbers, array(3), st.sampled_from(messages.Phase), shares),
    messages.StereoFrame: stereo_frames(),
    messages.StereoCalibration: calibrations(),
    messages.Centrelines: centrelines(),
    messages.Trail: trails(),
    messages.ThreadObservations: observations(),
    messages.TissueSurface: surfaces(),
    messages.NeedleView: needle_views(),
    messages.NeedlePose: needle_poses(),
    messages.ReliabilityRegions: regions(),
    messages.ThreadTrack: tracks(),
    messages.ThreadCourse: thread_courses(),
    messages.ThreadReconstruction: reconstructions(),
    messages.CommandAnswer: answers(),
    messages.HostClock: host_clocks(),
    messages.GraspGoal: goals(),
    messages.TissueClearance: tissue_clearances(),
    messages.GraspCheck: grasp_checks(),
    messages.GraspPlan: plans(),
    messages.ToolCorrection: corrections(),
    messages.ExecutionEvent: events(),
    messages.SimulatorState: simulator_states(),
}
MESSAGES = {
    declared: message(declared)
    for declared in (getattr(messages, name) for name in messages.__all__)
    if dataclasses.is_dataclass(declared)
}
