/* Selects the samples that become knots: the perceptual deadband, tick by tick. The readable twin is
   select_knots_plain of hapfmt/encoder/knots.py.

   Widths: counts below 2^32 in magnitude, zero within 32 bits, kn and kd below 2^16: a difference
   times kd stays below 2^50. Squares of vectors take up to 66 bits, their sums times kd^2 up to 114:
   they are compared as doubles, and where those are too close to tell, as pairs of 64 bits. */
#include "kernels.h"

static const int64_t COUNT_LIMIT = (int64_t)1 << 32, ZERO_LIMIT = (int64_t)1 << 31;
static const double MARGIN = 1.0 / ((int64_t)1 << 35);

typedef struct {
    const int64_t *table, *zero, *floor;
    int64_t kn, kd, size;
    int components, by_sample;
} plan;

static inline int64_t magnitude(int64_t x) { return x < 0 ? -x : x; }

typedef struct {
    uint64_t high, low;
} wide;

static wide add(wide a, wide b)
{
    wide sum = {a.high + b.high, a.low + b.low};
    sum.high += sum.low < b.low;
    return sum;
}

static wide times(uint64_t a, uint64_t b)
{
    uint64_t a1 = a >> 32, a0 = a & 0xFFFFFFFFu, b1 = b >> 32, b0 = b & 0xFFFFFFFFu;
    uint64_t low = a0 * b0, left = a1 * b0 + (low >> 32), right = a0 * b1 + (left & 0xFFFFFFFFu);
    wide product = {a1 * b1 + (left >> 32) + (right >> 32), right << 32 | (low & 0xFFFFFFFFu)};
    return product;
}

/* x * factor, below 2^128. */
static wide scaled(wide x, uint64_t factor)
{
    wide product = times(x.low, factor);
    product.high += x.high * factor;
    return product;
}

static int more(wide a, wide b) { return a.high != b.high ? a.high > b.high : a.low > b.low; }

static int breaks_exactly(const plan *p, const int64_t *row, const int64_t *last)
{
    const int64_t *about = p->by_sample ? row : last;
    wide error = {0, 0}, reference = {0, 0};
    for (int c = 0; c < p->components; c++) {
        uint64_t e = (uint64_t)magnitude(row[c] - last[c]);
        uint64_t r = (uint64_t)magnitude(about[c] - p->zero[c]);
        error = add(error, times(e, e));
        reference = add(reference, times(r, r));
    }
    wide floor = scaled(times((uint64_t)p->floor[0], (uint64_t)p->floor[0]),
                        (uint64_t)(p->kd * p->kd));
    reference = scaled(reference, (uint64_t)(p->kn * p->kn));
    return more(scaled(error, (uint64_t)(p->kd * p->kd)), more(floor, reference) ? floor : reference);
}

static double allowed_sq(const plan *p, const int64_t *row)
{
    double ratio = (double)p->kn / (double)p->kd, floor = (double)p->floor[0], sum = 0;
    for (int c = 0; c < p->components; c++) {
        double r = (double)(row[c] - p->zero[c]);
        sum += r * r;
    }
    sum *= ratio * ratio;
    return sum > floor * floor ? sum : floor * floor;
}

static int64_t select_vector(const plan *p, int64_t *ticks)
{
    const int64_t *last = p->table;
    double allowed = allowed_sq(p, last);
    int64_t count = 1;
    ticks[0] = 0;
    for (int64_t t = 1; t < p->size; t++) {
        const int64_t *row = p->table + t * p->components;
        double error = 0;
        for (int c = 0; c < p->components; c++) {
            double e = (double)(row[c] - last[c]);
            error += e * e;
        }
        if (p->by_sample) allowed = allowed_sq(p, row);
        if (error <= allowed * (1 - MARGIN)) continue;
        if (error <= allowed * (1 + MARGIN) && !breaks_exactly(p, row, last)) continue;
        ticks[count++] = t;
        last = row;
        if (!p->by_sample) allowed = allowed_sq(p, last);
    }
    return count;
}

/* |x - y| <= max(|x - zero| * kn / kd, floor) */
static inline int64_t tolerance(const plan *p, int64_t x, int c)
{
    int64_t weber = magnitude(x - p->zero[c]) * p->kn / p->kd;
    return weber > p->floor[c] ? weber : p->floor[c];
}

static int64_t select_one(const plan *p, int64_t *ticks)
{
    const int64_t *x = p->table;
    int64_t last = x[0], width = tolerance(p, last, 0), count = 1;
    ticks[0] = 0;
    for (int64_t t = 1; t < p->size; t++) {
        int64_t e = magnitude(x[t] - last);
        if (e <= (p->by_sample ? p->floor[0] : width)) continue;
        if (p->by_sample && e * p->kd <= magnitude(x[t] - p->zero[0]) * p->kn) continue;
        ticks[count++] = t;
        last = x[t];
        if (!p->by_sample) width = tolerance(p, last, 0);
    }
    return count;
}

static int64_t select_any(const plan *p, int64_t *ticks)
{
    const int64_t *last = p->table;
    int64_t count = 1;
    ticks[0] = 0;
    for (int64_t t = 1; t < p->size; t++) {
        const int64_t *row = p->table + t * p->components, *about = p->by_sample ? row : last;
        int leaves = 0;
        for (int c = 0; c < p->components && !leaves; c++) {
            int64_t e = magnitude(row[c] - last[c]);
            leaves = e > p->floor[c] &&
                     e * p->kd > magnitude(about[c] - p->zero[c]) * p->kn;
        }
        if (!leaves) continue;
        ticks[count++] = t;
        last = row;
    }
    return count;
}

static int valid(const plan *p, const Py_buffer *table, const Py_buffer *zero,
                 const Py_buffer *floor, const Py_buffer *ticks, int vector)
{
    int fits = p->components > 0 && p->size > 0 && p->kn >= 0 && p->kn < 65536 && p->kd > 0 &&
               p->kd < 65536 && p->components < 65536 && table->len / 8 / p->components == p->size &&
               table->len % 8 == 0 && table->len / 8 % p->components == 0 &&
               zero->len == 8 * (Py_ssize_t)p->components &&
               floor->len == (vector ? 8 : 8 * (Py_ssize_t)p->components) &&
               (uintptr_t)table->buf % 8 == 0 && (uintptr_t)zero->buf % 8 == 0 &&
               (uintptr_t)floor->buf % 8 == 0 && (uintptr_t)ticks->buf % 8 == 0;
    for (int c = 0; fits && c < p->components; c++)
        fits = p->zero[c] >= -ZERO_LIMIT && p->zero[c] < ZERO_LIMIT;
    for (Py_ssize_t c = 0; fits && c < floor->len / 8; c++)
        fits = p->floor[c] >= 1 && p->floor[c] < COUNT_LIMIT;
    for (Py_ssize_t i = 0; fits && i < table->len / 8; i++)
        fits = p->table[i] > -COUNT_LIMIT && p->table[i] < COUNT_LIMIT;
    return fits;
}

/* (counts int64 [ticks, components], zero int64 [components], floor int64 [components] or of a
   vector [1], kn, kd, vector, by sample, ticks int64 [ticks], filled) -> number of knots */
static PyObject *select_knots(PyObject *self, PyObject *args)
{
    Py_buffer table, zero, floor, ticks;
    long long kn, kd, count = 0;
    int vector, fits;
    plan p;
    (void)self;
    if (!PyArg_ParseTuple(args, "y*y*y*LLppw*", &table, &zero, &floor, &kn, &kd, &vector,
                          &p.by_sample, &ticks))
        return NULL;
    p.table = table.buf;
    p.zero = zero.buf;
    p.floor = floor.buf;
    p.kn = kn;
    p.kd = kd;
    p.size = ticks.len / 8;
    p.components = zero.len / 8 < 65536 ? (int)(zero.len / 8) : 0;
    Py_BEGIN_ALLOW_THREADS
    fits = valid(&p, &table, &zero, &floor, &ticks, vector);
    if (fits)
        count = vector             ? select_vector(&p, ticks.buf)
                : p.components > 1 ? select_any(&p, ticks.buf)
                                   : select_one(&p, ticks.buf);
    Py_END_ALLOW_THREADS
    PyBuffer_Release(&table);
    PyBuffer_Release(&zero);
    PyBuffer_Release(&floor);
    PyBuffer_Release(&ticks);
    if (fits) return PyLong_FromLongLong(count);
    PyErr_SetString(PyExc_ValueError, "not a deadband, or not counts that it compares");
    return NULL;
}

PyMethodDef hapfmt_select_methods[] = {
    {"select_knots", select_knots, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
