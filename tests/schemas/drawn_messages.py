"""Hypothesis strategies for messages of every type of the schema.

A message begins as a released recording has one, or with fields as they are annotated. Then its fields are drawn anew,
alone and with their neighbours, and stay as they were where its own checks do not take what was drawn.
"""

import contextlib
import dataclasses
import enum
import itertools
import typing
from collections import defaultdict

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from hypothesis import reject
from hypothesis import strategies as st

from schemas import messages
from schemas.checks import MessageError, fields_of, is_array, without_none
from schemas.codec import decode
from schemas.topics import topic_of
from schemas.wire import wire_type
from shared.recording.mcap_file import read_recording
from tests.schemas.freeze import RELEASED

SMALL = messages.Image(messages.ImageEncoding.RAW, 3, 2, 1, bytes(range(6)))
EDGES = st.floats(-1e6, 1e6) | st.floats(0, 1)
SCALARS = {bool: st.booleans(), bytes: st.binary(max_size=40)}
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
WHOLE_NUMBERS = {
    FieldDescriptor.CPPTYPE_INT64: st.integers(-(2**63), 2**63 - 1),
    FieldDescriptor.CPPTYPE_UINT64: st.integers(0, 2**64 - 1),
    FieldDescriptor.CPPTYPE_UINT32: st.integers(0, 2**32 - 1),
}


def with_small_images(value):
    if isinstance(value, messages.Image):
        return SMALL
    if dataclasses.is_dataclass(value):
        return dataclasses.replace(value, **{name: with_small_images(one) for name, one in vars(value).items()})
    return tuple(map(with_small_images, value)) if isinstance(value, tuple) else value


def recorded():
    """The messages of released recordings by their types, and those within them."""
    found = defaultdict(list)

    def keep(value):
        if isinstance(value, messages.ThreadReconstruction) and value.status is messages.Status.OK:
            # no release has recorded one yet
            found[messages.Strand].append(value.as_strand)
        if dataclasses.is_dataclass(value):
            found[type(value)].append(value)
        for part in vars(value).values() if dataclasses.is_dataclass(value) else value:
            if dataclasses.is_dataclass(part) or isinstance(part, tuple):
                keep(part)

    for path in sorted(RELEASED.glob("*/recording.mcap")):
        for entry in read_recording(path):
            keep(with_small_images(decode(topic_of(entry.key).message, entry.payload)))
    return found


RECORDED = recorded()


@st.composite
def message(draw, message_type):
    """A message of that type."""
    fields = fields_of(message_type)

    def of_fields(numbers, texts, was=None):
        return {
            name: draw(value_of(message_type, name, numbers, texts, vars(was)[name] if was else None))
            for name in fields
        }

    if message_type in RECORDED:
        made = draw(st.sampled_from(RECORDED[message_type]))
    else:
        try:
            made = message_type(**of_fields(st.floats(0.5, 1), TEXTS.filter(bool)))
        except MessageError:
            reject()
    anew = of_fields(EDGES, TEXTS, made)
    for names in (*((name,) for name in fields), *itertools.pairwise(fields)):
        with contextlib.suppress(MessageError):
            made = dataclasses.replace(made, **{name: anew[name] for name in names})
    return made


@st.composite
def value_of(draw, message_type, name, numbers, texts, was):
    """A value of a field as it is annotated; an array is of the shape that it was."""
    annotation = fields_of(message_type)[name]
    declared = without_none(annotation)
    if declared is not annotation and draw(st.booleans()):
        return None
    if is_array(declared):
        axes = [int(axis) if axis.isdigit() else 2 for axis in declared.dim_str.split()]
        random = np.random.default_rng(draw(st.integers(0, 99)))
        values = np.sort(random.uniform(0.5, 1, axes if was is None else was.shape))
        scale = 256 if declared.dtypes[0] in ("uint8", "int64") else 1
        return (values * scale).astype(declared.dtypes[0]) if "bool" not in declared.dtypes[0] else values > 0.75
    if declared is int:
        on_the_wire = wire_type(message_type).DESCRIPTOR.fields_by_name[name]
        return draw(st.integers(0, 9) | WHOLE_NUMBERS[on_the_wire.cpp_type])
    if declared in (float, str):
        return draw(numbers if declared is float else texts)
    if typing.get_origin(declared) is tuple:
        return tuple(draw(st.lists(message(typing.get_args(declared)[0]), max_size=2)))
    if dataclasses.is_dataclass(declared):
        return draw(message(declared))
    return draw(st.sampled_from(declared) if issubclass(declared, enum.Enum) else SCALARS[declared])


MESSAGES = {
    declared: message(declared)
    for declared in (getattr(messages, name) for name in messages.__all__)
    if dataclasses.is_dataclass(declared)
}
