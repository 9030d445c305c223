/* The loops of entropy coded knots (SPEC 9.6); the readable twin is hapfmt/codecs/knots.py.

   The decoder's input is hostile. An index is within ``limit`` <= 2^32 before it is used. A difference
   has at most 34 bits. A tick is below the span before anything is written. */
#include "kernels.h"

#include "flags.h"
#include "lines.h"

enum { BAD_TICK = 8 };
static const int64_t FARTHEST = (int64_t)1 << 48; /* ticks whose differences do not overflow */
static const int64_t LONGEST_GAP = (int64_t)1 << 33;

/* ---- decoding ---- */

typedef struct {
    shape shape;
    places places;
    int64_t span, further;
    int linear;
} knot_plan;

/* ``numbers``: gaps and then differences, component by component. */
static int get_knots(uint8_t *in, int64_t size, const knot_plan *p, int64_t *numbers, int64_t *taken)
{
    int64_t gaps = p->further - p->linear, differences = p->further * p->shape.components;
    decoder d;
    decoder_init(&d, in, 0, size, 1);
    int status = overrun(&d) ? BAD_END : DONE;
    if (!status) status = get_by_bits(&d, gaps, numbers, UNSIGNED);
    if (!status) status = get_by_bits(&d, differences, numbers + gaps, RAW_SIGNS);
    if (!status) status = check_end(&d);
    *taken = front_taken(&d);
    return status;
}

/* ``row``: indices of the last knot; ``counts``: what they stand for. */
static int decode_knots(const knot_plan *p, const int64_t *numbers, int64_t *row, int64_t *counts,
                        int32_t *out)
{
    const int64_t *gaps = numbers, *differences = numbers + p->further - p->linear;
    int64_t tick = 0;
    int components = p->shape.components;
    for (int c = 0; c < components; c++) counts[c] = count_of(&p->places, row[c]);
    for (int64_t k = 0; k < p->further; k++) {
        int64_t from = tick, stop, left = p->further - 1 - k;
        int inside = 1;
        if (p->linear && !left) {
            tick = p->span - 1;
            stop = p->span;
        } else {
            stop = tick += gaps[k] + 1;
            if (tick >= p->span - left) return BAD_TICK;
        }
        for (int c = 0; c < components; c++) {
            row[c] += differences[c * p->further + k];
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
    return DONE;
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
   grid int64 or none, least and largest count, first indices int64 [components], room
   int64 [2 * components], counts int32 [ticks * components]) -> (status, bytes read) */
static PyObject *coded_knots_decode(PyObject *self, PyObject *args)
{
    Py_buffer coded, levels, first, work, out;
    long long further;
    knot_plan p;
    int status = DONE, memory = 1;
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
        Py_BEGIN_ALLOW_THREADS
        uint8_t *copy = with_margins(coded.buf, coded.len);
        int64_t *numbers = malloc((size_t)(8 * p.further * (1 + p.shape.components) + 8));
        memory = copy && numbers;
        if (memory && p.further) status = get_knots(copy + MARGIN, coded.len, &p, numbers, &size);
        if (memory && !status) status = decode_knots(&p, numbers, first.buf, work.buf, out.buf);
        free(copy);
        free(numbers);
        Py_END_ALLOW_THREADS
        if (memory) result = Py_BuildValue("iL", status, (long long)size);
        else PyErr_NoMemory();
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

/* The coded bytes of knots after the first one; *size: how many. */
static int encode_knots(const int64_t *ticks, const int64_t *indices, int64_t knots, int64_t components,
                        int linear, uint8_t *out, int64_t room, int64_t *size)
{
    int64_t further = knots - 1, gaps = further - (linear && further), differences = further * components;
    for (int64_t i = 0; i < knots * components; i++)
        if (indices[i] > FARTHEST_INDEX || indices[i] < -FARTHEST_INDEX) return BAD_INDEX;
    for (int64_t k = 0; k < knots; k++)
        if (ticks[k] < 0 || ticks[k] > FARTHEST ||
            (k && (ticks[k] <= ticks[k - 1] || ticks[k] - ticks[k - 1] > LONGEST_GAP)))
            return BAD_TICK;
    workshop w;
    if (!workshop_open(&w, further + differences)) {
        workshop_close(&w);
        return NO_MEMORY;
    }
    int64_t *numbers = w.errors;
    for (int64_t k = 0; k < gaps; k++) numbers[k] = ticks[k + 1] - ticks[k] - 1;
    for (int64_t c = 0; c < components; c++)
        for (int64_t k = 0; k < further; k++)
            numbers[gaps + c * further + k] = indices[(k + 1) * components + c] - indices[k * components + c];
    encoder e;
    int64_t cost;
    int status = DONE;
    encoder_init(&e, w.codes, out, room);
    if (!note_by_bits(&e, &w, numbers, gaps, UNSIGNED, &cost) ||
        !note_by_bits(&e, &w, numbers + gaps, differences, RAW_SIGNS, &cost))
        status = NO_MEMORY;
    else {
        put_raw_by_bits(&e, numbers, gaps + differences);
        *size = encoder_finish_flags(&e, NULL, w.words);
        if (*size > room) status = NO_ROOM;
    }
    workshop_close(&w);
    return status;
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
        status = encode_knots(ticks.buf, indices.buf, ticks.len / 8, indices.len / ticks.len, linear,
                              out.buf, out.len, &size);
        Py_END_ALLOW_THREADS
        result = status == NO_MEMORY ? PyErr_NoMemory() : Py_BuildValue("iL", status, (long long)size);
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
