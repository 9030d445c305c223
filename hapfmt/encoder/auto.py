"""Preset auto: what each channel is, what may be left out of it, and why.

Two stages. ``plan_channel`` looks at a channel before it is coded: its quantity, unit and values
say whether it is kept without loss, within a deadband, or within an absolute floor. ``encode_auto``
codes it so and tells what was left out. Every sample keeps the bound that the track states.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil

import numpy as np
from numpy.typing import NDArray

from ..recording import Channel
from .check import decoded_pieces
from .perception import FORCE_FLOORS, QUANTITY_OF_UNIT, WEBER_LIMITS
from .settings import Settings, text_of
from .source import Source
from .split import PADDING_PERIODS, slow_for_telling
from .tolerance import Tolerance
from .unit import Bound, Unit, bound_of, encode_counts

STATES = 4
"""Up to so many distinct values are states (a button, a phase), not a signal."""

CLOCK_SAMPLES = 16
"""Fewer samples that only rise say nothing about what follows."""

CLOCK_SHARE = 0.5
"""A counter or clock moves on at least this share of its samples; a position that is only pushed
forward rests in between."""

CLOCK_LABEL = re.compile(
    r"(^|[\W_])(time(stamps?)?|clock|counter|seq(uence)?|frame|index)($|[\W_])", re.IGNORECASE
)

STRETCH = 1 << 18
"""Samples that are filtered at a time."""

KNOWN_QUANTITIES = frozenset(QUANTITY_OF_UNIT.values())

NOTHING = "nothing"
NO_TEXTURE = ", no texture above it"


@dataclass(frozen=True)
class Plan:
    """What a channel is coded with; ``why`` and ``left_out`` are told to the user."""

    settings: Settings
    why: str = ""
    left_out: str = ""


def plan_channel(channel: Channel, settings: Settings) -> Plan:
    """The settings of one channel; those of the caller where the preset is another."""
    if settings.preset != "auto":
        return Plan(settings)
    x = channel.samples()
    kept = exact_kind(channel, x)
    if kept:
        # A tolerance would move what is to be kept; the caller's own still may.
        return Plan(replace(settings, preset="archive"), kept, NOTHING)
    quantity = quantity_of(channel)
    limit = WEBER_LIMITS.get(quantity, Fraction(0))
    threshold = absolute_threshold(channel, settings)
    if threshold is not None and float(np.abs(x).max()) <= threshold.value:
        why = f"silent: nothing above {threshold.value:g} {channel.unit}"
        return Plan(within(channel, settings, Fraction(0), threshold), why, "all but its level")
    floor = amount_text(settings.floor, channel)
    k = settings.k if limit is None else min(settings.k, limit)
    if not k:
        named = quantity or f"unit {channel.unit}"
        zero = "no zero that is felt, so no Weber fraction"
        why = f"{named}: {'the floor alone' if quantity in WEBER_LIMITS else zero}"
        return Plan(within(channel, settings, k, settings.floor), why, f"less than {floor}")
    return Plan(
        within(channel, settings, k, settings.floor),
        f"{quantity}: deadband of {percent(k)}",
        f"less than {percent(k)} or {floor}",
    )


def plan_unit(plans: list[Plan], settings: Settings) -> Plan:
    """Of one channel its own; of axes that the caller asked for as one vector, one deadband."""
    if len(plans) == 1 or settings.preset != "auto":
        return plans[0]
    return Plan(
        replace(settings, preset="deadband"),
        f"vector: deadband of {percent(settings.k)} on the norm",
        f"less than {percent(settings.k)} or a floor of {text_of(settings.floor)}",
    )


def within(channel: Channel, settings: Settings, k: Fraction, floor: Tolerance) -> Settings:
    """Preset deadband with this bound; true doubles go on a lattice that it leaves room for."""
    asked = replace(settings, preset="deadband", k=k, floor=floor)
    return replace(asked, tolerance=settings.tolerance or asked.share_of_floor(channel))


def exact_kind(channel: Channel, x: NDArray[np.float64]) -> str:
    """Why a channel is kept without loss; empty where it need not be."""
    if not x.size:
        return "no samples"
    if (x == x[0]).all():
        return "constant"
    if not np.isfinite(x).all():
        return "not finite"
    quantity = quantity_of(channel)
    if quantity == "time":
        return "a clock: exact"
    if quantity in WEBER_LIMITS:
        return ""
    if quantity == "" and CLOCK_LABEL.search(channel.label):
        return "a clock or counter by its name: exact"
    if is_clock(x):
        return "rises or falls all along, a clock or counter: exact"
    if few_values(x):
        return f"at most {STATES} distinct values, states: exact"
    return ""


def is_clock(x: NDArray[np.float64]) -> bool:
    """Whether values only rise, or only fall, and seldom rest."""
    if x.size < CLOCK_SAMPLES:
        return False
    before, after = x[:-1], x[1:]
    one_way = bool((after >= before).all() or (after <= before).all())
    return one_way and int(np.count_nonzero(after != before)) >= CLOCK_SHARE * before.size


def few_values(x: NDArray[np.float64]) -> bool:
    left = x
    for _ in range(STATES):
        left = left[left != left[0]]
        if not left.size:
            return True
    return False


def quantity_of(channel: Channel) -> str:
    """The quantity as the channel names it, else by its unit; empty where neither tells.

    A name that is not known here ("normal force") gives way to a unit that is.
    """
    named = channel.quantity.strip().lower()
    by_unit = QUANTITY_OF_UNIT.get(channel.unit, "")
    return named if named in KNOWN_QUANTITIES else by_unit or named


def absolute_threshold(channel: Channel, settings: Settings) -> Tolerance | None:
    """Below it nothing is felt: the caller's floor where it is absolute, else that of a force."""
    quantity = quantity_of(channel)
    if quantity not in WEBER_LIMITS:
        return None
    if settings.floor.kind == "absolute":
        return settings.floor
    floor = FORCE_FLOORS.get(channel.unit) if quantity == "force" else None
    return None if floor is None else Tolerance(float(floor))


def percent(k: Fraction) -> str:
    return f"{float(100 * k):g} %"


def amount_text(floor: Tolerance, channel: Channel) -> str:
    if floor.kind == "range":
        return f"{100 * floor.value:g} % of the range"
    return f"{floor.value:g} {'steps' if floor.kind == 'lsb' else channel.unit}"


def encode_auto(source: Source, first_channel: int, plan: Plan) -> Unit:
    """One unit by its plan, and what was left out of it.

    Knots of the slow part with a residual are not tried: at the same deadband they were 1.3 to 10
    times as large as the smallest other way on 30 recorded channels with texture.
    """
    unit = encode_counts(source, first_channel, plan.settings)
    why, left_out = "" if plan.why == unit.reason else plan.why, plan.left_out
    same = unit.exact
    if not same:
        bound, cutoff = bound_of(source, plan.settings), plan.settings.cutoff_hz
        if bound.band.kn and not bound.band.vector and source.rate > 2 * cutoff:
            share = texture_share(source, bound, cutoff)
            why += f", texture in {100 * share:.2g} % of samples" if share else NO_TEXTURE
            left_out += "" if share else f", and all texture above {cutoff:g} Hz"
        same = all(np.array_equal(x, y) for x, y in decoded_pieces(source, unit.base))
    moved = max((c.deviation.declared for c in source.channels if c.deviation), default=0.0)
    if same:
        left_out = f"less than {moved:.3g} {source.channels[0].unit}" if moved else NOTHING
    reason = f"{unit.reason} ({why})" if why else unit.reason
    return replace(unit, reason=reason, left_out=left_out)


def texture_share(source: Source, bound: Bound, cutoff_hz: float) -> float:
    """Of how many samples the slow part alone would be outside the deadband.

    Stretch by stretch, with what the filter needs to settle on both sides.
    """
    rate, outside = float(source.rate), 0
    margin = ceil(PADDING_PERIODS * rate / cutoff_hz)
    for rows in source.segments():
        for start in range(rows.start, rows.stop, STRETCH):
            stop = min(start + STRETCH, rows.stop)
            first, last = max(start - margin, rows.start), min(stop + margin, rows.stop)
            counts = source.counts[first:last].astype(np.float64)
            slow = slow_for_telling(counts, rate, cutoff_hz)
            near = np.floor(slow[start - first : stop - first] + 0.5).astype(np.int64)
            outside += int(bound.band.outside(source.counts[start:stop], near).sum())
    return outside / len(source.counts)
