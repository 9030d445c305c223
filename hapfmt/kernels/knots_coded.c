/* The loops of adaptively coded knots (SPEC 9.6); the readable twin is hapfmt/codecs/knots_coded.py.

   The decoder's input is hostile: an index is within ``limit`` <= 2^32 before it is used, a
   difference has at most 34 bits, a tick is below the span before anything is written. */
#include "kernels.h"

#include "coder.h"
#include "lines.h"

enum { BAD_LENGTH = 7, BAD_TICK = 8, GAP_BITS = 24, VALUE_BITS = 34 };
static const int64_t FARTHEST = (int64_t)1 << 48; /* ticks whose differences do not overflow */

typedef struct {
    bit_model lengths[VALUE_BITS + 1], seconds[VALUE_BITS + 1];
} magnitude;

typedef struct {
    magnitude gaps, values;
    bit_model signs[3];
} knot_model;

static void knots_init(knot_model *m)
{
    bit_model fresh = {32768, 32768, 0};
    for (int i = 0; i <= VALUE_BITS; i++) {
        m->gaps.lengths[i] = m->gaps.seconds[i] = fresh;
        m->values.lengths[i] = m->values.seconds[i] = fresh;
    }
    for (int i = 0; i < 3; i++) m->signs[i] = fresh;
}

/* ---- decoding ---- */

/* A number of at most ``most`` bits; -1 where it has more. */
INLINE int64_t get_magnitude(decoder *d, magnitude *m, int most)
{
    int size = 0;
    while (get_bit(d, &m->lengths[size]))
        if (RARE(++size > most)) return -1;
    if (size < 2) return size;
    int64_t top = 2 | get_bit(d, &m->seconds[size]);
    return top << (size - 2) | (int64_t)get_raw(d, size - 2);
}

typedef struct {
    shape shape;
    places places;
    int64_t span, further;
    int linear;
} knot_plan;

/* ``row``: indices of the last knot; ``counts``: what they stand for; ``signs``: of the last
   differences, zeros. */
static int decode_knots(decoder *d, const knot_plan *p, int64_t *row, int64_t *counts,
                        int64_t *signs, int32_t *out)
{
    knot_model m;
    int64_t tick = 0;
    int components = p->shape.components;
    knots_init(&m);
    for (int c = 0; c < components; c++) counts[c] = count_of(&p->places, row[c]);
    for (int64_t left = p->further; left-- > 0;) {
        if (RARE(overrun(d))) return BAD_END;
        int64_t from = tick, stop;
        int last = p->linear && !left, inside = 1;
        if (last) {
            tick = p->span - 1;
            stop = p->span;
        } else {
            int64_t gap = get_magnitude(d, &m.gaps, GAP_BITS);
            if (gap < 0) return BAD_LENGTH;
            stop = tick += gap + 1;
            if (tick >= p->span - left) return BAD_TICK;
        }
        for (int c = 0; c < components; c++) {
            int64_t u = get_magnitude(d, &m.values, VALUE_BITS);
            if (u < 0) return BAD_LENGTH;
            int negative = u ? get_bit(d, &m.signs[signs[c] + 1]) : 0;
            row[c] += negative ? -u : u;
            signs[c] = (u != 0) - 2 * negative;
            inside &= row[c] <= p->places.limit && row[c] >= -p->places.limit;
            if (RARE(!inside)) continue;
            int64_t before = counts[c];
            counts[c] = count_of(&p->places, row[c]);
            if (p->linear) line(&p->shape, from, stop, tick - from, c, before, counts[c], out);
            else hold(&p->shape, from, stop, c, before, out);
        }
        if (!inside) return BAD_INDEX;
    }
    /* Lines end with the packet: only what is held goes on. */
    if (!p->linear || !p->further)
        for (int c = 0; c < components; c++) hold(&p->shape, tick, p->span, c, counts[c], out);
    return p->further ? check_end(d) : DONE;
}

static int plan_fits(knot_plan *p, const Py_buffer *levels, const Py_buffer *first,
                     const Py_buffer *work)
{
    if (!whole(first, 8) || !whole(work, 8) || p->span < 1 || p->further < 0 ||
        p->further >= p->span || work->len != 2 * first->len || !places_fit(&p->places, levels))
        return 0;
    const int64_t *row = first->buf;
    for (int c = 0; c < p->shape.components; c++)
        if (row[c] > p->places.limit || row[c] < -p->places.limit) return 0;
    return 1;
}

/* (coded bytes, lines, knots after the first, largest index, step, zero, magnitudes of a deadband's
   grid int64 or none, least and largest count, first indices int64 [components], zeros int64
   [2 * components], counts int32 [ticks * components]) -> (status, bytes read) */
static PyObject *coded_knots_decode(PyObject *self, PyObject *args)
{
    Py_buffer coded, levels, first, work, out;
    long long further;
    knot_plan p;
    int status = DONE;
    int64_t size = 0;
    PyObject *result = NULL;
    (void)self;
    if (!PyArg_ParseTuple(args, "y*pLLLLy*LLw*w*w*", &coded, &p.linear, &further, &p.places.limit,
                          &p.places.step, &p.places.zero, &levels, &p.shape.low, &p.shape.high,
                          &first, &work, &out))
        return NULL;
    p.shape.components = first.len / 8 <= INT32_MAX / 4 ? (int)(first.len / 8) : 0;
    p.span = rows_of(&p.shape, &out);
    p.further = further;
    if (plan_fits(&p, &levels, &first, &work)) {
        int64_t *space = work.buf;
        decoder d;
        Py_BEGIN_ALLOW_THREADS
        memset(work.buf, 0, (size_t)work.len);
        decoder_init(&d, coded.buf, coded.len);
        status = decode_knots(&d, &p, first.buf, space, space + p.shape.components, out.buf);
        size = (bits_taken(&d) - 15) / 8;
        Py_END_ALLOW_THREADS
        result = Py_BuildValue("iL", status, (long long)size);
    } else
        PyErr_SetString(PyExc_ValueError, "not the limits of a packet of knots, or not its room");
    PyBuffer_Release(&coded);
    PyBuffer_Release(&levels);
    PyBuffer_Release(&first);
    PyBuffer_Release(&work);
    PyBuffer_Release(&out);
    return result;
}

/* ---- encoding ---- */

INLINE int put_magnitude(encoder *e, magnitude *m, int most, int64_t u)
{
    int size = bit_length((uint64_t)u);
    if (u < 0 || size > most) return 0;
    for (int i = 0; i < size; i++) put_bit(e, 1, &m->lengths[i]);
    put_bit(e, 0, &m->lengths[size]);
    if (size > 1) {
        put_bit(e, (int)(u >> (size - 2) & 1), &m->seconds[size]);
        put_raw(e, (uint64_t)u, size - 2);
    }
    return 1;
}

static inline int sign(int64_t x) { return (x > 0) - (x < 0); }

static int encode_knots(encoder *e, const int64_t *ticks, const int64_t *indices, int64_t knots,
                        int64_t components, int linear)
{
    knot_model m;
    knots_init(&m);
    for (int64_t i = 0; i < knots * components; i++)
        if (indices[i] > FARTHEST_INDEX || indices[i] < -FARTHEST_INDEX) return BAD_INDEX;
    for (int64_t k = 0; k < knots; k++)
        if (ticks[k] < 0 || ticks[k] > FARTHEST) return BAD_TICK;
    for (int64_t k = 1; k < knots; k++) {
        const int64_t *now = indices + k * components, *before = now - components;
        if (!linear || k < knots - 1)
            if (!put_magnitude(e, &m.gaps, GAP_BITS, ticks[k] - ticks[k - 1] - 1)) return BAD_TICK;
        for (int64_t c = 0; c < components; c++) {
            int64_t d = now[c] - before[c], g = k > 1 ? before[c] - before[c - components] : 0;
            put_magnitude(e, &m.values, VALUE_BITS, d < 0 ? -d : d);
            if (d) put_bit(e, d < 0, &m.signs[sign(g) + 1]);
        }
    }
    return DONE;
}

static int64_t put_varint(uint8_t *out, uint64_t v)
{
    int64_t size = 0;
    for (; v > 0x7F; v >>= 7) out[size++] = (uint8_t)(v | 0x80);
    out[size++] = (uint8_t)v;
    return size;
}

int64_t hapfmt_pack_knots(const int64_t *ticks, const int64_t *indices, int64_t knots, int linear,
                          uint8_t *packet, int64_t room)
{
    enum { HEAD = 20 };
    if (room < HEAD) return -3;
    int64_t first = indices[0], at = put_varint(packet, (uint64_t)first << 1 ^ (uint64_t)(first >> 63));
    if (knots == 1) return at;
    at += put_varint(packet + at, (uint64_t)knots - 1);
    encoder e;
    encoder_init(&e, packet + at, room - at);
    if (encode_knots(&e, ticks, indices, knots, 1, linear) != DONE) return -2;
    int64_t size = encoder_finish(&e);
    return size > room - at ? -3 : at + size;
}

/* (ticks int64 [knots], indices int64 [knots * components], lines, coded bytes) -> (status, size) */
static PyObject *coded_knots_encode(PyObject *self, PyObject *args)
{
    Py_buffer ticks, indices, out;
    int linear, status = BAD_TICK;
    int64_t size = 0;
    PyObject *result = NULL;
    (void)self;
    if (!PyArg_ParseTuple(args, "y*y*pw*", &ticks, &indices, &linear, &out)) return NULL;
    if (!whole(&ticks, 8) || !whole(&indices, 8) || !ticks.len || indices.len % ticks.len)
        PyErr_SetString(PyExc_ValueError, "not arrays of knots");
    else {
        Py_BEGIN_ALLOW_THREADS
        encoder e;
        encoder_init(&e, out.buf, out.len);
        status = encode_knots(&e, ticks.buf, indices.buf, ticks.len / 8, indices.len / ticks.len,
                              linear);
        if (status == DONE) {
            size = encoder_finish(&e);
            if (size > out.len) status = NO_ROOM;
        }
        Py_END_ALLOW_THREADS
        result = Py_BuildValue("iL", status, (long long)size);
    }
    PyBuffer_Release(&ticks);
    PyBuffer_Release(&indices);
    PyBuffer_Release(&out);
    return result;
}

PyMethodDef hapfmt_knots_coded_methods[] = {
    {"coded_knots_decode", coded_knots_decode, METH_VARARGS, NULL},
    {"coded_knots_encode", coded_knots_encode, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

void hapfmt_knots_coded_prepare(void)
{
    build_tables();
}
