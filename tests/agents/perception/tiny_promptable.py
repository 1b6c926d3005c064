"""A network of the Segment Anything kind's signature that has learnt nothing: what has the colour of a prompt is meant.

The encoder keeps the mean colours of the square's 4 x 4 px cells; the decoder looks up those at the points, and a pixel
of the mask is thread by how near its colour comes to one of them. Wrong colours, normalisation, padding, coordinates or
order of channels give wrong masks. The files are ONNX, written field by field: it takes no more than their numbers.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from agents.perception.segmentation.promptable_model import PromptableFiles

SIDE, CELLS, MASK = 1024, 64, 256
ALIKE = 0.6
"""Squared distance of normalised colours up to which they count as one."""
FLOAT, INT64 = 1, 7
Shapes = Mapping[str, tuple[int | str, ...]]


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


def attribute(name: str, value: str) -> bytes:
    """A list of numbers where there is a comma, a number, or a word."""
    if "," in value:
        return field(1, name) + b"".join(field(8, int(n)) for n in value.split(",") if n) + field(20, 7)
    if value.isdigit():
        return field(1, name) + field(3, int(value)) + field(20, 2)
    return field(1, name) + field(4, value) + field(20, 3)


def node(line: str) -> bytes:
    """Of `output = Kind input input; attribute=value attribute=value`; the input _none is left out."""
    output, rest = line.split(" = ")
    (kind, *inputs), attributes = (part.split() for part in f"{rest};".split(";")[:2])
    parts = [field(1, name.replace("_none", "")) for name in inputs] + [field(2, output), field(3, output)]
    pairs = [pair.split("=") for pair in attributes]
    return b"".join([*parts, field(4, kind), *(field(5, attribute(*pair)) for pair in pairs)])


def tensor(name: str, values: np.ndarray) -> bytes:
    kind, raw = (INT64, np.int64) if values.dtype.kind == "i" else (FLOAT, np.float32)
    dims = b"".join(field(1, n) for n in values.shape)
    return dims + field(2, kind) + field(8, name) + field(9, np.ascontiguousarray(values, raw).tobytes())


def value(name: str, shape: tuple[int | str, ...]) -> bytes:
    dims = b"".join(field(1, field(2 if isinstance(n, str) else 1, n)) for n in shape)
    return field(1, name) + field(2, field(1, field(1, FLOAT) + field(2, dims)))


def model(nodes: str, weights: Mapping[str, object], inputs: Shapes, outputs: Shapes) -> bytes:
    graph = b"".join(field(1, node(line.strip())) for line in nodes.split("\n") if line.strip()) + field(2, "tiny")
    graph += b"".join(field(5, tensor(name, np.asarray(array))) for name, array in weights.items())
    graph += b"".join(field(11, value(*one)) for one in inputs.items())
    graph += b"".join(field(12, value(*one)) for one in outputs.items())
    return field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 17))


AS_THEY_ARE = """
    centred = Sub input_image mean
    normal = Div centred deviation
    planes = Transpose normal; perm=2,0,1
    size = Shape planes
    lacking = Sub side size
    pads = Concat none lacking; axis=0
    padded = Pad planes pads; mode=constant
    square = Unsqueeze padded first
"""
IN_INTERM = """
    image_embeddings = Mul colours nothing
    last = Transpose colours; perm=0,2,3,1
    wide = Concat last last last; axis=3
"""
FIRST_OF_FOUR = """
    one = Unsqueeze wide first
    empty = Mul one nothing
    interm_embeddings = Concat one empty empty empty; axis=0
"""


def encoder(hq: bool = False, whole: bool = False, first_alone: bool = False) -> bytes:
    """An encoder; `hq`: whose colours come in interm_embeddings alone; `whole`: that takes images as they are.

    `first_alone`: that gives the first of its four interm_embeddings alone.
    """
    colours = "colours" if hq else "image_embeddings"
    nodes = AS_THEY_ARE if whole else ""
    nodes += f"""
        cells = AveragePool {"square" if whole else "input_image"}; kernel_shape=4,4 strides=4,4
        deep = SpaceToDepth cells; blocksize=4
        {colours} = Pad deep channels; mode=constant
    """
    if hq and first_alone:
        nodes += IN_INTERM.replace("wide", "interm_embeddings")
    elif hq:
        nodes += IN_INTERM + FIRST_OF_FOUR
    weights = {"channels": [0, 0, 0, 0, 0, 256 - 48, 0, 0], "first": [0], "none": [0, 0, 0]}
    weights |= {"mean": [123.675, 116.28, 103.53], "deviation": [58.395, 57.12, 57.375], "side": [3, SIDE, SIDE]}
    taken: Shapes = {"input_image": ("image_height", "image_width", 3) if whole else (1, 3, SIDE, SIDE)}
    given: Shapes = {"image_embeddings": (1, 256, CELLS, CELLS)}
    interm: Shapes = {"interm_embeddings": (1, CELLS, CELLS, 768) if first_alone else (4, 1, CELLS, CELLS, 768)}
    return model(nodes, {**weights, "nothing": [0.0]}, taken, {**given, **interm} if hq else given)


# a decoder reads both embeddings, and here the other one holds nothing
FROM_INTERM = """
    early = Gather interm_embeddings at_first; axis=0
    planes = Transpose early; perm=0,3,1,2
    some = Slice planes zero used one
    other = Slice image_embeddings zero used one
    embedded = Add some other
"""
# the colours at the points; OpenCV's softmax makes NaN of what is far below
COLOURS = """
    colours = Slice embedded zero used one
    pixels = DepthToSpace colours; blocksize=4 mode=DCR
    image = Reshape pixels flat
    by_pixel = Transpose image; perm=1,0
    middle = Add point_coords half
    place = Mul middle quarter
    point_u = Slice place zero one two
    point_v = Slice place one two two
    du = Sub point_u u
    dv = Sub point_v v
    du2 = Mul du du
    dv2 = Mul dv dv
    away = Add du2 dv2
    steep = Mul away narrow
    exponent = Max steep least
    share = Softmax exponent; axis=2
    colour = MatMul share by_pixel
"""
# how far each pixel's colour is from that of each point; one that is not on the thread, or is padding, means nothing
LOGITS = """
    product = MatMul colour image
    products = Mul product twice
    colour2 = Mul colour colour
    of_point = ReduceSum colour2 two; keepdims=1
    image2 = Mul image image
    of_pixel = ReduceSum image2 zero; keepdims=1
    part = Sub of_point products
    distance = Add part of_pixel
    not_thread = Sub point_labels thread
    other_label = Abs not_thread
    penalty = Mul other_label far
    penalties = Unsqueeze penalty two
    distances = Add distance penalties
    nearest = ReduceMin distances; axes=1, keepdims=1
    likeness = Sub alike nearest
    logit = Mul likeness sharp
    logits = Reshape logit mask_shape
    given_mask = Mul mask_input has_mask_input
    found = Add logits given_mask
"""
MASKS = """
    iou_predictions = Mul scores thread
    whole_size = Cast orig_im_size; to=7
    sizes = Concat count whole_size; axis=0
    masks = Resize low_res_masks _none _none sizes; mode=linear
"""


def decoder(hq: bool = False, several: bool = False, without: str = "") -> bytes:
    """A decoder that gives one mask, or four, of which the second is everything and the one that it likes best."""
    v, u = np.divmod(np.arange(MASK * MASK), MASK) + np.array([[0.5], [0.5]])
    count = 4 if several else 1
    weights = {
        "u": u.reshape(1, 1, -1), "v": v.reshape(1, 1, -1), "half": [0.5], "quarter": [0.25], "zero": [0], "one": [1],
        "two": [2], "narrow": [-1.4], "used": [48], "flat": [3, -1], "thread": [1.0], "far": [1e4], "twice": [2.0],
        "alike": [ALIKE], "sharp": [8.0], "least": [-80.0], "mask_shape": [1, 1, MASK, MASK], "at_first": 0,
        "count": [1, count], "scores": [[0.5, 0.95, 0.9, 0.1][:count]],
    }  # fmt: skip
    if several:
        weights |= {"everything": np.full((1, 1, MASK, MASK), 5.0), "less": np.full((1, 1, MASK, MASK), -5.0)}
    takes: Shapes = {
        "image_embeddings": (1, 256, CELLS, CELLS),
        "interm_embeddings": (4, 1, CELLS, CELLS, 768),
        "point_coords": (1, "num_points", 2),
        "point_labels": (1, "num_points"),
        "mask_input": (1, 1, MASK, MASK),
        "has_mask_input": (1,),
        "orig_im_size": (2,),
    }
    gives: Shapes = {
        "masks": (1, count, "height", "width"),
        "iou_predictions": (1, count),
        "low_res_masks": (1, count, MASK, MASK),
    }
    taken = {name: shape for name, shape in takes.items() if name != without and (hq or name != "interm_embeddings")}
    nodes = (FROM_INTERM if hq else "embedded = Identity image_embeddings") + COLOURS + LOGITS
    nodes += f"low_res_masks = {'Concat found everything found less; axis=1' if several else 'Identity found'}" + MASKS
    return model(nodes, weights, taken, {name: shape for name, shape in gives.items() if name != without})


def write_tiny(
    folder: Path, *, hq: bool = True, several: bool = False, whole: bool = False, first_alone: bool = False
) -> PromptableFiles:
    """Both files in a folder."""
    files = PromptableFiles(folder / "tiny_encoder.onnx", folder / "tiny_decoder.onnx")
    files.encoder.write_bytes(encoder(hq, whole, first_alone))
    files.decoder.write_bytes(decoder(hq, several))
    return files
