/* Integers in blocks of eight, and bits, by the coder of SPEC 9.4. The readable twin is
   hapfmt/codecs/entropy.py.

   The input is hostile: a magnitude is checked against 2^34 before it is used, and averages of
   256 * |e| stay below 2^43. */
#ifndef HAPFMT_INTEGERS_H
#define HAPFMT_INTEGERS_H

#include "coder.h"

enum { UNSIGNED = 0, RAW_SIGNS = 1, LATER_SIGNS = 2, SCALED = 10, SIGN_CONTEXTS = 3 };

static const uint8_t edges[SYMBOLS] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 16, 20, 28, 44};
static const uint8_t extra[SYMBOLS] = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 2, 3, 4, 0};

typedef struct { int64_t f, s; } averages;
enum { START_MOST = 163, FIRST_FEW = 16 };

/* Both averages of the first block, by a byte of the packet. */
INLINE averages averages_from(int start)
{
    int64_t mean = (int64_t)(4 + start % 4) << (start / 4);
    averages a = {mean, mean};
    return a;
}

INLINE int context_of(const averages *a, int *shift)
{
    uint64_t mean = (uint64_t)(a->f + a->s) >> 1;
    int lg = bit_length(mean | 1) - 1, fr = (int)((mean << 2 >> lg) & 3), low = lg < SCALED ? lg : SCALED;
    int c = 4 * low + fr - 8;
    *shift = lg - low;
    return c < 0 ? 0 : c;
}

/* ``sum``: of the magnitudes of a whole block. */
INLINE void learn(averages *a, uint64_t sum)
{
    int64_t mean = (int64_t)(32 * sum);
    a->f += (mean - a->f) >> 1;
    a->s += (3 * (mean - a->s)) >> 4;
}

/* ---- decoding ---- */

/* A symbol. Few slots have another one than the first slot with their highest bits. */
INLINE int get_one(uint32_t *x, const class_table *t, int c, const uint8_t **next)
{
    uint32_t slot = *x & (SCALE - 1), high = *x >> SCALE_BITS;
    int k = t->symbols[c][slot >> FINE_BITS];
    share s = t->coarse[c][slot >> FINE_BITS];
    uint32_t within = slot - s.first;
    while (RARE(within >= s.width)) {
        s = t->shares[c][++k];
        within = slot - s.first;
    }
    uint32_t state = s.width * high + within, more = state << 16 | (uint32_t)(*next)[0] << 8 | (*next)[1];
    int needs = state < LEAST_STATE;
    *next += 2 * needs;
    *x = needs ? more : state;
    return k;
}

/* The symbols of up to eight numbers. */
INLINE void get_block(decoder *d, const class_table *t, int c, int count, int lanes, int *k)
{
    const uint8_t *next = d->next;
    uint32_t x[LANES_MOST];
    for (int i = 0; i < lanes; i++) x[i] = d->x[i];
    if (count == BLOCK) {
        UNROLL
        for (int i = 0; i < BLOCK; i++) k[i] = get_one(x + (i & (lanes - 1)), t, c, &next);
    } else
        for (int i = 0; i < count; i++) k[i] = get_one(x + (i & (lanes - 1)), t, c, &next);
    for (int i = 0; i < lanes; i++) d->x[i] = x[i];
    d->next = next;
}

INLINE int get_integers_as(decoder *d, int class, int start, int64_t count, int64_t *out, int lanes, int signs)
{
    const class_table *t = hapfmt_classes + class;
    averages a = averages_from(start);
    for (int64_t at = 0; at < count; at += BLOCK) {
        int n = count - at < BLOCK ? (int)(count - at) : BLOCK, k[BLOCK], h, c = context_of(&a, &h);
        uint64_t sum = 0, beyond = 0;
        get_block(d, t, c, n, lanes, k);
        const uint8_t *end = d->end;
        int64_t raw = d->raw;
        for (int i = 0; i < n; i++) {
            uint64_t u, word = raw_word(end, raw);
            int bits;
            if (RARE(k[i] == ESCAPE)) {
                int length = (int)(word & 63);
                u = ((uint64_t)1 << length | (word >> 6 & (((uint64_t)1 << length) - 1))) + edges[ESCAPE] - 1;
                if (u >> (ERROR_BITS - h)) { d->raw = raw + 6 + length; return BAD_ERROR; }
                raw += 6 + length;
                word = raw_word(end, raw);
                u = u << h | (word & (((uint64_t)1 << h) - 1));
                bits = h;
            } else {
                bits = extra[k[i]] + h;
                u = ((uint64_t)edges[k[i]] << h) + (word & (((uint64_t)1 << bits) - 1));
            }
            word >>= bits;
            raw += bits;
            beyond |= u;
            sum += u;
            if (signs == RAW_SIGNS) {
                /* Whether there is a sign mostly follows from the symbol: then no load waits for
                   the number. */
                uint64_t some = k[i] != 0;
                if (h && RARE(!some)) some = u != 0;
                uint64_t mask = 0 - (word & some);
                raw += (int64_t)some;
                u = (u ^ mask) - mask;
            }
            out[at + i] = (int64_t)u;
        }
        d->raw = raw;
        if (RARE(beyond >> ERROR_BITS)) return BAD_ERROR;
        if (RARE(overrun(d))) return BAD_END;
        learn(&a, sum);
    }
    return DONE;
}

static inline int get_integers(decoder *d, int class, int start, int64_t count, int64_t *out, int signs)
{
    if (d->lanes == 1)
        return signs == RAW_SIGNS ? get_integers_as(d, class, start, count, out, 1, RAW_SIGNS)
                                  : get_integers_as(d, class, start, count, out, 1, UNSIGNED);
    return signs == RAW_SIGNS ? get_integers_as(d, class, start, count, out, 4, RAW_SIGNS)
                              : get_integers_as(d, class, start, count, out, 4, UNSIGNED);
}

/* Signs of those that are not 0, each by the number before it. Nothing branches on a sign or a zero, which
   no processor can predict. */
static inline int get_signs(decoder *d, const uint8_t *p, int64_t count, int64_t *out)
{
    const uint8_t *next = d->next, *stop = d->end - (d->raw + 7) / 8;
    uint32_t positive[SIGN_CONTEXTS], last = 1, lane = 0, lanes = (uint32_t)d->lanes - 1;
    for (int i = 0; i < SIGN_CONTEXTS; i++) positive[i] = SCALE - 16 * (uint32_t)p[i];
    for (int64_t i = 0; i < count; i++) {
        uint32_t x = d->x[lane], slot = x & (SCALE - 1), some = out[i] != 0;
        uint32_t middle = last == 0 ? positive[0] : last == 1 ? positive[1] : positive[2];
        uint32_t negative = slot >= middle, wide = 0 - negative;
        uint32_t width = (middle ^ wide) + (wide & (SCALE + 1)); /* SCALE - middle where negative */
        uint32_t state = width * (x >> SCALE_BITS) + slot - (middle & wide);
        uint32_t needs = (state < LEAST_STATE) & some, more = state << 16 | (uint32_t)next[0] << 8 | next[1];
        int64_t mask = -(int64_t)(negative & some);
        d->x[lane] = !some ? x : needs ? more : state;
        next += 2 * needs;
        lane = (lane + some) & lanes;
        out[i] = (out[i] ^ mask) - mask;
        last = some ? 2 - 2 * negative : 1;
        if (RARE(next > stop)) {
            d->next = next;
            return BAD_END;
        }
    }
    d->next = next;
    return DONE;
}

/* ---- encoding ---- */

static const uint8_t buckets[44] = {
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 10, 11, 11, 11, 11, 12, 12, 12, 12, 13, 13,
    13, 13, 13, 13, 13, 13, 14, 14, 14, 14, 14, 14, 14, 14, 14, 14, 14, 14, 14, 14, 14, 14,
};

/* Where codes begin: those of a class, and after them of bits. */
enum { BITS = CONTEXTS * SYMBOLS };

typedef struct { int32_t counts[CONTEXTS * SYMBOLS]; } histogram;

/* The byte for averages like those of the first few numbers. */
static inline int start_of(const int64_t *in, int64_t count)
{
    uint64_t sum = 0;
    int64_t few = count < FIRST_FEW ? count : FIRST_FEW;
    for (int64_t i = 0; i < few; i++) {
        uint64_t u = (uint64_t)(in[i] < 0 ? -in[i] : in[i]);
        sum += u >> ERROR_BITS ? 0 : u;
    }
    uint64_t mean = few ? 256 * sum / (uint64_t)few : 0;
    int lg = bit_length(mean) - 1;
    return mean < 4 ? 0 : 4 * (lg - 2) + (int)(mean >> (lg - 2) & 3);
}

/* Notes a section of integers; ``first`` is added to its codes. */
INLINE int put_integers(encoder *e, const int64_t *in, int64_t count, int start, int signs, int first,
                        histogram *seen)
{
    averages a = averages_from(start);
    note(e, SECTION);
    for (int64_t at = 0; at < count; at += BLOCK) {
        int n = count - at < BLOCK ? (int)(count - at) : BLOCK, h, c = context_of(&a, &h);
        uint64_t sum = 0;
        for (int i = 0; i < n; i++) {
            int64_t value = in[at + i];
            uint64_t u = (uint64_t)(value < 0 ? -value : value), w = u >> h;
            if (RARE(u >> ERROR_BITS)) return BAD_ERROR;
            int k = RARE(w >= edges[ESCAPE]) ? ESCAPE : buckets[w];
            seen->counts[SYMBOLS * c + k]++;
            note(e, first + SYMBOLS * c + k);
            if (RARE(k == ESCAPE)) {
                uint64_t y = w - edges[ESCAPE] + 1;
                int length = bit_length(y) - 1;
                put_raw(e, (uint64_t)length, 6);
                put_raw(e, y, length);
                put_raw(e, u, h);
                if (signs == RAW_SIGNS) put_raw(e, value < 0, 1);
            } else {
                int bits = extra[k] + h, sign = signs == RAW_SIGNS && u;
                uint64_t rest = u - ((uint64_t)edges[k] << h);
                put_raw(e, rest | (uint64_t)(sign && value < 0) << bits, bits + sign);
            }
            sum += u;
        }
        learn(&a, sum);
    }
    return DONE;
}

/* The class that codes them in the fewest bits; *least: 256 times these. */
static inline int best_class(const histogram *seen, int64_t *least)
{
    int best = 0;
    *least = -1;
    for (int class = 0; class < CLASSES; class++) {
        const uint16_t *costs = hapfmt_classes[class].costs[0];
        int64_t cost = 0;
        for (int i = 0; i < CONTEXTS * SYMBOLS; i++) cost += (int64_t)seen->counts[i] * costs[i];
        if (*least < 0 || cost < *least) {
            *least = cost;
            best = class;
        }
    }
    return best;
}

/* How probable a 1 is, in 256ths, where there were some of each. */
INLINE int probability_of(int64_t zeros, int64_t ones)
{
    int64_t n = zeros + ones, p = n ? (256 * ones + n / 2) / n : 128;
    return p < 1 ? 1 : p > 255 ? 255 : (int)p;
}

#endif
