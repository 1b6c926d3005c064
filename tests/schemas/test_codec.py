import dataclasses
import string

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import schemas.messages
from schemas.checks import MessageError
from schemas.codec import LEADING_TO_MOTION, MAX_MESSAGE_BYTES, decode, decode_stamp, encode, encoding_name
from schemas.generated import suturegrasp_pb2 as pb
from schemas.messages import (
    AgentConfiguration,
    AgentFacts,
    AgentHealth,
    Alternative,
    Arm,
    Centrelines,
    ChallengeEcho,
    ChangeState,
    Checked,
    ClockReading,
    CommandAnswer,
    CommandHeader,
    CommandRecord,
    Consumed,
    Crossing,
    ExecutionEvent,
    ExecutionKind,
    FrameNotice,
    FrameStamp,
    GraspCheck,
    GraspGoal,
    GraspJudgement,
    GraspPlan,
    Heartbeat,
    Hold,
    HostClock,
    HostClocks,
    Image,
    ImageEncoding,
    InputHealth,
    Judgement,
    LogLevel,
    LogRecord,
    Occluders,
    Outcome,
    OutputHealth,
    Over,
    Phase,
    Policy,
    Progress,
    Prompt,
    RectifiedStereo,
    ReliabilityRegions,
    ReplayClock,
    RightEye,
    RigSection,
    RobotMode,
    RobotState,
    SetParameter,
    SettableParameter,
    Severity,
    SimulatorState,
    StateWord,
    Status,
    StereoCalibration,
    StereoFrame,
    ThreadAround,
    ThreadCandidate,
    ThreadClearance,
    ThreadObservations,
    ThreadReconstruction,
    ThreadTrack,
    TissueClearance,
    TissueSurface,
    ToolCandidate,
    ToolCorrection,
    ToolStatus,
    TopicOverride,
    TrackStep,
    Trail,
    Verdict,
    Waypoint,
)

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
sizes = st.integers(1, 12)
numbers = st.floats(-1e6, 1e6)
positive = st.floats(1e-3, 1e6)
units = st.none() | positive


def array(*shape, elements=numbers):
    return arrays(np.float64, shape, elements=elements)


@st.composite
def images(draw, size=None):
    width, height = size or draw(st.tuples(sizes, sizes))
    channels = draw(st.sampled_from([1, 3]))
    encoding = draw(st.sampled_from(ImageEncoding))
    count = width * height * channels
    raw = encoding is ImageEncoding.RAW
    data = draw(st.binary(min_size=count, max_size=count) if raw else st.binary(min_size=1, max_size=40))
    return Image(encoding, width, height, channels, data)


nanoseconds = st.integers(-(2**63), 2**63 - 1)
uint64 = st.integers(0, 2**64 - 1)
consumed = st.lists(st.builds(Consumed, texts.filter(bool), uint64, uint64), max_size=3).map(tuple)
echoes = st.builds(ChallengeEcho, texts, nanoseconds)
stamps = st.builds(
    FrameStamp, uint64, nanoseconds, nanoseconds, texts, st.just(()) | st.lists(echoes, max_size=2).map(tuple)
)
cameras = st.builds(RectifiedStereo, sizes, sizes, positive, positive, numbers, numbers, positive, units)
judgements = st.builds(Judgement, texts, st.sampled_from(Severity), texts, texts)
outcomes = st.just((Status.OK, "")) | texts.filter(bool).map(lambda reason: (Status.FAILED, reason))


@st.composite
def stereo_frames(draw):
    size = draw(st.tuples(sizes, sizes))
    return StereoFrame(draw(stamps), draw(images(size)), draw(images(size)), draw(consumed))


@st.composite
def calibrations(draw):
    K = np.array([[draw(positive), draw(numbers), draw(numbers)], [0, draw(positive), draw(numbers)], [0, 0, 1]])
    angle = draw(st.floats(-3, 3))
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[:3, 3] = draw(positive), draw(numbers), draw(numbers)
    left, right = (draw(array(draw(st.sampled_from([0, 4, 5, 8, 12, 14])))) for _ in range(2))
    return StereoCalibration(draw(sizes), draw(sizes), K, K.copy(), left, right, T, draw(units), draw(consumed))


@st.composite
def centrelines(draw):
    n = draw(st.integers(0, 4))
    piece = np.sort(draw(arrays(np.int64, n, elements=st.integers(0, 3))))
    return Centrelines(draw(array(n, 2)), piece, draw(array(n, elements=positive)), draw(array(n, elements=positive)))


candidates = st.builds(
    ThreadCandidate,
    st.floats(0, 1),
    st.integers(0, 3).flatmap(lambda n: array(n, 2)),
    st.integers(0, 3).flatmap(lambda n: array(n, 2)),
    positive,
    arrays(np.int64, 3, elements=st.integers(0, 255)),
)
occluders = st.builds(Occluders, images(), images(), uint64)


right_eyes = st.builds(RightEye, st.floats(-1e4, 1e4), st.floats(-360, 360), st.floats(0.5, 2))


@st.composite
def trails(draw):
    pieces = draw(st.integers(0, 3))
    loose = arrays(np.bool_, pieces)
    colours = arrays(np.uint8, (draw(st.integers(0, 4)), 3, 3))
    return Trail(draw(loose), draw(loose), draw(array(pieces)), draw(colours), draw(loose), draw(loose))


@st.composite
def observations(draw):
    n, p = draw(st.integers(0, 4)), draw(st.integers(0, 5))
    g = draw(st.integers(0, 3)) if n > 1 else 0
    points = draw(array(n, 3))
    points[:, 2] = draw(array(n, elements=positive))
    status, reason = draw(outcomes)
    return ThreadObservations(
        stamp=draw(stamps),
        camera=draw(cameras),
        status=status,
        reason=reason,
        segmenter=draw(texts),
        points_camera=points,
        half_size_px=draw(array(n, 2, elements=positive)),
        matched_px=draw(array(p, 3)),
        match_cost=draw(array(p, 2)),
        inlier=draw(arrays(np.bool_, p)),
        mask_left=draw(images()),
        mask_right=draw(images()),
        judgements=tuple(draw(st.lists(judgements, max_size=3))),
        gaps=draw(arrays(np.int64, g, elements=st.integers(0, max(0, n - 2)))),
        centrelines_left=draw(centrelines()),
        centrelines_right=draw(centrelines()),
        looked_sequence=draw(uint64),
        is_bright=draw(st.booleans()),
        prompt_px=draw(st.none() | array(2)),
        candidates=tuple(draw(st.lists(candidates, max_size=2))),
        occluders=draw(st.none() | occluders),
        score_map=draw(st.none() | images()),
        surface_sequence=draw(st.none() | uint64),
        trail_left=draw(st.none() | trails()),
        trail_right=draw(st.none() | trails()),
        segmented_sequence=draw(st.none() | uint64),
        frames_since_look=draw(uint64),
        judged_sequence=draw(st.none() | uint64),
        glanced_sequence=draw(st.none() | uint64),
        glances=draw(uint64),
        right_eye=draw(st.none() | right_eyes),
        disparities_px=draw(st.none() | array(2)),
        consumed=draw(consumed),
    )


def shares(length):
    return array(length, elements=st.floats(0, 1)).map(np.sort)


@st.composite
def clamped_knots(draw, control_points, degree):
    within = control_points - degree - 1
    inner = draw(st.lists(st.floats(0.01, 0.99), min_size=within, max_size=within, unique=True))
    return np.concatenate((np.zeros(degree + 1), np.sort(inner), np.ones(degree + 1)))


@st.composite
def surfaces(draw):
    r, c = draw(st.integers(0, 3)), draw(st.integers(0, 4))
    depth = draw(array(r, c, elements=positive))
    valid = draw(arrays(np.bool_, (r, c)))
    grid = np.arange(c) * 8.0, np.arange(r) * 8.0
    deviation = np.where(valid, draw(array(r, c, elements=positive)), 0.0) if draw(st.booleans()) else None
    known = np.where(valid, depth, 0.0), valid
    return TissueSurface(draw(stamps), draw(cameras), *grid, *known, deviation, draw(consumed))


@st.composite
def regions(draw):
    n = draw(st.integers(0, 4))
    return ReliabilityRegions(
        draw(shares(n)),
        draw(array(n, 3)),
        draw(array(n, 2, elements=positive)),
        draw(array(n, elements=positive)),
        draw(array(n, elements=st.floats(0, 10))),
    )


@st.composite
def crossings(draw):
    return Crossing(
        s_first=draw(st.floats(0, 0.4)),
        s_second=draw(st.floats(0.5, 1)),
        point_px=draw(array(2)),
        over=draw(st.sampled_from(Over)),
        depth_apart=draw(st.floats(-1e6, 1e6)),
    )


@st.composite
def tracks(draw):
    step, m = draw(st.sampled_from(TrackStep)), draw(st.integers(4, 7))
    well = step in (TrackStep.STARTED, TrackStep.CONTINUED)
    first, size = draw(numbers), draw(positive)
    return ThreadTrack(
        step=step,
        reason="" if well else draw(texts.filter(bool)),
        frames=draw(st.integers(0, 2**32 - 1)),
        innovation=draw(positive),
        found_share=draw(st.floats(0, 1)),
        stamp=draw(stamps),
        knots=draw(clamped_knots(m, 3)),
        control_points_camera=draw(array(m, 3)),
        covariance=draw(array(m, 4, 3, 3)),
        smoothing=draw(positive),
        span_weight=draw(array(m - 3, elements=positive)),
        row_offset_px=draw(numbers),
        length=draw(positive),
        material_s=np.array((first, np.nextafter(first, np.inf) + size)),
        row_slopes_px=draw(st.none() | array(3)),
    )


@st.composite
def reconstructions(draw):
    status, reason = draw(outcomes)
    degree = draw(st.integers(1, 5))
    m = draw(st.integers(degree + 1, degree + 4)) if status is Status.OK else 0
    c, q, g = (draw(st.integers(0, 4)) for _ in range(3))
    return ThreadReconstruction(
        stamp=draw(stamps),
        camera=draw(cameras),
        status=status,
        reason=reason,
        method=draw(texts),
        degree=degree,
        knots=draw(clamped_knots(m, degree)) if m else np.zeros(0),
        control_points_camera=draw(array(m, 3)),
        regions=draw(regions()),
        confidence_s=draw(shares(c)),
        confidence=draw(array(c, elements=st.floats(0, 1))),
        posterior_s=draw(shares(q)),
        posterior_covariance=draw(array(q, 3, 3)),
        unseen=draw(array(g, 2, elements=st.floats(0, 1))),
        consumed=draw(consumed),
        track=draw(st.none() | tracks()),
        crossings=tuple(draw(st.lists(crossings(), max_size=2))),
        other_threads_px=draw(array(g, 2)),
        hidden=draw(st.none() | array(g, 2, elements=st.floats(0, 1))),
        ends_hidden=draw(st.none() | arrays(np.bool_, 2)),
        other_threads=tuple(draw(st.lists(candidates, max_size=2))),
        left_over_share=draw(st.none() | st.floats(0, 1)),
        left_over_px=draw(st.none() | array(g, 2)),
    )


names = st.text("abcxyz_019", min_size=1, max_size=8)
shares_of_one = st.floats(0, 1)
headers = st.builds(CommandHeader, texts.filter(bool), nanoseconds, texts)
refusals = st.builds(
    CommandAnswer, texts, st.sampled_from([Outcome.REFUSED, Outcome.UNKNOWN]), texts.filter(bool), texts
)
answers = refusals | st.builds(CommandAnswer, texts, st.just(Outcome.ACCEPTED), st.just(""), texts)
records = st.builds(CommandRecord, texts, texts, st.binary(max_size=40), nanoseconds, answers)
inputs = st.builds(InputHealth, texts, numbers, st.none() | numbers, uint64, uint64, uint64, uint64)
outputs = st.builds(OutputHealth, texts, numbers, uint64)
healths = st.builds(
    AgentHealth,
    agent=texts,
    instance=texts,
    host=texts,
    version=texts,
    config_hash=texts,
    at_ns=nanoseconds,
    uptime_s=numbers,
    heartbeat=uint64,
    step_ms_p50=st.none() | numbers,
    step_ms_p99=st.none() | numbers,
    inputs=st.lists(inputs, max_size=2).map(tuple),
    outputs=st.lists(outputs, max_size=2).map(tuple),
    fault=texts,
    processor_share=st.none() | numbers,
    resident_bytes=st.none() | uint64,
)
logs = st.builds(LogRecord, nanoseconds, texts, texts, st.sampled_from(LogLevel), texts)
clocks = st.builds(ReplayClock, nanoseconds, st.floats(0, 1e6))
settables = st.builds(SettableParameter, texts.filter(bool), texts, st.booleans())
configurations = st.builds(
    AgentConfiguration,
    texts.filter(bool),
    texts,
    nanoseconds,
    texts,
    st.lists(settables, max_size=2).map(tuple),
    texts,
)
priorities = st.none() | st.integers(0, 99)
topic_overrides = st.builds(TopicOverride, texts.filter(bool), texts.filter(bool), texts)
rig_sections = st.builds(RigSection, texts.filter(bool), texts.filter(bool))
facts = st.builds(
    AgentFacts,
    agent=texts.filter(bool),
    instance=texts,
    host=texts.filter(bool),
    at_ns=nanoseconds,
    version=texts,
    schemas_hash=texts,
    config_hash=texts,
    python=texts,
    zenoh=texts,
    shared_memory=st.booleans(),
    shared_memory_reason=texts,
    realtime_asked=priorities,
    realtime_granted=priorities,
    realtime_reason=texts,
    writes_to=texts,
    disk_free_bytes=st.none() | uint64,
    calibrated_ns=st.none() | nanoseconds,
    certificate_expires_ns=st.none() | nanoseconds,
    processor_s=numbers,
    resident_bytes=uint64,
    overrides=st.lists(topic_overrides, max_size=2).map(tuple),
    rig_sections=st.lists(rig_sections, max_size=2).map(tuple),
)


@st.composite
def host_clocks(draw):
    offset = draw(st.just((None, None)) | st.tuples(numbers, positive))
    return HostClock(draw(texts), draw(texts), draw(texts), *offset)


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
def goals(draw):
    given = draw(st.sampled_from(["s", "pixel", "point_camera"]))
    s = draw(shares_of_one) if given == "s" else None
    pixel = draw(array(2)) if given == "pixel" else None
    point = draw(array(3)) if given == "point_camera" else None
    attempts = draw(st.none() | st.integers(1, 9))
    return GraspGoal(draw(headers), draw(names), draw(st.sampled_from(Policy)), s, pixel, point, attempts)


arms = st.builds(Arm, headers, names, texts.filter(bool))
holds = st.builds(Hold, headers, names)
state_changes = st.builds(ChangeState, headers, names, st.sampled_from(StateWord))
prompts = st.builds(Prompt, headers, st.none() | array(2))
heartbeats = st.builds(Heartbeat, names, texts, nanoseconds, texts.filter(bool), nanoseconds, uint64, st.booleans())
waypoints = st.builds(Waypoint, poses(), numbers, st.sampled_from(Phase), st.none() | numbers)
alternatives = st.builds(Alternative, numbers, numbers, texts)


@st.composite
def clearances(draw):
    stamp, unchecked = draw(st.none() | stamps), draw(texts.filter(bool))
    if draw(st.booleans()):
        return TissueClearance(stamp, unchecked, 0.0)
    share = draw(st.floats(0.01, 1))
    found = draw(numbers), draw(positive), draw(array(3)), draw(st.sampled_from(Phase)), draw(shares_of_one)
    return TissueClearance(stamp, unchecked if share < 1 else "", share, *found)


@st.composite
def thread_clearances(draw):
    found = (draw(numbers), draw(array(3)), draw(st.sampled_from(Phase)), draw(shares_of_one))
    return ThreadClearance(draw(texts), *found) if draw(st.booleans()) else ThreadClearance(draw(texts))


@st.composite
def threads_around(draw):
    n = draw(st.integers(0, 3))
    return ThreadAround(draw(array(n)), draw(array(n, 3)), draw(array(n, 3, 3)))


@st.composite
def checks(draw):
    verdict, attempt = draw(st.sampled_from(Checked)), draw(st.integers(0, 3))
    given = verdict is not Checked.UNKNOWN or draw(st.booleans())
    found = (draw(numbers), draw(numbers), draw(positive), draw(shares_of_one)) if given else (None,) * 4
    return GraspCheck(
        draw(texts),
        draw(names),
        draw(texts),
        verdict,
        draw(st.none() | stamps),
        draw(st.none() | stamps),
        *found,
        attempt=attempt,
        attempts=attempt + draw(st.integers(0, 3)),
        next_plan_id=draw(texts),
        sentence=draw(texts),
        consumed=draw(consumed),
    )


@st.composite
def plans(draw):
    status, reason = draw(outcomes)
    path = draw(st.lists(waypoints, min_size=1, max_size=3)) if status is Status.OK else []
    return GraspPlan(
        plan_id=draw(texts),
        arm=draw(names),
        goal_id=draw(texts),
        stamp=draw(stamps),
        status=status,
        reason=reason,
        policy=draw(st.sampled_from(Policy)),
        s_goal=draw(st.none() | numbers),
        s_capture=draw(st.none() | numbers),
        probability=draw(shares_of_one),
        slide_m=draw(numbers),
        waypoints=tuple(sorted(path, key=lambda waypoint: waypoint.phase.value)),
        alternatives=tuple(draw(st.lists(alternatives, max_size=2))),
        tissue=draw(st.none() | clearances()),
        consumed=draw(consumed),
        thread=draw(st.none() | thread_clearances()),
        attempt=draw(st.integers(0, 2)),
        attempts=draw(st.integers(2, 4)),
        policy_model=draw(texts),
        goal=draw(st.none() | goals()),
        around=draw(st.none() | threads_around()),
        depth_m=draw(st.none() | numbers),
        offset_camera=draw(st.none() | array(3)),
        offset_covariance=draw(st.none() | array(3, 3)),
    )


robot_states = st.builds(
    RobotState,
    names,
    nanoseconds,
    st.sampled_from(RobotMode),
    poses(),
    array(6),
    numbers,
    poses(),
    texts,
    consumed,
    st.none() | poses(),
    texts,
    nanoseconds,
)
tables = arrays(np.uint8, (16, 16, 16), elements=st.integers(0, 255), fill=st.integers(0, 255))
tool_candidates = st.builds(
    ToolCandidate, array(6), array(6, 6), tables, st.integers(0, 2**32 - 1), st.floats(0, 1), numbers, numbers
)


@st.composite
def corrections(draw):
    status = draw(st.sampled_from(ToolStatus))
    misses = draw(st.integers(0, 2))
    usable = status is ToolStatus.CONVERGED and misses == 0
    followed = status is ToolStatus.CONVERGED
    return ToolCorrection(
        draw(names),
        draw(stamps),
        draw(nanoseconds),
        status,
        "" if usable else draw(texts.filter(bool)),
        draw(poses()) if usable else None,
        draw(array(3)),
        draw(array(3)),
        draw(numbers),
        draw(numbers),
        draw(numbers),
        draw(numbers),
        draw(array(draw(st.integers(0, 3)), 2)),
        draw(array(draw(st.integers(0, 3)), 2)),
        draw(array(draw(st.integers(0, 3)), 2)),
        tuple(draw(st.lists(tool_candidates, min_size=followed, max_size=1))),
        draw(st.integers(0, 9)),
        misses,
        draw(uint64),
        draw(consumed),
    )


@st.composite
def events(draw):
    kind = draw(st.sampled_from(ExecutionKind))
    stopped = kind in (ExecutionKind.REFUSED, ExecutionKind.HELD)
    code = draw(texts.filter(bool)) if stopped else ""
    phase = draw(st.none() | st.sampled_from(Phase))
    of = draw(texts), draw(consumed)
    return ExecutionEvent(draw(texts), draw(names), draw(nanoseconds), kind, phase, code, draw(texts), *of)


@st.composite
def fields(draw):
    m = draw(st.integers(4, 7))
    return SimulatorState(
        at_ns=draw(nanoseconds),
        camera=draw(cameras),
        background=draw(texts),
        colour=draw(texts),
        seed=draw(uint64),
        distance_m=draw(positive),
        radius_m=draw(positive),
        knots=draw(array(m + 4)),
        control_points_camera=draw(array(m, 3)),
        held=draw(st.none() | numbers),
        consumed=draw(consumed),
    )


verdicts = st.builds(
    GraspJudgement,
    plan_id=texts,
    arm=names,
    at_ns=nanoseconds,
    verdict=st.sampled_from(Verdict),
    s_caught=st.none() | numbers,
    slid_m=numbers,
    error_m=st.none() | numbers,
    sentence=texts,
    peak_tissue_force_n=st.none() | numbers,
    slipped_m=st.none() | numbers,
    code=texts,
    consumed=consumed,
)

MESSAGES = {
    Image: images(),
    ChallengeEcho: echoes,
    FrameNotice: st.builds(FrameNotice, stamps, consumed),
    FrameStamp: stamps,
    StereoFrame: stereo_frames(),
    StereoCalibration: calibrations(),
    RectifiedStereo: cameras,
    Judgement: judgements,
    Centrelines: centrelines(),
    ThreadCandidate: candidates,
    Occluders: occluders,
    Trail: trails(),
    RightEye: right_eyes,
    ThreadObservations: observations(),
    TissueClearance: clearances(),
    ThreadAround: threads_around(),
    ThreadClearance: thread_clearances(),
    GraspCheck: checks(),
    TissueSurface: surfaces(),
    ReliabilityRegions: regions(),
    ThreadReconstruction: reconstructions(),
    ThreadTrack: tracks(),
    Crossing: crossings(),
    ClockReading: st.builds(ClockReading, texts.filter(bool), nanoseconds),
    Consumed: st.builds(Consumed, texts.filter(bool), uint64, uint64),
    CommandHeader: headers,
    CommandAnswer: answers,
    CommandRecord: records,
    InputHealth: inputs,
    OutputHealth: outputs,
    AgentHealth: healths,
    LogRecord: logs,
    ReplayClock: clocks,
    Progress: st.builds(Progress, texts, consumed, consumed),
    SettableParameter: settables,
    AgentConfiguration: configurations,
    SetParameter: st.builds(SetParameter, headers, texts.filter(bool), texts),
    TopicOverride: topic_overrides,
    RigSection: rig_sections,
    AgentFacts: facts,
    HostClock: host_clocks(),
    HostClocks: st.builds(HostClocks, nanoseconds, st.lists(host_clocks(), max_size=2).map(tuple)),
    GraspGoal: goals(),
    Arm: arms,
    Hold: holds,
    ChangeState: state_changes,
    Prompt: prompts,
    Heartbeat: heartbeats,
    Waypoint: waypoints,
    Alternative: alternatives,
    GraspPlan: plans(),
    RobotState: robot_states,
    ToolCandidate: tool_candidates,
    ToolCorrection: corrections(),
    ExecutionEvent: events(),
    SimulatorState: fields(),
    GraspJudgement: verdicts,
}
any_message = st.one_of(*MESSAGES.values())
message_types = st.sampled_from(list(MESSAGES))
every_message_type = pytest.mark.parametrize("message_type", MESSAGES)


def same(a, b):
    """Equality of two values, field by field and bit by bit."""
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and a == b


def arrays_of(message):
    for value in vars(message).values():
        if isinstance(value, np.ndarray):
            yield value
        elif dataclasses.is_dataclass(value):
            yield from arrays_of(value)


def decoded_or_refused(message_type, data):
    """What came of the bytes; anything but a message or a MessageError escapes and fails the test."""
    try:
        return decode(message_type, data)
    except MessageError as error:
        assert str(error).strip()
        assert "\n" not in str(error)
        return None


def test_every_message_of_the_schema_is_tried():
    declared = {getattr(schemas.messages, name) for name in schemas.messages.__all__}
    assert {d for d in declared if dataclasses.is_dataclass(d)} == set(MESSAGES)


@every_message_type
@settings(max_examples=40)
@given(data=st.data())
def test_a_message_survives_the_wire(message_type, data):
    message = data.draw(MESSAGES[message_type])
    assert same(decode(message_type, encode(message)), message)


@settings(max_examples=60)
@given(message=any_message)
def test_the_stamp_of_a_message_of_a_frame_is_read_without_the_rest(message):
    data = encode(message)
    first = isinstance(message, FrameNotice | StereoFrame | ThreadObservations | ThreadReconstruction | TissueSurface)
    assert decode_stamp(type(message), data) == (message.stamp if first else None)
    assert decode_stamp(type(message), b"") is None


@settings(max_examples=20)
@given(frame=MESSAGES[StereoFrame])
def test_a_damaged_stamp_is_refused_and_damage_behind_it_not_noticed(frame):
    assert decode_stamp(StereoFrame, encode(frame) + b"\xff") == frame.stamp
    with pytest.raises(MessageError, match="FrameStamp"):
        decode_stamp(StereoFrame, b"\x0a\x02\xff\xff")


@settings(max_examples=60)
@given(message=any_message)
def test_encoding_twice_gives_the_same_bytes(message):
    data = encode(message)
    assert encode(message) == data
    assert encode(decode(type(message), data)) == data


@settings(max_examples=60)
@given(message=st.one_of(calibrations(), observations(), reconstructions()))
def test_decoded_arrays_are_read_only(message):
    for array in arrays_of(decode(type(message), encode(message))):
        assert not array.flags.writeable
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


@settings(max_examples=120)
@given(message_type=message_types, data=st.binary(max_size=200))
def test_random_bytes_are_a_message_or_a_message_error(message_type, data):
    decoded_or_refused(message_type, data)


@settings(max_examples=120)
@given(message=any_message, data=st.data())
def test_damaged_encodings_are_a_message_or_a_message_error(message, data):
    damaged = bytearray(encode(message))
    for _ in range(data.draw(st.integers(1, 4)) if damaged else 0):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    decoded_or_refused(type(message), bytes(damaged))


@settings(max_examples=60)
@given(message=any_message, data=st.data())
def test_truncated_encodings_are_a_message_or_a_message_error(message, data):
    whole = encode(message)
    decoded_or_refused(type(message), whole[: data.draw(st.integers(0, len(whole)))])


@settings(max_examples=60)
@given(message=any_message, garbage=st.binary(min_size=1, max_size=30))
def test_trailing_garbage_never_passes_unnoticed(message, garbage):
    # garbage may happen to be well-formed known fields, which then are part of the message by protobuf's rules
    found = decoded_or_refused(type(message), encode(message) + garbage)
    if found is not None:
        reparsed = getattr(pb, type(message).__name__).FromString(encode(message) + garbage)
        if type(message) not in LEADING_TO_MOTION:
            reparsed.DiscardUnknownFields()
        assert encode(found) == reparsed.SerializeToString(deterministic=True)


@settings(max_examples=40)
@given(message=any_message, message_type=message_types)
def test_bytes_of_another_type_are_a_message_or_a_message_error(message, message_type):
    decoded_or_refused(message_type, encode(message))


def test_the_encoding_name_is_the_protobuf_type():
    assert encoding_name(StereoFrame) == "application/protobuf;suturegrasp.v1.StereoFrame"


def observed():
    """A small set of observations as its protobuf twin, ready to be spoilt."""
    mask = Image(ImageEncoding.RAW, 2, 1, 1, b"\0\xff")
    message = ThreadObservations(
        stamp=FrameStamp(7, 10, 11, "c"),
        camera=RectifiedStereo(2, 1, 100.0, 100.0, 1.0, 0.5, 5.0, None),
        status=Status.OK,
        reason="",
        segmenter="truth",
        points_camera=np.array([[0.0, 0.0, 10.0], [1.0, 0.0, 11.0]]),
        half_size_px=np.ones((2, 2)),
        matched_px=np.ones((3, 3)),
        match_cost=np.ones((3, 2)),
        inlier=np.array([True, False, True]),
        mask_left=mask,
        mask_right=mask,
        judgements=(Judgement("ROWS", Severity.NOTE, "f", "r"),),
    )
    return pb.ThreadObservations.FromString(encode(message))


SPOILT = {
    "no stamp": (lambda m: m.ClearField("stamp"), "ThreadObservations.stamp is missing"),
    "no array": (lambda m: m.ClearField("inlier"), "ThreadObservations.inlier is missing"),
    "no status": (lambda m: m.ClearField("status"), "ThreadObservations.status is unspecified; .* 1 [(]OK[)], 2"),
    "unknown status": (lambda m: setattr(m, "status", 9), "ThreadObservations.status has the unknown value 9"),
    "unknown severity": (
        lambda m: setattr(m.judgements[0], "severity", 77),
        r"ThreadObservations.judgements\[0\].severity has the unknown value 77",
    ),
    "wrong dtype": (
        lambda m: setattr(m.points_camera, "dtype", "<f4"),
        "ThreadObservations.points_camera must hold <f8, not '<f4'",
    ),
    "big endian": (lambda m: setattr(m.points_camera, "dtype", ">f8"), "must hold <f8, not '>f8'"),
    "an object dtype": (lambda m: setattr(m.points_camera, "dtype", "|O"), "must hold <f8"),
    "too few bytes": (
        lambda m: setattr(m.half_size_px, "data", b"\0" * 31),
        r"ThreadObservations.half_size_px holds 31 bytes where its shape \(2, 2\) needs 32",
    ),
    "too many bytes": (lambda m: setattr(m.half_size_px, "data", b"\0" * 40), "holds 40 bytes"),
    "a hostile shape": (
        lambda m: m.inlier.shape.__setitem__(0, 2**32 - 1),
        "ThreadObservations.inlier holds 3 bytes where its shape .* needs 4294967295",
    ),
    "too many axes": (
        lambda m: m.inlier.shape.extend([2**32 - 1] * 1000),
        r"ThreadObservations.inlier must have shape \(p\)",
    ),
    "the wrong fixed axis": (
        lambda m: m.points_camera.shape.__setitem__(slice(None), [3, 2]),
        r"points_camera must have shape \(n, 3\), not \(3, 2\)",
    ),
    "no booleans": (lambda m: setattr(m.inlier, "data", b"\0\1\2"), "inlier holds bytes that are neither true"),
    "not a number": (
        lambda m: setattr(m.match_cost, "data", np.full((3, 2), np.nan).tobytes()),
        "ThreadObservations.match_cost must be finite",
    ),
    "an infinite scalar": (
        lambda m: setattr(m.camera, "baseline", float("inf")),
        "ThreadObservations.camera: RectifiedStereo.baseline must be a finite number",
    ),
    "a nested message that contradicts itself": (
        lambda m: setattr(m.mask_left, "data", b""),
        "ThreadObservations.mask_left: Image.data holds 0 bytes",
    ),
    "an array's field from the future": (
        lambda m: m.inlier.MergeFromString(b"\xf8\x3f\x01"),
        "ThreadObservations.inlier has fields that this version does not know",
    ),
}


@pytest.mark.parametrize(("spoil", "text"), SPOILT.values(), ids=SPOILT)
def test_the_error_names_the_field_and_the_fault(spoil, text):
    wire = observed()
    decode(ThreadObservations, wire.SerializeToString())
    spoil(wire)
    with pytest.raises(MessageError, match=text):
        decode(ThreadObservations, wire.SerializeToString())


def added(number):
    """A field of that number, which holds 1."""
    key, out = number << 3, bytearray()
    while key > 0x7F:
        out.append(key & 0x7F | 0x80)
        key >>= 7
    return bytes([*out, key, 1])


def test_whatever_could_move_a_robot_or_says_where_it_goes_is_understood_in_full():
    assert {message_type.__name__ for message_type in LEADING_TO_MOTION} == {
        *("GraspGoal", "GraspPlan", "Arm", "ChangeState", "Heartbeat"),
        *("ReplayClock", "SetParameter", "ToolCorrection", "FrameNotice"),
    }


@every_message_type
@settings(max_examples=5)
@given(data=st.data())
def test_what_a_newer_version_added_is_left_out_except_where_it_could_move_a_robot(message_type, data):
    message = data.draw(MESSAGES[message_type])
    wire = encode(message) + added(len(getattr(pb, message_type.__name__).DESCRIPTOR.fields) + 1)
    if message_type in LEADING_TO_MOTION:
        with pytest.raises(MessageError, match="has fields that this version does not know"):
            decode(message_type, wire)
    else:
        assert same(decode(message_type, wire), message)


def test_what_a_newer_version_added_within_a_plan_is_refused_and_within_observations_left_out():
    wire = observed()
    wire.camera.MergeFromString(added(900))
    assert decode(ThreadObservations, wire.SerializeToString()).camera.fx_px == 100.0
    goal = pb.GraspGoal()
    goal.header.MergeFromString(added(900))
    with pytest.raises(MessageError, match=r"GraspGoal.header has fields that this version does not know"):
        decode(GraspGoal, goal.SerializeToString())


def test_a_known_number_of_another_kind_is_damage():
    text_for_a_number = b"\x12\x01x"
    with pytest.raises(MessageError, match=r"Consumed has fields that this version does not know \(numbers 2\)"):
        decode(Consumed, encode(Consumed("k", 1, 2)) + text_for_a_number)


def test_no_bytes_are_no_message():
    with pytest.raises(MessageError, match=r"StereoFrame\.stamp is missing"):
        decode(StereoFrame, b"")


def test_an_unfinished_field_is_named_as_damage():
    with pytest.raises(MessageError, match="StereoFrame cannot be read: its 2 bytes are damaged or of another type"):
        decode(StereoFrame, b"\x0a\x7f")


def test_text_that_is_not_utf8_is_refused():
    with pytest.raises(MessageError, match="Judgement cannot be read"):
        decode(Judgement, b"\x0a\x02\xff\xfe")


def test_an_oversized_message_is_refused_unparsed():
    with pytest.raises(MessageError, match="Image is too large"):
        decode(Image, bytes(MAX_MESSAGE_BYTES + 1))


def test_absurd_but_finite_numbers_are_refused_quietly():
    wire = pb.StereoCalibration(image_width=2, image_height=2)
    for name, value in (("K_left", np.eye(3)), ("K_right", np.eye(3)), ("T_right_left", np.eye(4) * 1e300)):
        value[-1, -1] = 1
        getattr(wire, name).MergeFrom(pb.Array(dtype="<f8", shape=value.shape, data=value.tobytes()))
    for name in ("distortion_left", "distortion_right"):
        getattr(wire, name).MergeFrom(pb.Array(dtype="<f8", shape=[0], data=b""))
    with pytest.raises(MessageError, match="not orthonormal"):
        decode(StereoCalibration, wire.SerializeToString())


def test_a_number_beyond_its_field_cannot_be_sent():
    with pytest.raises(MessageError, match=r"FrameStamp\.capture_left_ns cannot be sent"):
        encode(FrameStamp(1, 2**63, 0, "c"))


def test_text_with_half_a_surrogate_pair_cannot_be_sent():
    with pytest.raises(MessageError, match=r"ThreadObservations\.judgements\[0\]\.code cannot be sent"):
        message = decode(ThreadObservations, observed().SerializeToString())
        encode(dataclasses.replace(message, judgements=(Judgement("\ud800", Severity.NOTE, "f", "r"),)))


def test_an_array_in_another_byte_order_arrives_with_its_values():
    message = decode(ThreadObservations, observed().SerializeToString())
    swapped = dataclasses.replace(message, points_camera=message.points_camera.astype(">f8"))
    assert np.array_equal(decode(ThreadObservations, encode(swapped)).points_camera, message.points_camera)


def test_a_strided_array_arrives_with_its_values():
    message = decode(ThreadObservations, observed().SerializeToString())
    strided = np.arange(1.0, 13.0).reshape(2, 6)[:, ::2]
    sent = dataclasses.replace(message, points_camera=strided)
    assert np.array_equal(decode(ThreadObservations, encode(sent)).points_camera, strided)


def test_an_unknown_unit_and_a_known_one_are_told_apart():
    unknown = RectifiedStereo(2, 1, 100.0, 100.0, 1.0, 0.5, 5.0, None)
    known = dataclasses.replace(unknown, metres_per_unit=1e-3)
    assert decode(RectifiedStereo, encode(unknown)).metres_per_unit is None
    assert decode(RectifiedStereo, encode(known)).metres_per_unit == 1e-3


def test_a_stamp_of_zeros_is_present_on_the_wire():
    raw = Image(ImageEncoding.RAW, 1, 1, 1, b"\0")
    frame = StereoFrame(FrameStamp(0, 0, 0, ""), raw, raw)
    assert decode(StereoFrame, encode(frame)) == frame


def test_text_of_every_printable_character_survives():
    judgement = Judgement(string.printable, Severity.FAULT, "ε_z = 1.5 |L(o) − o|", "縫合糸")
    assert decode(Judgement, encode(judgement)) == judgement
