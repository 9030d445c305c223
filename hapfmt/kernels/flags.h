/* Integers by bits (SPEC 9.4): flags whose models learn. The readable twin is Models in
   hapfmt/codecs/entropy.py.

   The input is hostile: a number has at most 38 flags, so 76 bytes are read at most before bounds are
   checked, which is less than the margin. Magnitudes are below 2^34, s is below 2^40. */
#ifndef HAPFMT_FLAGS_H
#define HAPFMT_FLAGS_H

#include "coded.h"

enum { NEAR = 9, LOUD = 12, KINDS = 36, PLAIN = 3, FAST = 5, SLOW = 7, MOST_FLAGS = KINDS + 2 };
enum { EVEN = 1 << 15 };

/* How probable a 1 is, in 65536ths; two more than how often it was used, as far as that matters. */
typedef struct { uint16_t p, n; } model;

typedef struct {
    model near[NEAR][KINDS], loud[LOUD][KINDS], half[KINDS], sign[SIGN_CONTEXTS];
    uint64_t a, b; /* the two magnitudes before */
    int64_t s;
    int d;
} models;

/* 256 times the bits of a share of the 4096; and how every section begins. */
extern uint16_t hapfmt_costs[SCALE];
extern models hapfmt_models;

/* What would take the length of a number in bits, which is slow on many processors. */
typedef struct { uint8_t near[64], loud[1024], shift[(2 << SLOW) + 1]; } flag_tables;
extern flag_tables hapfmt_flags;

static inline void flag_tables_prepare(flag_tables *f)
{
    for (int g = 0; g < 64; g++) {
        int i = g < 3 ? g : 1 + bit_length((uint64_t)g);
        f->near[g] = (uint8_t)(i < NEAR ? i : NEAR - 1);
    }
    for (int s = 0; s < 1024; s++) f->loud[s] = (uint8_t)bit_length((uint64_t)s);
    for (int n = 1; n <= 2 << SLOW; n++) f->shift[n] = (uint8_t)(bit_length((uint64_t)n) - 1);
}

static inline void models_prepare(models *m)
{
    const model even = {EVEN, 2}, rare = {EVEN / 4, 4};
    for (int k = 0; k < KINDS; k++) {
        for (int i = 0; i < NEAR; i++) m->near[i][k] = k < i - 2 ? rare : even;
        for (int j = 0; j < LOUD; j++) m->loud[j][k] = k < j - 5 ? rare : even;
        m->half[k] = even;
    }
    for (int i = 0; i < SIGN_CONTEXTS; i++) m->sign[i] = even;
    m->a = m->b = 0;
    m->s = m->d = 0;
}

INLINE void learn_bit(model *m, int bit, int limit)
{
    int n = m->n, t = hapfmt_flags.shift[n], p = m->p;
    if (t > limit) t = limit;
    m->n = (uint16_t)(n + (n < 1 << SLOW));
    m->p = (uint16_t)(bit ? p + ((65535 - p) >> t) : p - (p >> t));
}

INLINE model *near_at(models *m, uint64_t g)
{
    return m->near[g < sizeof hapfmt_flags.near ? hapfmt_flags.near[g] : NEAR - 1];
}

INLINE model *loud_at(models *m, int64_t s)
{
    return m->loud[s < (int64_t)sizeof hapfmt_flags.loud ? hapfmt_flags.loud[s] : LOUD - 1];
}

INLINE model *near_of(models *m) { return near_at(m, 2 * m->a + m->b); }

INLINE model *loud_of(models *m) { return loud_at(m, m->s); }

INLINE void step_on(models *m, uint64_t u)
{
    m->b = m->a;
    m->a = u;
    m->s += (64 * (int64_t)u - m->s) >> 3;
}

/* ---- decoding ---- */

INLINE int get_flag(uint32_t *x, const uint8_t **next, int width)
{
    uint32_t slot = *x & (SCALE - 1), high = *x >> SCALE_BITS, middle = (uint32_t)(SCALE - width);
    int bit = slot >= middle;
    *x = bit ? (uint32_t)width * high + slot - middle : middle * high + slot;
    if (RARE(*x < LEAST_STATE)) {
        *x = *x << 16 | (uint32_t)(*next)[0] << 8 | (*next)[1];
        *next += 2;
    }
    return bit;
}

/* A section; the coder has one state. */
INLINE int get_by_bits_as(decoder *d, int64_t count, int64_t *out, int signs)
{
    models m = hapfmt_models;
    const uint8_t *next = d->next, *stop = d->end - (d->raw + 7) / 8;
    uint32_t x = d->x[0];
    uint64_t a = 0, b = 0;
    int64_t s = 0;
    int status = DONE, last = 0;
    for (int64_t t = 0; t < count; t++) {
        model *near = near_at(&m, 2 * a + b), *loud = loud_at(&m, s);
        int k = 0, negative = 0;
        for (; k < KINDS; k++) {
            int bit = get_flag(&x, &next, (near[k].p + loud[k].p) >> 5);
            learn_bit(near + k, bit, FAST);
            learn_bit(loud + k, bit, SLOW);
            if (bit) break;
        }
        if (RARE(k == KINDS)) {
            status = next > stop ? BAD_END : BAD_ERROR;
            break;
        }
        uint64_t u = (uint64_t)k;
        if (k >= PLAIN) {
            model *half = m.half + k;
            int bit = get_flag(&x, &next, half->p >> 4);
            learn_bit(half, bit, SLOW);
            u = ((uint64_t)(2 + bit) << (k - PLAIN)) + 1 + get_raw(d, k - PLAIN);
            stop = d->end - (d->raw + 7) / 8;
            if (RARE(u >> ERROR_BITS)) {
                status = BAD_ERROR;
                break;
            }
        }
        if (signs != UNSIGNED && u) {
            model *sign = m.sign + last;
            negative = get_flag(&x, &next, sign->p >> 4);
            learn_bit(sign, negative, SLOW);
            last = 1 + negative;
        }
        if (RARE(next > stop)) {
            status = BAD_END;
            break;
        }
        out[t] = negative ? -(int64_t)u : (int64_t)u;
        b = a;
        a = u;
        s += (64 * (int64_t)u - s) >> 3;
    }
    d->x[0] = x;
    d->next = next;
    return status;
}

static inline int get_by_bits(decoder *d, int64_t count, int64_t *out, int signs)
{
    return signs == UNSIGNED ? get_by_bits_as(d, count, out, UNSIGNED)
                             : get_by_bits_as(d, count, out, RAW_SIGNS);
}

/* ---- encoding ---- */

INLINE int kind_of(uint64_t u) { return u < PLAIN ? (int)u : 1 + bit_length(u - 1); }

INLINE void note_flag(encoder *e, int width, int bit, int64_t *cost)
{
    note(e, FLAG | bit << SCALE_BITS | width);
    *cost += hapfmt_costs[bit ? width : SCALE - width];
}

/* Notes a section without its raw bits; *cost: 256 times the bits of all. Numbers are below 2^34.
   0 where memory ran out. */
INLINE int note_by_bits_as(encoder *e, workshop *w, const int64_t *in, int64_t count, int signs,
                           int64_t *cost)
{
    models m = hapfmt_models;
    *cost = 0;
    if (!workshop_room(w, e, 1)) return 0;
    note(e, SECTION);
    for (int64_t t = 0; t < count; t++) {
        uint64_t u = (uint64_t)(in[t] < 0 ? -in[t] : in[t]);
        model *near = near_of(&m), *loud = loud_of(&m);
        int last = kind_of(u);
        if (RARE(!workshop_room(w, e, MOST_FLAGS))) return 0;
        for (int k = 0; k <= last; k++) {
            note_flag(e, (near[k].p + loud[k].p) >> 5, k == last, cost);
            learn_bit(near + k, k == last, FAST);
            learn_bit(loud + k, k == last, SLOW);
        }
        if (last >= PLAIN) {
            model *half = m.half + last;
            int bit = (int)((u - 1) >> (last - PLAIN) & 1);
            note_flag(e, half->p >> 4, bit, cost);
            learn_bit(half, bit, SLOW);
            *cost += 256 * (last - PLAIN);
        }
        if (signs != UNSIGNED && u) {
            model *sign = m.sign + m.d;
            int negative = in[t] < 0;
            note_flag(e, sign->p >> 4, negative, cost);
            learn_bit(sign, negative, SLOW);
            m.d = 1 + negative;
        }
        step_on(&m, u);
    }
    return 1;
}

static inline int note_by_bits(encoder *e, workshop *w, const int64_t *in, int64_t count, int signs,
                        int64_t *cost)
{
    return signs == UNSIGNED ? note_by_bits_as(e, w, in, count, UNSIGNED, cost)
                             : note_by_bits_as(e, w, in, count, RAW_SIGNS, cost);
}

static inline void put_raw_by_bits(encoder *e, const int64_t *in, int64_t count)
{
    for (int64_t t = 0; t < count; t++) {
        uint64_t u = (uint64_t)(in[t] < 0 ? -in[t] : in[t]);
        int bits = kind_of(u) - PLAIN;
        if (bits > 0) put_raw(e, u - 1, bits);
    }
}

/* The coded bytes where there are such sections: one state. */
static inline int64_t encoder_finish_flags(encoder *e, const share *shares, uint16_t *words)
{
    return encoder_finish_as(e, shares, 1, words, 1);
}

#endif
