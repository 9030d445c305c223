/* The integer model of SPEC 9.4. The readable twin is hapfmt/codecs/adaptive.py.

   The input is hostile: a magnitude is checked against 2^34 before it is used, and averages of
   256 * |e| stay below 2^42. */
#ifndef HAPFMT_INTEGERS_H
#define HAPFMT_INTEGERS_H

#include "coder.h"

/* What the integers before leave behind; the models beside it are shared by nobody else. */
typedef struct { int64_t f, s, t; int g; } scale_state;
#define FRESH_SCALES {32, 32, 0, 0}

typedef struct {
    symbol_model tables[CONTEXTS], lengths;
    bit_model signs[4], repeats[4];
} models;

static inline void models_init(models *m)
{
    bit_model fresh = {32768, 32768, 0};
    memset(m, 0, sizeof *m);
    for (int c = 0; c < CONTEXTS; c++) {
        memcpy(m->tables[c].z, first_tables[c], sizeof first_tables[c]);
        m->tables[c].n = CONFIDENCE;
    }
    for (int i = 0; i < ESCAPE; i++) m->lengths.z[i] = (uint16_t)(4096 * (15 - i));
    m->lengths.n = ESCAPE_CONFIDENCE;
    for (int i = 0; i < 4; i++) m->signs[i] = m->repeats[i] = fresh;
}

INLINE int scale(const scale_state *s, int *context)
{
    uint64_t mean = (uint64_t)(s->f + s->s) >> 1;
    int lg = bit_length(mean | 1) - 1, fr = (int)((mean << 2 >> lg) & 3), low = lg < SCALED ? lg : SCALED;
    int c = 4 * low + fr - 8;
    *context = c < 0 ? 0 : c;
    return lg - low;
}

INLINE void learn(scale_state *s, uint64_t magnitude, int negative)
{
    int64_t u = (int64_t)(magnitude << 8);
    int a = s->t >= 63 ? 7 : bit_length((uint64_t)s->t + 1);
    s->g = (magnitude != 0) - 2 * negative;
    s->f += (u - s->f) >> 3;
    s->s += (u - s->s) >> a;
    s->t++;
}

INLINE int put_integer(encoder *e, models *m, scale_state *s, int64_t value)
{
    int context, h = scale(s, &context), negative = value < 0;
    uint64_t u = (uint64_t)(negative ? -value : value), w = u >> h;
    if (u >> ERROR_BITS) return BAD_ERROR;
    int k = w < edges[ESCAPE] ? buckets[w] : ESCAPE;
    put_symbol(e, k, &m->tables[context]);
    if (RARE(k == ESCAPE)) {
        uint64_t y = w - edges[ESCAPE] + 1;
        int length = bit_length(y) - 1;
        put_symbol(e, length < 15 ? length : 15, &m->lengths);
        if (length >= 15) put_raw(e, (uint64_t)length - 15, 5);
        put_raw(e, y, length);
        put_raw(e, u, h);
    } else
        put_raw(e, u - ((uint64_t)edges[k] << h), extra[k] + h);
    put_bit_if(e, negative, &m->signs[u ? s->g + 1 : 3], u != 0);
    learn(s, u, negative);
    return DONE;
}

INLINE int get_integer(decoder *d, models *m, scale_state *s, int64_t *value)
{
    int context, h = scale(s, &context);
    int k = get_symbol(d, &m->tables[context]), negative;
    uint64_t u;
    if (RARE(k == ESCAPE)) {
        int length = get_symbol(d, &m->lengths);
        if (length == 15) length += (int)get_raw(d, 5);
        uint64_t w = ((uint64_t)1 << length | get_raw(d, length)) + edges[ESCAPE] - 1;
        if (w >> (ERROR_BITS - h)) return BAD_ERROR;
        u = w << h | get_raw(d, h);
    } else {
        int bits = extra[k] + h;
        uint64_t word = raw_word(d);
        u = ((uint64_t)edges[k] << h) + (word & (((uint64_t)1 << bits) - 1));
        if (RARE(u >> ERROR_BITS)) return BAD_ERROR;
        d->raw += bits;
    }
    /* A model of its own for no sign at all: that is quicker than a branch. */
    negative = get_bit_if(d, &m->signs[u ? s->g + 1 : 3], u != 0);
    *value = negative ? -(int64_t)u : (int64_t)u;
    learn(s, u, negative);
    return DONE;
}

#endif
