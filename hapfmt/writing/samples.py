"""What the caller hands over -> arrays that are ours, checked against the inputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ParameterError
from ..encoder.inputs import Input


def owned(values: ArrayLike, inputs: Sequence[Input]) -> NDArray[Any]:
    """[ticks, channels] int32 counts or float64, a copy; [ticks] goes for one channel.

    Raises ParameterError for another shape or kind, and for counts beyond the bits of an input.
    """
    given = np.asarray(values)
    if given.ndim < 2 and len(inputs) == 1:
        given = given.reshape(-1, 1)
    if given.ndim != 2 or given.shape[1] != len(inputs):
        raise ParameterError(
            f"samples of {named(inputs)} are [ticks, {len(inputs)}], not {list(given.shape)}"
            if len(inputs) > 1
            else f"samples of {named(inputs)} are one-dimensional, not {list(given.shape)}"
        )
    if not inputs[0].takes_counts:
        if given.dtype.kind not in "fiub" or given.dtype.itemsize > 8:
            raise ParameterError(
                f"samples of {named(inputs)} are floats, not {given.dtype}: "
                "integer counts need an Input with a calibration"
            )
        return np.array(given, np.float64, order="C")
    if given.dtype.kind not in "iu" and given.size:
        raise ParameterError(
            f"samples of {named(inputs)} are integer counts, not {given.dtype}, "
            "as its calibration says"
        )
    check_range(given, inputs)
    return np.array(given, np.int32, order="C")


def check_range(counts: NDArray[Any], inputs: Sequence[Input]) -> None:
    bits = inputs[0].bits if len(inputs) == 1 else min(given.bits for given in inputs)
    if not counts.size or (counts.dtype.kind == "i" and 8 * counts.dtype.itemsize <= bits):
        return
    if counts.size == 1:
        low = high = int(counts.item())
    else:
        low, high = int(counts.min()), int(counts.max())
    if within(low, high, bits):
        return
    for place, given in enumerate(inputs):
        low, high = int(counts[:, place].min()), int(counts[:, place].max())
        if not within(low, high, given.bits):
            raise ParameterError(
                f"counts of {given.label!r} from {low} to {high} need more than its "
                f"{given.bits} bits"
            )


def within(low: int, high: int, bits: int) -> bool:
    return -(1 << (bits - 1)) <= low and high < 1 << (bits - 1)


def named(inputs: Sequence[Input]) -> str:
    if len(inputs) == 1:
        return repr(inputs[0].label)
    return f"the {len(inputs)} channels from {inputs[0].label!r} to {inputs[-1].label!r}"
