"""Packets of LPCX with one component: counts and doubles [span]."""

from __future__ import annotations

import numpy as np

from hapfmt.codecs import exact


def decode_counts(data, span, level, offset):
    return exact.decode_counts(data, span, 1, level, offset, -(2**31), 2**31 - 1)[:, 0]


def decode_exact(data, parameters, affine, counts, offset):
    rows = np.asarray(counts, np.int64)[:, None]
    return exact.decode_exact(data, [parameters], [affine], rows, offset)[:, 0]
