"""A network of the Segment Anything kind's signature that has learnt nothing: what has the colour of a prompt is meant.

The encoder keeps the mean colours of the square's 4 x 4 px cells; the decoder looks up those at the points, and a pixel
of the mask is thread by how near its colour comes to one of them. Wrong colours, normalisation, padding, coordinates or
order of channels give wrong masks. The files are ONNX, written field by field: it takes no more than their numbers.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from agents.perception.segmentation.promptable_model import PromptableFiles

SIDE, CELLS, MASK = 1024, 64, 256
MEAN, DEVIATION = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)
ALIKE = 0.6
"""Squared distance of normalised colours up to which they count as one."""
SHARPNESS = 8.0
FLOAT, INT64 = 1, 7


def varint(value: int) -> bytes:
    value &= (1 << 64) - 1
    parts = []
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    return bytes([*parts, value])


def field(number: int, value: int | str | bytes) -> bytes:
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    raw = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(raw)) + raw


def attribute(name: str, value: int | str | list[int]) -> bytes:
    match value:
        case int():
            return field(1, name) + field(3, value) + field(20, 2)
        case str():
            return field(1, name) + field(4, value) + field(20, 3)
        case _:
            return field(1, name) + b"".join(field(8, n) for n in value) + field(20, 7)


def node(kind: str, inputs: Iterable[str], output: str, **attributes: int | str | list[int]) -> bytes:
    parts = [field(1, name) for name in inputs] + [field(2, output), field(3, output), field(4, kind)]
    return b"".join(parts + [field(5, attribute(name, value)) for name, value in attributes.items()])


def tensor(name: str, values: np.ndarray) -> bytes:
    kind, raw = (INT64, np.int64) if values.dtype.kind == "i" else (FLOAT, np.float32)
    dims = b"".join(field(1, n) for n in values.shape)
    return dims + field(2, kind) + field(8, name) + field(9, np.ascontiguousarray(values, raw).tobytes())


def value(name: str, shape: tuple[int | str, ...]) -> bytes:
    dims = b"".join(field(1, field(2 if isinstance(n, str) else 1, n)) for n in shape)
    return field(1, name) + field(2, field(1, field(1, FLOAT) + field(2, dims)))


def model(
    nodes: list[bytes],
    weights: dict[str, np.ndarray],
    inputs: Mapping[str, tuple[int | str, ...]],
    outputs: Mapping[str, tuple[int | str, ...]],
) -> bytes:
    graph = b"".join(field(1, n) for n in nodes) + field(2, "tiny")
    graph += b"".join(field(5, tensor(name, array)) for name, array in weights.items())
    graph += b"".join(field(11, value(*one)) for one in inputs.items())
    graph += b"".join(field(12, value(*one)) for one in outputs.items())
    return field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 17))


def encoder(hq: bool = False, whole: bool = False, first_alone: bool = False, name: str = "input_image") -> bytes:
    """An encoder; `hq`: whose colours come in interm_embeddings alone; `whole`: that takes images as they are.

    `first_alone`: that gives the first of its four interm_embeddings alone.
    """
    weights, nodes = {"channels": np.array([0, 0, 0, 0, 0, 256 - 48, 0, 0])}, []
    taken: dict[str, tuple[int | str, ...]] = {name: (1, 3, SIDE, SIDE)}
    square = name
    if whole:
        taken = {name: ("image_height", "image_width", 3)}
        weights |= {"mean": np.array(MEAN), "deviation": np.array(DEVIATION), "side": np.array([3, SIDE, SIDE])}
        weights |= {"none": np.zeros(3, np.int64), "first": np.array([0])}
        nodes = [
            node("Sub", (name, "mean"), "centred"),
            node("Div", ("centred", "deviation"), "normal"),
            node("Transpose", ("normal",), "planes", perm=[2, 0, 1]),
            node("Shape", ("planes",), "size"),
            node("Sub", ("side", "size"), "lacking"),
            node("Concat", ("none", "lacking"), "pads", axis=0),
            node("Pad", ("planes", "pads"), "padded", mode="constant"),
            node("Unsqueeze", ("padded", "first"), "square"),
        ]
        square = "square"
    given: dict[str, tuple[int | str, ...]] = {"image_embeddings": (1, 256, CELLS, CELLS)}
    nodes += [
        node("AveragePool", (square,), "cells", kernel_shape=[4, 4], strides=[4, 4]),
        node("SpaceToDepth", ("cells",), "deep", blocksize=4),
        node("Pad", ("deep", "channels"), "colours" if hq else "image_embeddings", mode="constant"),
    ]
    if hq:
        weights |= {"nothing": np.zeros(1, np.float32), "front": np.array([0])}
        nodes += [
            node("Mul", ("colours", "nothing"), "image_embeddings"),
            node("Transpose", ("colours",), "last", perm=[0, 2, 3, 1]),
            node("Concat", ("last", "last", "last"), "interm_embeddings" if first_alone else "wide", axis=3),
        ]
        given["interm_embeddings"] = (1, CELLS, CELLS, 768) if first_alone else (4, 1, CELLS, CELLS, 768)
    if hq and not first_alone:
        nodes += [
            node("Unsqueeze", ("wide", "front"), "one"),
            node("Mul", ("one", "nothing"), "empty"),
            node("Concat", ("one", "empty", "empty", "empty"), "interm_embeddings", axis=0),
        ]
    return model(nodes, weights, taken, given)


def likeness() -> list[bytes]:
    """Of a decoder, from the embedded colours to the logits: how like the colour at the nearest point each pixel is."""
    return [
        node("Slice", ("embedded", "zero", "used", "one"), "colours"),
        node("DepthToSpace", ("colours",), "pixels", blocksize=4, mode="DCR"),
        node("Reshape", ("pixels", "flat"), "image"),
        node("Transpose", ("image",), "by_pixel", perm=[1, 0]),
        # where the points lie in the mask
        node("Add", ("point_coords", "half"), "middle"),
        node("Mul", ("middle", "quarter"), "place"),
        node("Slice", ("place", "zero", "one", "two"), "point_u"),
        node("Slice", ("place", "one", "two", "two"), "point_v"),
        node("Sub", ("point_u", "u"), "du"),
        node("Sub", ("point_v", "v"), "dv"),
        node("Mul", ("du", "du"), "du2"),
        node("Mul", ("dv", "dv"), "dv2"),
        node("Add", ("du2", "dv2"), "away"),
        node("Mul", ("away", "narrow"), "steep"),
        # OpenCV's softmax makes NaN of what is far below
        node("Max", ("steep", "least"), "exponent"),
        node("Softmax", ("exponent",), "share", axis=2),
        node("MatMul", ("share", "by_pixel"), "colour"),
        # how far each pixel's colour is from that of each point
        node("MatMul", ("colour", "image"), "product"),
        node("Mul", ("product", "twice"), "products"),
        node("Mul", ("colour", "colour"), "colour2"),
        node("ReduceSum", ("colour2", "two"), "of_point", keepdims=1),
        node("Mul", ("image", "image"), "image2"),
        node("ReduceSum", ("image2", "zero"), "of_pixel", keepdims=1),
        node("Sub", ("of_point", "products"), "part"),
        node("Add", ("part", "of_pixel"), "distance"),
        # a point that is not on the thread, or is padding, means nothing
        node("Sub", ("point_labels", "thread"), "not_thread"),
        node("Abs", ("not_thread",), "other_label"),
        node("Mul", ("other_label", "far"), "penalty"),
        node("Unsqueeze", ("penalty", "two"), "penalties"),
        node("Add", ("distance", "penalties"), "distances"),
        node("ReduceMin", ("distances",), "nearest", axes=[1], keepdims=1),
        node("Sub", ("alike", "nearest"), "likeness"),
        node("Mul", ("likeness", "sharp"), "logit"),
        node("Reshape", ("logit", "mask_shape"), "logits"),
    ]


def decoder(hq: bool = False, several: bool = False, without: str = "") -> bytes:
    """A decoder that gives one mask, or four, of which the second is everything and the one that it likes best."""
    v, u = np.divmod(np.arange(MASK * MASK), MASK) + np.array([[0.5], [0.5]])
    weights = {
        "u": u.reshape(1, 1, -1), "v": v.reshape(1, 1, -1), "half": np.array([0.5]), "quarter": np.array([0.25]),
        "zero": np.array([0]), "one": np.array([1]), "two": np.array([2]), "narrow": np.array([-1.4]),
        "used": np.array([48]), "flat": np.array([3, -1]), "thread": np.array([1.0]), "far": np.array([1e4]),
        "twice": np.array([2.0]), "alike": np.array([ALIKE]), "sharp": np.array([SHARPNESS]),
        "least": np.array([-80.0]), "mask_shape": np.array([1, 1, MASK, MASK]),
    }  # fmt: skip
    takes: dict[str, tuple[int | str, ...]] = {"image_embeddings": (1, 256, CELLS, CELLS)}
    nodes = [node("Identity", ("image_embeddings",), "embedded")]
    if hq:
        takes["interm_embeddings"] = (4, 1, CELLS, CELLS, 768)
        weights["first"] = np.array(0)
        nodes = [
            node("Gather", ("interm_embeddings", "first"), "early", axis=0),
            node("Transpose", ("early",), "planes", perm=[0, 3, 1, 2]),
            node("Slice", ("planes", "zero", "used", "one"), "some"),
            # a decoder reads both embeddings, and here the other one holds nothing
            node("Slice", ("image_embeddings", "zero", "used", "one"), "other"),
            node("Add", ("some", "other"), "embedded"),
        ]
    takes |= {
        "point_coords": (1, "num_points", 2),
        "point_labels": (1, "num_points"),
        "mask_input": (1, 1, MASK, MASK),
        "has_mask_input": (1,),
        "orig_im_size": (2,),
    }
    nodes += [
        *likeness(),
        node("Mul", ("mask_input", "has_mask_input"), "given_mask"),
        node("Add", ("logits", "given_mask"), "low_res_masks" if not several else "found"),
    ]
    count = 4 if several else 1
    weights["scores"] = np.array([[0.5, 0.95, 0.9, 0.1]])[:, :count]
    nodes.append(node("Mul", ("scores", "thread"), "iou_predictions"))
    if several:
        weights |= {"everything": np.full((1, 1, MASK, MASK), 5.0), "less": np.full((1, 1, MASK, MASK), -5.0)}
        nodes.append(node("Concat", ("found", "everything", "found", "less"), "low_res_masks", axis=1))
    weights |= {"count": np.array([1, count])}
    nodes += [
        node("Cast", ("orig_im_size",), "whole_size", to=INT64),
        node("Concat", ("count", "whole_size"), "sizes", axis=0),
        node("Resize", ("low_res_masks", "", "", "sizes"), "masks", mode="linear"),
    ]
    gives: dict[str, tuple[int | str, ...]] = {
        "masks": (1, count, "height", "width"),
        "iou_predictions": (1, count),
        "low_res_masks": (1, count, MASK, MASK),
    }
    if without:
        takes.pop(without, None)
        gives.pop(without, None)
    return model(nodes, weights, takes, gives)


def write_tiny(
    folder: Path, *, hq: bool = True, several: bool = False, whole: bool = False, first_alone: bool = False
) -> PromptableFiles:
    """Both files in a folder."""
    files = PromptableFiles(folder / "tiny_encoder.onnx", folder / "tiny_decoder.onnx")
    files.encoder.write_bytes(encoder(hq, whole, first_alone))
    files.decoder.write_bytes(decoder(hq, several))
    return files
