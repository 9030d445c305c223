/* The counts between knots: held, or on a line, and clamped (SPEC 9.1).
   The readable twin is interpolate() of hapfmt/codecs/knots.py.

   Counts of knots are below 2^34 in magnitude, ticks and runs at most 2^24. */
#ifndef HAPFMT_LINES_H
#define HAPFMT_LINES_H

#include "kernels.h"

enum { TICK_LIMIT = 1 << 24, LANES = 8 };

/* Rows of ``components`` counts within low ... high. */
typedef struct {
    long long low, high;
    int components;
} shape;

/* How many rows of a shape ``out`` has room for; 0 where it is none, or the room is not in rows. */
static int64_t rows_of(const shape *s, const Py_buffer *out)
{
    if (s->components < 1 || s->low > s->high || s->low < INT32_MIN || s->high > INT32_MAX ||
        out->len % (4 * (Py_ssize_t)s->components) || (uintptr_t)out->buf % 4)
        return 0;
    int64_t rows = out->len / 4 / s->components;
    return rows <= TICK_LIMIT ? rows : 0;
}

/* Which count each index from -limit to limit stands for. */
typedef struct {
    long long limit, step, zero;
    const int64_t *levels; /* of a deadband's grid, limit + 1; NULL on the uniform one */
} places;

static const int64_t FARTHEST_INDEX = (int64_t)1 << 32;

static inline int64_t count_of(const places *p, int64_t index)
{
    if (!p->levels) return p->zero + index * p->step;
    return index < 0 ? p->zero - p->levels[-index] : p->zero + p->levels[index];
}

/* Takes the levels, and says whether all counts are below 2^34. */
static int places_fit(places *p, const Py_buffer *levels)
{
    p->levels = levels->len ? levels->buf : NULL;
    if (!whole(levels, 8) || p->limit < 0 || p->limit > FARTHEST_INDEX || p->zero < INT32_MIN ||
        p->zero > INT32_MAX)
        return 0;
    if (!levels->len) return p->step > 0 && p->step <= FARTHEST_INDEX / (p->limit ? p->limit : 1);
    if (levels->len / 8 <= p->limit) return 0;
    for (int64_t i = 0; i <= p->limit; i++)
        if (p->levels[i] < 0 || p->levels[i] > 2 * FARTHEST_INDEX) return 0;
    return 1;
}

static inline int64_t clamp(int64_t x, int64_t low, int64_t high)
{
    return x < low ? low : x > high ? high : x;
}

/* One component from tick ``from`` up to ``stop``. */
static void hold(const shape *s, int64_t from, int64_t stop, int component, int64_t y, int32_t *out)
{
    int32_t count = (int32_t)clamp(y, s->low, s->high);
    for (int64_t t = from; t < stop; t++) out[t * s->components + component] = count;
}

/* y + rdiv(rise * t, run) for t = 0, 1, ...: quotients and remainders of 2 * run, step by step. */
typedef struct {
    int64_t y, step;
    int32_t rest, more, twice;
} slope;

static inline int64_t next(slope *s)
{
    int64_t y = s->y;
    int32_t rest = s->rest + s->more - s->twice, below = rest >> 31;
    s->rest = rest + (s->twice & below);
    s->y += s->step + 1 + below;
    return y;
}

static inline void divide(int64_t rise, int64_t run, int64_t *step, int32_t *more)
{
    int64_t q = rise == (int32_t)rise ? (int32_t)rise / (int32_t)run : rise / run, r = rise - q * run;
    *step = q - (r < 0);
    *more = (int32_t)(2 * (r < 0 ? r + run : r));
}

/* For counts that need no clamp: LANES at once, so that the compiler can use one register for them. */
static void ramp(slope s, int64_t rise, int64_t run, int64_t count, int32_t *out)
{
    uint32_t y[LANES];
    int32_t rest[LANES], more;
    int64_t step, i = 0;
    for (int j = 0; j < LANES; j++) {
        rest[j] = s.rest;
        y[j] = (uint32_t)next(&s);
    }
    divide(LANES * rise, run, &step, &more);
    uint32_t up = (uint32_t)step + 1;
    for (; i + LANES <= count; i += LANES)
        for (int j = 0; j < LANES; j++) {
            out[i + j] = (int32_t)y[j];
            int32_t left = rest[j] + more - s.twice, below = left >> 31;
            rest[j] = left + (s.twice & below);
            y[j] += up + (uint32_t)below;
        }
    for (int j = 0; i < count; i++, j++) out[i] = (int32_t)y[j];
}

/* One component from y0 at tick ``from`` towards y1, which is ``run`` ticks later, up to ``stop``. */
static void line(const shape *p, int64_t from, int64_t stop, int64_t run, int component, int64_t y0,
                 int64_t y1, int32_t *out)
{
    int64_t rise = y1 - y0;
    int32_t *to = out + from * p->components + component;
    slope s = {.y = y0, .rest = (int32_t)run, .twice = (int32_t)(2 * run)};
    int inside = y0 >= p->low && y0 <= p->high && y1 >= p->low && y1 <= p->high;
    divide(rise, run, &s.step, &s.more);
    if (inside && p->components == 1 && stop - from >= 3 * LANES)
        ramp(s, rise, run, stop - from, to);
    else if (inside)
        for (int64_t t = from; t < stop; t++, to += p->components) *to = (int32_t)next(&s);
    else
        for (int64_t t = from; t < stop; t++, to += p->components)
            *to = (int32_t)clamp(next(&s), p->low, p->high);
}

#endif
