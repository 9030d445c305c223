"""SPEC 9 a second time, read from the page alone: slow, and nothing to get wrong. The modules
page_* hold one clause each; here are the names of 9.4 to 9.6. Imports nothing from hapfmt."""

from page_coding import CLASSES, EDGES, EXTRA, Coder, class_ends
from page_knots_coded import decode_knots, encode_knots
from page_numbers import (
    BrokenRule,
    bits_of,
    clamp,
    rdiv,
    signed,
    svarint_bytes,
    varint,
    varint_bytes,
)
from page_predicted import (
    DIGEST,
    TEXT,
    K,
    cross_terms,
    decode,
    decode_packet,
    difference,
    encode,
    encode_packet,
    grid_levels,
    prediction,
    step_up,
    tolerance,
    tops_by_search,
)

__all__ = [
    "CLASSES",
    "DIGEST",
    "EDGES",
    "EXTRA",
    "TEXT",
    "BrokenRule",
    "Coder",
    "K",
    "bits_of",
    "clamp",
    "class_ends",
    "cross_terms",
    "decode",
    "decode_knots",
    "decode_packet",
    "difference",
    "encode",
    "encode_knots",
    "encode_packet",
    "grid_levels",
    "prediction",
    "rdiv",
    "signed",
    "step_up",
    "svarint_bytes",
    "tolerance",
    "tops_by_search",
    "varint",
    "varint_bytes",
]
