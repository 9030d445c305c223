"""The integer model over a whole packet: what adaptive.py does one number after the other, for an
encoder that has no compiled loop.

The same steps in one function, with the state in local variables; about four times as fast. The
fifteen z of a table are fields of one integer, so that they move together.
"""

from __future__ import annotations

from collections.abc import Sequence

from .adaptive import (
    CONFIDENCE,
    CONTEXTS,
    COUNT_LIMIT,
    EDGES,
    ERROR_BITS,
    ESCAPE,
    ESCAPE_CONFIDENCE,
    EVEN,
    EXTRA,
    FAST_FROM,
    FIRST_SCALE,
    KEPT,
    LEAST,
    MOST,
    OUT_OF_RANGE,
    RATES,
    SCALED,
    TABLES,
    RangeEncoder,
    SymbolModel,
    bucket_of,
)

FIELD = 32
"""Bits: a z times a rate stays below 2^32."""

FIELDS = sum(0xFFFF << FIELD * i for i in range(ESCAPE))
BELOW = tuple(sum(0xFFFF << FIELD * i for i in range(k)) for k in range(ESCAPE + 1))
"""The fields that a symbol moves up, to 65535; it moves the others down, to 0."""

REPEATS = 3
"""The first of the models of repeats, behind those of signs."""

NEAR = 2 << SCALED
"""Means whose contexts stand in a table."""

BUCKETS = tuple(bucket_of(w) for w in range(EDGES[ESCAPE]))


def context_of(mean: int) -> int:
    lg = max(mean.bit_length() - 1, 0)
    return max(4 * min(lg, SCALED) + ((mean << 2 >> lg) & 3) - 8, 0)


NEAR_CONTEXTS = bytes(context_of(mean) for mean in range(NEAR))


def packed(z: Sequence[int]) -> int:
    return sum(x << FIELD * i for i, x in enumerate(z))


PACKED_TABLES = tuple(packed(z) for z in TABLES)


def encode_integers(
    coder: RangeEncoder,
    integers: Sequence[int],
    *,
    repeated: Sequence[int] | None = None,
) -> None:
    """Codes ``integers`` with fresh models. ``repeated`` (0, 1), coded too: of each but the first
    whether it belongs to a sample like the one before, and is left out."""
    tables, learned = list(PACKED_TABLES), [CONFIDENCE] * CONTEXTS
    lengths = SymbolModel(EVEN, ESCAPE_CONFIDENCE)
    # p, q and n of the bit models: three of signs, then four of repeats.
    p, q, n = [32768] * 7, [32768] * 7, [0] * 7
    fast = slow = FIRST_SCALE
    seen, recent, sign = 0, REPEATS, 1
    low, width, bits, tail, tail_bits = coder.low, coder.width, coder.bits, 0, 0
    for place, e in enumerate(integers):
        if place and repeated is not None:
            same = repeated[place]
            old = p[recent]
            mixed = old if n[recent] < FAST_FROM else (3 * old + q[recent]) >> 2
            m = width * (LEAST if mixed < LEAST else MOST if mixed > MOST else mixed) >> 16
            if same:
                width = m
            else:
                low += m
                width -= m
            shift = 16 - width.bit_length()
            low <<= shift
            width <<= shift
            bits += shift
            goal = 65535 if same else 0
            p[recent] = old + ((goal - old) * RATES[n[recent]] >> 16)
            q[recent] += (goal - q[recent]) >> 4
            if n[recent] < COUNT_LIMIT:
                n[recent] += 1
            recent = REPEATS + 2 * same + (recent - REPEATS >> 1)
            if same:
                continue
        u = -e if e < 0 else e
        if u >> ERROR_BITS:
            raise ValueError(OUT_OF_RANGE)
        mean = (fast + slow) >> 1
        if mean < NEAR:
            h, c = 0, NEAR_CONTEXTS[mean]
        else:
            h, c = mean.bit_length() - 1 - SCALED, context_of(mean)
        w = u >> h
        k = BUCKETS[w] if w < EDGES[ESCAPE] else ESCAPE
        z, rate = tables[c], RATES[learned[c]]
        span = width - 16
        lower = (span * (z >> FIELD * k & 0xFFFF) >> 16) + 15 - k if k < ESCAPE else 0
        if k:
            width = (span * (z >> FIELD * (k - 1) & 0xFFFF) >> 16) + 16 - k
        width -= lower
        shift = 16 - width.bit_length()
        low = (low + lower) << shift
        width <<= shift
        bits += shift
        # What a symbol moves up to 65535 is turned over, moved down to 0, and turned back.
        z ^= BELOW[k]
        tables[c] = (z - ((z * rate >> 16) & FIELDS)) ^ BELOW[k]
        if learned[c] < COUNT_LIMIT:
            learned[c] += 1
        if k < ESCAPE:
            size = EXTRA[k] + h
            tail |= (u - (EDGES[k] << h)) << tail_bits
        else:
            y = w - EDGES[ESCAPE] + 1
            length = y.bit_length() - 1
            coder.low, coder.width, coder.bits = low, width, bits
            coder.symbol(min(length, 15), lengths)
            low, width, bits = coder.low, coder.width, coder.bits
            size = h + length
            tail |= (((u & ((1 << h) - 1)) << length) | y & ((1 << length) - 1)) << (
                tail_bits + 5 * (length >= 15)
            )
            if length >= 15:
                tail |= (length - 15) << tail_bits
                size += 5
        tail_bits += size
        if not e:
            sign = 1
        else:
            old = p[sign]
            mixed = old if n[sign] < FAST_FROM else (3 * old + q[sign]) >> 2
            m = width * (LEAST if mixed < LEAST else MOST if mixed > MOST else mixed) >> 16
            if e < 0:
                width, goal = m, 65535
            else:
                low += m
                width -= m
                goal = 0
            shift = 16 - width.bit_length()
            low <<= shift
            width <<= shift
            bits += shift
            p[sign] = old + ((goal - old) * RATES[n[sign]] >> 16)
            q[sign] += (goal - q[sign]) >> 4
            if n[sign] < COUNT_LIMIT:
                n[sign] += 1
            sign = 0 if e < 0 else 2
        u <<= 8
        fast += (u - fast) >> 3
        seen += 1
        slow += (u - slow) >> (7 if seen >= 64 else seen.bit_length())
        if bits >= KEPT:
            coder.low, coder.bits = low, bits
            coder.put((bits - 16) // 8)
            low, bits = coder.low, coder.bits
        if tail_bits >= KEPT:
            coder.raw(tail, tail_bits)
            tail = tail_bits = 0
    coder.low, coder.width, coder.bits = low, width, bits
    coder.raw(tail, tail_bits)
