/* Shared by writers and readers of coded bytes: work memory, and bits and signs with probabilities of
   their own. The readable twin is hapfmt/codecs/entropy.py. */
#ifndef HAPFMT_CODED_H
#define HAPFMT_CODED_H

#include <math.h>
#include <stdlib.h>

#include "integers.h"

enum { BAD_CODING = 6, NO_MEMORY = 9 };

/* Bytes with a margin of zeros on both sides; NULL where memory ran out. */
static inline uint8_t *with_margins(const void *bytes, int64_t size)
{
    uint8_t *copy = malloc((size_t)(size + 2 * MARGIN));
    if (!copy) return NULL;
    memset(copy, 0, MARGIN);
    memcpy(copy + MARGIN, bytes, (size_t)size);
    memset(copy + MARGIN + size, 0, MARGIN);
    return copy;
}

/* Where a packet is made: codes of its symbols and their words, three for each number and a few to begin
   with, and the numbers. */
typedef struct {
    uint16_t *codes, *words;
    int64_t *errors, room;
} workshop;

static inline int workshop_open(workshop *w, int64_t span)
{
    w->room = 3 * span + 8;
    w->codes = malloc((size_t)(2 * w->room));
    w->words = malloc((size_t)(2 * (w->room + 2 * LANES_MOST)));
    w->errors = malloc((size_t)(8 * (span + 1)));
    return w->codes && w->words && w->errors;
}

/* Room for more codes of an encoder that writes here. */
static inline int workshop_grow(workshop *w, encoder *e, int64_t more)
{
    int64_t room = 2 * w->room + more;
    uint16_t *codes = realloc(w->codes, (size_t)(2 * room)), *words;
    if (!codes) return 0;
    e->codes = w->codes = codes;
    words = realloc(w->words, (size_t)(2 * (room + 2 * LANES_MOST)));
    if (!words) return 0;
    w->words = words;
    w->room = room;
    return 1;
}

INLINE int workshop_room(workshop *w, encoder *e, int64_t more)
{
    return e->noted + more <= w->room || workshop_grow(w, e, more);
}

static inline void workshop_close(workshop *w)
{
    free(w->codes);
    free(w->words);
    free(w->errors);
}

/* 256 times the bits of what has this probability in 256ths. */
static inline int64_t bit_cost(int p) { return (int64_t)floor(256 * log2(256.0 / p) + 0.5); }

/* The probabilities of bits that were counted, into a packet and as shares. */
static inline int put_bits(share *shares, uint8_t *out, const int64_t *counts, int contexts)
{
    for (int i = 0; i < contexts; i++) {
        int p = probability_of(counts[2 * i], counts[2 * i + 1]);
        out[i] = (uint8_t)p;
        shares[2 * i] = bit_share(0, p);
        shares[2 * i + 1] = bit_share(1, p);
    }
    return contexts;
}

/* Whether probabilities of signs save more than they take; how many there are of each; 256 times the bits. */
static inline int signs_pay(const int64_t *numbers, int64_t count, int64_t *counts, int64_t *least)
{
    int64_t cost = 256 * 8 * SIGN_CONTEXTS, raw = 0;
    int last = 0;
    memset(counts, 0, 2 * SIGN_CONTEXTS * sizeof *counts);
    for (int64_t i = 0; i < count; i++) {
        int sign = (numbers[i] > 0) - (numbers[i] < 0);
        counts[2 * last + 2 + (sign < 0)] += sign != 0;
        last = sign;
    }
    for (int i = 0; i < SIGN_CONTEXTS; i++) {
        int64_t zeros = counts[2 * i], ones = counts[2 * i + 1];
        int p = probability_of(zeros, ones);
        raw += zeros + ones;
        cost += zeros * bit_cost(256 - p) + ones * bit_cost(p);
    }
    *least = cost < 256 * raw ? cost : 256 * raw;
    return cost < 256 * raw;
}

static inline void note_signs(encoder *e, const int64_t *numbers, int64_t count, int codes)
{
    int last = 0;
    note(e, SECTION);
    for (int64_t i = 0; i < count; i++) {
        int sign = (numbers[i] > 0) - (numbers[i] < 0);
        if (sign) note(e, codes + 2 * (last + 1) + (sign < 0));
        last = sign;
    }
}

/* ---- integers by how many bits they have, with frequencies of their own ---- */

enum { LENGTHS = 64 };

typedef struct {
    int first, count;
    share shares[LENGTHS];
    uint8_t coarse[1 << COARSE_BITS];
} length_table;

static inline void share_lengths(const uint8_t *weights, int count, share *shares)
{
    int64_t total = 0, sum = 0;
    for (int i = 0; i < count; i++) total += weights[i];
    for (int i = 0; i < count; i++) {
        int64_t from = i + (SCALE - count) * sum / total;
        sum += weights[i];
        shares[i].first = (uint16_t)from;
        shares[i].width = (uint16_t)(i + 1 + (SCALE - count) * sum / total - from);
    }
}

/* How many bytes the table takes; 0 where it is not defined. */
static inline int64_t take_lengths(const uint8_t *in, int64_t size, length_table *t)
{
    int some = 0;
    if (size < 2) return 0;
    t->first = in[0];
    t->count = in[1];
    if (!t->count || t->first + t->count > LENGTHS || size < 2 + t->count) return 0;
    for (int i = 0; i < t->count; i++) some |= in[2 + i];
    if (!some) return 0;
    share_lengths(in + 2, t->count, t->shares);
    for (int i = 0, k = 0; i < 1 << COARSE_BITS; i++) {
        while (k + 1 < t->count && i << FINE_BITS >= t->shares[k + 1].first) k++;
        t->coarse[i] = (uint8_t)k;
    }
    return 2 + t->count;
}

static inline int get_length(decoder *d, const length_table *t, int lane, int64_t *out)
{
    uint32_t slot = d->x[lane] & (SCALE - 1);
    int k = t->coarse[slot >> FINE_BITS], length;
    while (RARE(slot - t->shares[k].first >= t->shares[k].width)) k++;
    d->x[lane] = advance(d->x[lane], t->shares[k], &d->next);
    length = t->first + k;
    uint64_t size = 0;
    *out = 0;
    if (length) {
        int low = length - 1 < 32 ? length - 1 : 32;
        size = get_raw(d, low);
        size |= get_raw(d, length - 1 - low) << low | (uint64_t)1 << (length - 1);
        *out = get_raw(d, 1) ? -(int64_t)size : (int64_t)size;
    }
    return overrun(d) ? BAD_END : DONE;
}

static inline void put_length(encoder *e, int64_t number, int codes)
{
    uint64_t u = (uint64_t)(number < 0 ? -number : number);
    int length = bit_length(u);
    note(e, codes + length);
    if (!length) return;
    put_raw(e, u, length - 1);
    put_raw(e, number < 0, 1);
}

/* The table of lengths that were counted, into a packet and as shares. */
static inline int64_t put_lengths(uint8_t *out, share *shares, const int64_t *counts)
{
    int first = 0, last = LENGTHS - 1, n;
    int64_t most = 0;
    while (first < LENGTHS - 1 && !counts[first]) first++;
    while (last > first && !counts[last]) last--;
    if (!counts[first]) first = last = 0;
    n = last - first + 1;
    for (int i = 0; i < n; i++)
        if (counts[first + i] > most) most = counts[first + i];
    out[0] = (uint8_t)first;
    out[1] = (uint8_t)n;
    for (int i = 0; i < n; i++) {
        int64_t c = counts[first + i], w = c ? (255 * c + most / 2) / most : 0;
        out[2 + i] = (uint8_t)(!most ? 255 : c && !w ? 1 : w);
    }
    share_lengths(out + 2, n, shares + first);
    return 2 + n;
}

#endif
