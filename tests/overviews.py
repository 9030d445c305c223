"""Overviews of files, and the law that they keep (docs/spec/overview.md)."""

from __future__ import annotations

import math

import numpy as np

import hapfmt
from hapfmt.reading.overview import COARSEST, FACTOR, overview_of, values_of


def found(data):
    with hapfmt.Reader(data) as reader:
        return overview_of(reader.catalogue)


def check_bounds(data):
    """Every level holds every finite value, and no edge is further off than one step."""
    with hapfmt.Reader(data) as reader:
        seen = overview_of(reader.catalogue)
        recording = reader.read()
        numbers = [ref.number for ref in reader.channels]
    assert seen is not None
    assert [row.channel for row in seen.channels] == numbers
    for row, channel in zip(seen.channels, recording.channels, strict=True):
        ticks = np.concatenate([np.arange(*span) for span in channel.coverage] or [np.empty(0)])
        values = channel.samples()
        assert row.tick_count == (channel.stop_tick - channel.start_tick if ticks.size else 0)
        finite = np.isfinite(values)
        codes = values_of(row.low, row.high)[1:]
        for level in range(seen.levels(row.channel)):
            bins = seen.envelope(row.channel, level)
            assert bins.bin_ticks == seen.base * FACTOR**level
            places = ticks[finite].astype(np.int64) // bins.bin_ticks - bins.first_bin
            low, high = np.full(len(bins.low), math.inf), np.full(len(bins.low), -math.inf)
            np.minimum.at(low, places, values[finite])
            np.maximum.at(high, places, values[finite])
            known = low <= high
            assert np.array_equal(np.isnan(bins.low), ~known)
            assert np.array_equal(np.isnan(bins.high), ~known)
            assert np.all(bins.low[known] <= low[known])
            assert np.all(bins.high[known] >= high[known])
            # The next code would be beyond the value: no edge is further off than a step.
            above = np.searchsorted(codes, bins.low[known], side="right")
            assert np.all((above == len(codes)) | (codes[above % len(codes)] > low[known]))
            below = np.searchsorted(codes, bins.high[known], side="left") - 1
            assert np.all((below < 0) | (codes[below] < high[known]))
        assert seen.levels(row.channel) == 0 or len(bins.low) <= COARSEST
