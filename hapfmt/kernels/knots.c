/* KNOT in varints: packets to clamped counts, and the varints of packets. The readable twin is
   hapfmt/codecs/knots.py.

   The input of the decoder is hostile. This file only detects that a packet breaks a rule; the twin
   then decodes it and reports the rule. Widths: an index is within ``limit`` <= 2^32 before it is
   used, a difference is below 2^35, ticks end at 2^24. */
#include "kernels.h"

#include "lines.h"

enum { GROUPS = 8 };
static const int64_t FAR = (int64_t)1 << 36;

typedef struct {
    const uint8_t *at, *end;
} reader;

/* CNV-002; -1 where one is broken. */
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
    int64_t span;
    places places;
    shape shape;
} plan;

static void fill(const plan *p, int64_t from, int64_t stop, const int64_t *values, int32_t *out)
{
    for (int c = 0; c < p->shape.components; c++)
        hold(&p->shape, from, stop, c, count_of(&p->places, values[c]), out);
}

static void draw(const plan *p, int64_t from, int64_t stop, int64_t run, const int64_t *before,
                 const int64_t *after, int32_t *out)
{
    for (int c = 0; c < p->shape.components; c++)
        line(&p->shape, from, stop, run, c, count_of(&p->places, before[c]),
             count_of(&p->places, after[c]), out);
}

static int get_values(reader *r, const plan *p, int64_t *values)
{
    for (int c = 0; c < p->shape.components; c++) {
        int64_t number = get_varint(r);
        if (number < 0 || number >= FAR) return 0;
        values[c] += (number >> 1) ^ -(number & 1);
        if (values[c] > p->places.limit || values[c] < -p->places.limit) return 0;
    }
    return 1;
}

/* 1, or 0 where a rule is broken. ``values``: two rows of components, zeros. */
static int decode(const plan *p, reader r, int linear, int64_t *values, int32_t *out)
{
    int64_t *before = values, *after = values + p->shape.components, tick = 0;
    if (!get_values(&r, p, after)) return 0;
    while (r.at < r.end) {
        int64_t gap = get_varint(&r), last = tick;
        int64_t *other = before;
        before = after;
        after = other;
        memcpy(after, before, (size_t)p->shape.components * sizeof *after);
        if (gap < 1 || gap >= p->span - tick || !get_values(&r, p, after)) return 0;
        tick += gap;
        if (linear) draw(p, last, tick, gap, before, after, out);
        else fill(p, last, tick, before, out);
    }
    fill(p, tick, p->span, after, out);
    return !linear || !tick || tick == p->span - 1;
}

/* (packet, components, lines, largest index, step, zero, magnitudes of a deadband's grid int64 or
   none, least and largest count, zeros int64 [2 * components], counts int32 [ticks * components])
   -> whether it was decoded */
static PyObject *knots_decode(PyObject *self, PyObject *args)
{
    Py_buffer data, levels, values, out;
    int linear, decoded = 0;
    plan p;
    (void)self;
    if (!PyArg_ParseTuple(args, "y*ipLLLy*LLw*w*", &data, &p.shape.components, &linear,
                          &p.places.limit, &p.places.step, &p.places.zero, &levels, &p.shape.low,
                          &p.shape.high, &values, &out))
        return NULL;
    p.span = rows_of(&p.shape, &out);
    int fits = p.span > 0 && values.len % 16 == 0 && values.len / 16 == p.shape.components &&
               (uintptr_t)values.buf % 8 == 0 && places_fit(&p.places, &levels);
    if (fits) {
        reader r = {data.buf, (const uint8_t *)data.buf + data.len};
        Py_BEGIN_ALLOW_THREADS
        memset(values.buf, 0, (size_t)values.len);
        decoded = decode(&p, r, linear, values.buf, out.buf);
        Py_END_ALLOW_THREADS
    } else
        PyErr_SetString(PyExc_ValueError, "not the limits of a packet of knots, or not its room");
    PyBuffer_Release(&data);
    PyBuffer_Release(&levels);
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
