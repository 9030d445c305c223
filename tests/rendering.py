"""What a player is to send, worked out sample by sample by docs/spec/players.md; and small profiles."""

from __future__ import annotations

import io
from fractions import Fraction
from math import ceil, floor, fsum, isfinite

import numpy as np

import hapfmt
from hapfmt import Settings
from hapfmt.replay.profile.model import Actuator, Profile, Timing

ARCHIVE = Settings()
SHAPES = {"full": "bounded", "lf": "linear", "hf": "band-limited"}


def profile_of(count=1, *, rate=1000, band="full", accepts=None, names=None, **timing):
    return Profile(
        name="test",
        description="",
        source="",
        matches=(),
        timing=Timing(Fraction(rate), **timing),
        actuators=tuple(
            Actuator(
                name=names[i] if names else f"a{i + 1}",
                unit="N",
                minimum=-5.0,
                maximum=5.0,
                slew=500.0,
                step=0.001,
                band=band,
                accepts={"N": 1.0} if accepts is None else accepts,
            )
            for i in range(count)
        ),
    )


def file_of(recording, settings=ARCHIVE, **given):
    out = io.BytesIO()
    hapfmt.write(recording, out, settings, canonical=1, **given)
    return out.getvalue()


def joined(blocks):
    """(values, known) [samples, actuators] of blocks, and that they follow on one another."""
    blocks = list(blocks)
    assert [b.last for b in blocks] == [False] * (len(blocks) - 1) + [True]
    at = blocks[0].first
    for block in blocks:
        assert block.first == at
        assert block.values.shape == block.known.shape
        at += len(block.values)
    return np.concatenate([b.values for b in blocks]), np.concatenate([b.known for b in blocks])


def runs_of(channel):
    """{start tick: finite values} without gaps, of what a channel has."""
    found, at = [], 0
    physical = channel.samples().tolist()
    for span in channel.coverage:
        start, row = span.start, []
        for tick in range(span.start, span.stop):
            value = physical[at]
            at += 1
            if isfinite(value):
                row.append(value)
                continue
            if row:
                found.append((start, row))
            start, row = tick + 1, []
        if row:
            found.append((start, row))
    return found


def sinc(u):
    return float(np.sinc(u))


def bessel(z):
    """I0 by its power series."""
    total = term = 1.0
    for n in range(1, 60):
        term *= (z / 2 / n) ** 2
        total += term
    return total


def expected(runs, shape, ratio, place):
    """The value at ``place`` (ticks, a Fraction), and how wrong it may be; None: not known."""
    tick, p = floor(place), max(Fraction(1), ratio)
    run = next(((s, row) for s, row in runs if s <= tick < s + len(row)), None)
    if run is None:
        return None
    start, row = run

    def at(j):
        i = (j - start) % (2 * len(row))
        return row[min(i, 2 * len(row) - 1 - i)]

    q = ceil(p)
    reach = q if shape == "linear" else ceil(16 * p)
    near = range(tick - reach, tick + reach + 2)
    x = {j: float(j - place) for j in near}
    if shape == "linear":
        weights = {j: max(0.0, 1 - abs(x[j]) / q) / q for j in near}
    else:
        u = {j: x[j] / float(p) for j in near}
        weights = {
            j: sinc(u[j]) * bessel(8 * (1 - (u[j] / 16) ** 2) ** 0.5) if abs(u[j]) < 16 else 0.0
            for j in near
        }
        total = fsum(weights.values())
        weights = {j: w / total for j, w in weights.items()}
    largest = max(abs(at(j)) for j in near)
    scale = 2.0**-60 if largest > 1e300 else 1.0
    value = fsum(weights[j] * (at(j) * scale) for j in near) / scale
    slack = 1e-12 * largest + 1e-320
    if shape != "band-limited":
        w = q if shape == "linear" else p
        close = [at(j) for j in near if abs(j - place) < w]
        value = min(max(value, min(close)), max(close))
    return value, slack
