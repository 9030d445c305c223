/* Knots, both ways: packets to clamped counts, and which samples become knots. The readable twins
   are hapfmt/codecs/knots.py and hapfmt/encoder/knots.py.

   The input of the decoder is hostile. What breaks a rule is left to the twin, which says which one;
   here it is only told from what does not. Widths: values stay within ``bound`` * quantum <= 2^32, a
   difference is below 2^35, ticks end at 2^24. */
#include "kernels.h"

enum { TICK_LIMIT = 1 << 24, GROUPS = 8, LANES = 8 };
static const int64_t FAR = (int64_t)1 << 36, COUNT_BOUND = (int64_t)1 << 32;

static inline int64_t clamp(int64_t x, int64_t low, int64_t high)
{
    return x < low ? low : x > high ? high : x;
}

typedef struct {
    const uint8_t *at, *end;
} reader;

/* CNV-002, CNV-003; -1 where one is broken. */
static inline int64_t get_varint(reader *r)
{
    uint64_t value = 0;
    for (int group = 0; group < GROUPS && r->at < r->end; group++) {
        uint8_t byte = *r->at++;
        value |= (uint64_t)(byte & 0x7F) << (7 * group);
        if (byte < 0x80) return (byte || !group) && value < (uint64_t)1 << 53 ? (int64_t)value : -1;
    }
    return -1;
}

typedef struct {
    int64_t quantum, bound, low, high, span;
    int components;
} plan;

static void fill(const plan *p, int64_t from, int64_t stop, const int64_t *values, int32_t *out)
{
    for (int c = 0; c < p->components; c++) {
        int32_t count = (int32_t)clamp(values[c] * p->quantum, p->low, p->high);
        for (int64_t t = from; t < stop; t++) out[t * p->components + c] = count;
    }
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

/* Where no count needs the clamp: so many at once that the compiler takes them in one register. */
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

static void draw(const plan *p, int64_t from, int64_t stop, int64_t run, const int64_t *before,
                 const int64_t *after, int32_t *out)
{
    for (int c = 0; c < p->components; c++) {
        int64_t y0 = before[c] * p->quantum, y1 = after[c] * p->quantum, rise = y1 - y0;
        int32_t *to = out + from * p->components + c;
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
}

static int get_values(reader *r, const plan *p, int64_t *values)
{
    for (int c = 0; c < p->components; c++) {
        int64_t number = get_varint(r);
        if (number < 0 || number >= FAR) return 0;
        values[c] += (number >> 1) ^ -(number & 1);
        if (values[c] > p->bound || values[c] < -p->bound) return 0;
    }
    return 1;
}

/* 1, or 0 where a rule is broken. ``values``: two rows of components, zeros. */
static int decode(const plan *p, reader r, int linear, int64_t tick_limit, int64_t *values,
                  int32_t *out)
{
    int64_t *before = values, *after = values + p->components, tick = 0;
    int lines = 0;
    if (!get_values(&r, p, after)) return 0;
    while (r.at < r.end) {
        int64_t gap = get_varint(&r), last = tick;
        int64_t *other = before;
        before = after;
        after = other;
        memcpy(after, before, (size_t)p->components * sizeof *after);
        if (gap < 1 || gap > TICK_LIMIT || !get_values(&r, p, after)) return 0;
        tick += gap;
        if (!linear) {
            if (tick >= p->span) return 0;
            fill(p, last, tick, before, out);
            continue;
        }
        if (last >= p->span - 1 || tick > tick_limit) return 0;
        draw(p, last, tick < p->span - 1 ? tick : p->span, gap, before, after, out);
        lines = 1;
    }
    if (lines) return tick >= p->span - 1;
    fill(p, tick, p->span, after, out);
    return 1;
}

/* (packet, quantum, components, lines, largest tick, largest value, least and largest count,
   zeros int64 [2 * components], counts int32 [ticks * components]) -> whether it was decoded */
static PyObject *knots_decode(PyObject *self, PyObject *args)
{
    Py_buffer data, values, out;
    int linear, decoded = 0;
    long long tick_limit, quantum, bound, low, high;
    plan p;
    (void)self;
    if (!PyArg_ParseTuple(args, "y*LipLLLLw*w*", &data, &quantum, &p.components, &linear,
                          &tick_limit, &bound, &low, &high, &values, &out))
        return NULL;
    int fits = p.components > 0 && values.len / 16 == p.components && values.len % 16 == 0 &&
               out.len > 0 && out.len % (4 * (Py_ssize_t)p.components) == 0 &&
               out.len / 4 / p.components <= TICK_LIMIT && quantum > 0 && quantum <= COUNT_BOUND &&
               bound >= 0 && bound <= COUNT_BOUND / quantum && low <= high && low >= INT32_MIN &&
               high <= INT32_MAX && tick_limit <= TICK_LIMIT && (uintptr_t)values.buf % 8 == 0 &&
               (uintptr_t)out.buf % 4 == 0;
    if (fits) {
        p.quantum = quantum;
        p.bound = bound;
        p.low = low;
        p.high = high;
        p.span = out.len / 4 / p.components;
        reader r = {data.buf, (const uint8_t *)data.buf + data.len};
        Py_BEGIN_ALLOW_THREADS
        memset(values.buf, 0, (size_t)values.len);
        decoded = decode(&p, r, linear, tick_limit, values.buf, out.buf);
        Py_END_ALLOW_THREADS
    } else
        PyErr_SetString(PyExc_ValueError, "not the limits of a packet of knots, or not its room");
    PyBuffer_Release(&data);
    PyBuffer_Release(&values);
    PyBuffer_Release(&out);
    return fits ? PyBool_FromLong(decoded) : NULL;
}

/* (numbers int64, bytes [8 * numbers], filled) -> size */
static PyObject *build_varints(PyObject *self, PyObject *args)
{
    Py_buffer numbers, out;
    int fits;
    Py_ssize_t written = 0;
    (void)self;
    if (!PyArg_ParseTuple(args, "y*w*", &numbers, &out)) return NULL;
    Py_BEGIN_ALLOW_THREADS
    fits = numbers.len % 8 == 0 && (uintptr_t)numbers.buf % 8 == 0 && out.len >= numbers.len;
    for (Py_ssize_t i = 0; fits && i < numbers.len / 8; i++) {
        uint64_t value = (uint64_t)((const int64_t *)numbers.buf)[i];
        uint8_t *to = out.buf;
        fits = value < (uint64_t)1 << 53;
        for (; fits && value > 0x7F; value >>= 7) to[written++] = (uint8_t)(value | 0x80);
        if (fits) to[written++] = (uint8_t)value;
    }
    Py_END_ALLOW_THREADS
    PyBuffer_Release(&numbers);
    PyBuffer_Release(&out);
    if (fits) return PyLong_FromSsize_t(written);
    PyErr_SetString(PyExc_ValueError, "not numbers below 2^53, or no room for them");
    return NULL;
}

PyMethodDef hapfmt_knots_methods[] = {
    {"build_varints", build_varints, METH_VARARGS, NULL},
    {"knots_decode", knots_decode, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
