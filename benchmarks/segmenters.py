"""The segmenters that benchmarks compare: those of perception, and the baseline `ridge`, which perception has not."""

from agents.perception.segmentation.choice import SEGMENTERS
from agents.perception.segmenter_names import NETWORK
from benchmarks.ridge.ridge import segment_ridge

RIDGE = "ridge"
COMPARED = SEGMENTERS | {RIDGE: segment_ridge}
ON_TISSUE = NETWORK, RIDGE
