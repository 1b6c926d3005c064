"""A promptable network as published: an encoder and a decoder of the Segment Anything kind, as ONNX files.

The decoder's layout is the one that the official export scripts of Segment Anything, HQ-SAM and MobileSAM write (each
`scripts/export_onnx_model.py`): image_embeddings, with HQ-SAM interm_embeddings too, point_coords, point_labels,
mask_input, has_mask_input and orig_im_size to masks, iou_predictions and low_res_masks. There is no official script for
encoders; those in use take one image, normalised and padded (1 x 3 x 1024 x 1024) or as it is (h x w x 3), and give the
embeddings.

Only low_res_masks is used of the masks: the enlarging inside some exported decoders holds for one shape of image only.

What an ONNX file takes and gives is read from its outermost fields alone: a file of weights has gigabytes, and OpenCV
tells the names of what a network gives, not of what it takes. The wire format of protobuf names the length of every
field, so that all others are stepped over unread. Fields as numbered in ONNX's onnx.proto: ModelProto.graph 7;
GraphProto.initializer 5, input 11, output 12; TensorProto.name 8; ValueInfoProto.name 1, type 2; TypeProto.tensor_type
1; its shape 2, dim 1; Dimension.dim_value 1.
"""

import hashlib
import mmap
import threading
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from agents.perception.segmentation.promptable_crop import encoder_input, fitted, logits_of_crop, network_points

VARINT, EIGHT_BYTES, LENGTH, FOUR_BYTES = 0, 1, 2, 5
"""Kinds of fields on the wire."""
LONGEST_VARINT = 10

Shape = tuple[int | None, ...]
Field = tuple[int, int, int, int]
"""Number, kind, and where the value begins and ends; of a varint, its value in place of the beginning."""


class NotOnnxError(ValueError):
    """Bytes that are no ONNX model."""


@dataclass(frozen=True)
class Signature:
    """Names and shapes of what a network takes and gives; None in a shape is a side that may have any length."""

    inputs: dict[str, Shape]
    outputs: dict[str, Shape]


def signature_of(path: Path) -> Signature:
    """What the ONNX file takes and gives.

    Raises:
        OSError: where it cannot be read.
        NotOnnxError: where it is none.
    """
    with path.open("rb") as file:
        try:
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            raise NotOnnxError("it is empty") from None
        with data:
            graphs = [
                (begin, end)
                for number, kind, begin, end in _fields(data, 0, len(data))
                if (number, kind) == (7, LENGTH)
            ]
            if not graphs:
                raise NotOnnxError("it holds no graph")
            return _graph(data, *graphs[-1])


def _graph(data: mmap.mmap, begin: int, end: int) -> Signature:
    parts: dict[int, list[tuple[int, int]]] = {5: [], 11: [], 12: []}
    for number, kind, first, last in _fields(data, begin, end):
        if kind == LENGTH and number in parts:
            parts[number].append((first, last))
    # up to version 3 of the format, weights are listed as inputs too
    weights = {_text(data, *at) for part in parts[5] for at in _inside(data, part, 8)}
    inputs, outputs = (dict(_value(data, part) for part in parts[number]) for number in (11, 12))
    return Signature({name: shape for name, shape in inputs.items() if name not in weights}, outputs)


def _value(data: mmap.mmap, part: tuple[int, int]) -> tuple[str, Shape]:
    names = [_text(data, *at) for at in _inside(data, part, 1)]
    dimensions = [part]
    for number in (2, 1, 2, 1):
        dimensions = [at for outer in dimensions for at in _inside(data, outer, number)]
    return (names or [""])[-1], tuple(_length(data, at) for at in dimensions)


def _length(data: mmap.mmap, part: tuple[int, int]) -> int | None:
    for number, kind, value, _ in _fields(data, *part):
        if (number, kind) == (1, VARINT):
            return value
    return None


def _inside(data: mmap.mmap, part: tuple[int, int], wanted: int) -> list[tuple[int, int]]:
    return [(begin, end) for number, kind, begin, end in _fields(data, *part) if (number, kind) == (wanted, LENGTH)]


def _text(data: mmap.mmap, begin: int, end: int) -> str:
    return data[begin:end].decode("utf-8", "replace")


def _fields(data: mmap.mmap, begin: int, end: int) -> Iterator[Field]:
    at = begin
    while at < end:
        tag, at = _varint(data, at, end)
        number, kind = tag >> 3, tag & 7
        if kind == VARINT:
            value, at = _varint(data, at, end)
            yield number, kind, value, at
            continue
        if kind == LENGTH:
            length, at = _varint(data, at, end)
        elif kind in (EIGHT_BYTES, FOUR_BYTES):
            length = 8 if kind == EIGHT_BYTES else 4
        else:
            raise NotOnnxError("its bytes are no protobuf message")
        if number == 0 or at + length > end:
            raise NotOnnxError("its bytes are no protobuf message, or it is cut off")
        yield number, kind, at, at + length
        at += length


def _varint(data: mmap.mmap, at: int, end: int) -> tuple[int, int]:
    value = 0
    for k in range(LONGEST_VARINT):
        if at + k >= end:
            break
        byte = data[at + k]
        value |= (byte & 127) << (7 * k)
        if byte < 128:
            return value, at + k + 1
    raise NotOnnxError("its bytes are no protobuf message, or it is cut off")


IMAGE, INTERMEDIATE = "image_embeddings", "interm_embeddings"
POINTS, LABELS, LOW, SCORES = "point_coords", "point_labels", "low_res_masks", "iou_predictions"
DECODER_INPUTS = {IMAGE, POINTS, LABELS, "mask_input", "has_mask_input", "orig_im_size"}
DECODER_OUTPUTS = {LOW, SCORES}
MASK_SIDE_PX = 256
SIDE_PX = 1024
LONGEST_CLAUSE = 160
"""Characters of what OpenCV says about a file."""
TRIAL_CROP_PX = 64


class PromptableFileError(ValueError):
    """Files of a promptable network that cannot be used; the text names the file, what is wrong and what to do."""


@dataclass(frozen=True)
class PromptableFiles:
    """Where the two files lie, and the SHA-256 that each should have; none is checked where it is None."""

    encoder: Path
    decoder: Path
    encoder_sha256: str | None = None
    decoder_sha256: str | None = None


@dataclass(frozen=True)
class Embedded:
    """A crop as the decoder wants it.

    Fields:
        size: of the crop, height and width in pixels.
    """

    embeddings: dict[str, Float32[np.ndarray, "..."]]
    size: tuple[int, int]


class PromptableModel:
    """Both networks, run by OpenCV; one crop at a time, whichever thread asks."""

    def __init__(self, files: PromptableFiles) -> None:
        """Read both files and try them once on a grey crop.

        Raises:
            PromptableFileError: where a file is missing, is another than expected, or is no such network.
        """
        self._one_at_a_time = threading.Lock()
        self._takes, encoder = _read(files.encoder, files.encoder_sha256, "promptable_encoder")
        wants, decoder = _read(files.decoder, files.decoder_sha256, "promptable_decoder")
        _check_encoder(files.encoder, self._takes, INTERMEDIATE in wants.inputs)
        _check_decoder(files.decoder, wants)
        self._embeddings = _names_of_embeddings(self._takes, wants)
        self._encoder = _imported(files.encoder, "promptable_encoder")
        self._decoder = _imported(files.decoder, "promptable_decoder")
        self._encoder_outputs, self._decoder_outputs = encoder, decoder
        self._wanted_intermediate = wants.inputs.get(INTERMEDIATE, ())
        self._try(files)

    def embed(self, crop: UInt8[np.ndarray, "h w 3"]) -> Embedded:
        """The embeddings of a crop, blue first; by far most of the work."""
        ((name, shape),) = self._takes.inputs.items()
        with self._one_at_a_time:
            self._encoder.setInput(encoder_input(crop, len(shape) == 4), name)
            given = dict(zip(self._encoder_outputs, self._encoder.forward(self._encoder_outputs), strict=True))
        embeddings = {wanted: np.asarray(given[name], np.float32) for wanted, name in self._embeddings.items()}
        if INTERMEDIATE in embeddings and embeddings[INTERMEDIATE].ndim + 1 == len(self._wanted_intermediate):
            # some encoders give the first of the four alone, which is the only one that the decoder reads
            count = self._wanted_intermediate[0] or 1
            embeddings[INTERMEDIATE] = np.repeat(embeddings[INTERMEDIATE][None], count, axis=0)
        return Embedded(embeddings, (crop.shape[0], crop.shape[1]))

    def masks(
        self, embedded: Embedded, point_px: Float64[np.ndarray, "n 2"], is_thread: Bool[np.ndarray, "n"]
    ) -> tuple[Float32[np.ndarray, "m h w"], Float32[np.ndarray, "m"]]:
        """Logits of the crop's pixels, thread where above 0, and the network's own estimate of how good each mask is.

        Args:
            point_px: u and v of prompts in the crop.
            is_thread: whether each lies on the thread; else it lies beside it.
        """
        low, scores = self._decode(embedded, point_px, is_thread)
        return np.stack([logits_of_crop(mask, embedded.size) for mask in low[0]]), scores[0]

    def _decode(
        self, embedded: Embedded, point_px: Float64[np.ndarray, "n 2"], is_thread: Bool[np.ndarray, "n"]
    ) -> tuple[Float32[np.ndarray, "1 m a b"], Float32[np.ndarray, "1 m"]]:
        points, labels = network_points(point_px, is_thread, embedded.size)
        inputs = embedded.embeddings | {
            POINTS: points,
            LABELS: labels,
            "mask_input": np.zeros((1, 1, MASK_SIDE_PX, MASK_SIDE_PX), np.float32),
            "has_mask_input": np.zeros(1, np.float32),
            # as large as the mask itself: what the decoder makes of this is not used
            "orig_im_size": np.full(2, MASK_SIDE_PX, np.float32),
        }
        with self._one_at_a_time:
            for name, value in inputs.items():
                self._decoder.setInput(value, name)
            given = dict(zip(self._decoder_outputs, self._decoder.forward(self._decoder_outputs), strict=True))
        return np.array(given[LOW], np.float32), np.array(given[SCORES], np.float32)

    def _try(self, files: PromptableFiles) -> None:
        crop = np.full((TRIAL_CROP_PX, TRIAL_CROP_PX, 3), 128, np.uint8)
        with _quietly():
            try:
                embedded = self.embed(crop)
            except cv2.error as error:
                raise _unusable(
                    "promptable_encoder", files.encoder, f"OpenCV cannot run it: {_clause(error)}"
                ) from None
            try:
                low, scores = self._decode(embedded, np.full((1, 2), 32.0), np.ones(1, bool))
            except cv2.error as error:
                wrong = f"OpenCV cannot run it on what {files.encoder} gives: {_clause(error)}"
                raise _unusable("promptable_decoder", files.decoder, wrong) from None
        if low.shape != (1, scores.shape[-1], MASK_SIDE_PX, MASK_SIDE_PX) or scores.ndim != 2:
            wrong = f"its {LOW} and {SCORES} have the shapes {low.shape} and {scores.shape}"
            raise _unusable("promptable_decoder", files.decoder, wrong)


def _read(path: Path, sha256: str | None, option: str) -> tuple[Signature, list[str]]:
    """What a file says of itself, and the names of what it gives, after its hash was compared."""
    try:
        if sha256 is not None:
            with path.open("rb") as file:
                found = hashlib.file_digest(file, "sha256").hexdigest()
            if found != sha256.lower():
                raise _unusable(option, path, f"its SHA-256 is {found} and should be {sha256.lower()}; get it again")
        signature = signature_of(path)
    except OSError as error:
        raise PromptableFileError(f"{option} {path} cannot be read: {error.strerror}") from None
    except NotOnnxError as error:
        raise _unusable(option, path, f"{error}; give an ONNX file") from None
    return signature, list(signature.outputs)


def _check_encoder(path: Path, takes: Signature, needs_intermediate: bool) -> None:
    shapes = list(takes.inputs.values())
    fits = len(shapes) == 1 and (
        (len(shapes[0]) == 4 and fitted(shapes[0], (1, 3, SIDE_PX, SIDE_PX)))
        or (len(shapes[0]) == 3 and fitted(shapes[0][2:], (3,)))
    )
    if not fits:
        wanted = f"one image of 1x3x{SIDE_PX}x{SIDE_PX} or of height x width x 3"
        raise _unusable("promptable_encoder", path, f"it takes {_listed(takes.inputs)} and should take {wanted}")
    if needs_intermediate and INTERMEDIATE not in takes.outputs:
        wrong = f"it gives no {INTERMEDIATE}, which the decoder needs; give encoder and decoder of one network (HQ-SAM)"
        raise _unusable("promptable_encoder", path, wrong)
    if IMAGE not in takes.outputs and len(takes.outputs) != 1:
        raise _unusable("promptable_encoder", path, f"it gives {_listed(takes.outputs)} and should give {IMAGE}")


def _check_decoder(path: Path, wants: Signature) -> None:
    missing = sorted(DECODER_INPUTS - set(wants.inputs))
    unknown = sorted(set(wants.inputs) - DECODER_INPUTS - {INTERMEDIATE})
    lacking = sorted(DECODER_OUTPUTS - set(wants.outputs))
    clauses = [
        f"{what} {', '.join(names)}"
        for what, names in (("takes no", missing), ("takes the unknown", unknown), ("gives no", lacking))
        if names
    ]
    if clauses:
        remedy = "give a decoder as scripts/export_onnx_model.py of SAM, HQ-SAM or MobileSAM exports it"
        raise _unusable("promptable_decoder", path, f"it {' and '.join(clauses)}; {remedy}")


def _names_of_embeddings(takes: Signature, wants: Signature) -> dict[str, str]:
    """Which output of the encoder goes into which input of the decoder."""
    image = IMAGE if IMAGE in takes.outputs else next(iter(takes.outputs))
    return {IMAGE: image} | ({INTERMEDIATE: INTERMEDIATE} if INTERMEDIATE in wants.inputs else {})


def _imported(path: Path, option: str) -> cv2.dnn.Net:
    with _quietly():
        try:
            # the classic engine needs shapes that do not change, and the number of points does
            net = cv2.dnn.readNetFromONNX(str(path), cv2.dnn.ENGINE_NEW)
        except cv2.error as error:
            raise _unusable(option, path, f"OpenCV cannot import it: {_clause(error)}") from None
    if net.empty():
        raise _unusable(option, path, "OpenCV knows not all of its operators; give the export that is not quantised")
    return net


@contextmanager
def _quietly() -> Generator[None]:
    """OpenCV's own log beside its exceptions would be a second account of the same."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _unusable(option: str, path: Path, wrong: str) -> PromptableFileError:
    return PromptableFileError(f"{option} {path} cannot be used: {wrong}")


def _clause(error: cv2.error) -> str:
    said = " ".join(str(getattr(error, "err", "") or error).split())
    return said if len(said) <= LONGEST_CLAUSE else f"{said[:LONGEST_CLAUSE]}..."


def _listed(shapes: dict[str, tuple[int | None, ...]]) -> str:
    named = [f"{name} ({'x'.join('?' if n is None else str(n) for n in shape)})" for name, shape in shapes.items()]
    return ", ".join(named) or "nothing"
