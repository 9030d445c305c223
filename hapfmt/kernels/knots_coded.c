/* The loops of entropy coded knots (SPEC 9.6); the readable twin is hapfmt/codecs/knots.py.

   The decoder's input is hostile. An index is within ``limit`` <= 2^32 before it is used. A difference
   has at most 34 bits. A tick is below the span before anything is written. */
#include "kernels.h"

#include "coded.h"
#include "lines.h"

enum { BAD_TICK = 8, SIGNS_LATER = 32, FOUR = 16, BY_LENGTH = 64 };
static const int64_t FARTHEST = (int64_t)1 << 48; /* ticks whose differences do not overflow */

/* ---- decoding ---- */

typedef struct {
    shape shape;
    places places;
    int64_t span, further;
    int linear;
} knot_plan;

/* How a row of numbers is coded: by a class, or by their lengths. */
typedef struct {
    int class, start, lanes, signs, by_length;
    uint8_t sign[SIGN_CONTEXTS];
    length_table lengths;
} row_coding;

/* How many bytes it takes; 0 where it is not defined. ``unused``: bits that are 0. */
static int64_t take_row(const uint8_t *in, int64_t size, int unused, row_coding *r)
{
    int64_t head = 2;
    if (size < 2 || in[0] & unused) return 0;
    r->class = in[0] & 15;
    r->lanes = in[0] & FOUR ? 4 : 1;
    r->signs = in[0] & SIGNS_LATER ? LATER_SIGNS : RAW_SIGNS;
    r->by_length = in[0] & BY_LENGTH;
    r->start = in[1];
    if (r->by_length) {
        int64_t taken = r->class ? 0 : take_lengths(in + 1, size - 1, &r->lengths);
        if (!taken || r->lengths.first + r->lengths.count > ERROR_BITS + 1) return 0;
        head = 1 + taken;
    } else if (r->start > START_MOST)
        return 0;
    if (r->signs == LATER_SIGNS) {
        if (size < head + SIGN_CONTEXTS || !in[head] || !in[head + 1] || !in[head + 2]) return 0;
        memcpy(r->sign, in + head, SIGN_CONTEXTS);
        head += SIGN_CONTEXTS;
    }
    return head;
}

static int get_row(decoder *d, const row_coding *r, int64_t count, int signs, int64_t *out)
{
    int status = DONE, lane = 0;
    if (!r->by_length) return get_integers(d, r->class, r->start, count, out, signs);
    for (int64_t i = 0; i < count && !status; i++) {
        status = get_length(d, &r->lengths, lane, signs, out + i);
        lane = (lane + 1) & (d->lanes - 1);
    }
    return status;
}

/* ``numbers``: gaps and then differences, component by component. */
static int get_knots(uint8_t *in, int64_t size, const knot_plan *p, int64_t *numbers, int64_t *taken)
{
    int64_t gaps = p->further - p->linear, differences = p->further * p->shape.components;
    row_coding first, second;
    decoder d;
    *taken = 0;
    int64_t head = take_row(in, size, 128 | SIGNS_LATER, &first), more = 0;
    if (head) more = take_row(in + head, size - head, 128 | FOUR, &second);
    if (!more) return BAD_CODING;
    head += more;
    decoder_init(&d, in, head, size, first.lanes);
    int status = overrun(&d) ? BAD_END : DONE;
    if (!status) status = get_row(&d, &first, gaps, UNSIGNED, numbers);
    if (!status) status = get_row(&d, &second, differences, second.signs, numbers + gaps);
    if (!status && second.signs == LATER_SIGNS)
        status = get_signs(&d, second.sign, differences, numbers + gaps);
    if (!status) status = check_end(&d);
    *taken = head + front_taken(&d);
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

enum { ROW_CODES = BITS, SIGN_PLACES = 2 * ROW_CODES };
enum { ROW_HEAD = 3 + LENGTHS + SIGN_CONTEXTS, HEAD = 2 * ROW_HEAD };

/* Notes a row of numbers in the way that takes less; the byte of its coding without flags, -1 where a
   number has no code. *head: bytes that follow it in ``out``. */
static int put_row(encoder *e, const int64_t *in, int64_t count, int signs, int codes, share *shares,
                   uint8_t *out, int64_t *head)
{
    histogram seen = {{0}}, again = {{0}};
    int64_t lengths[LENGTHS] = {0}, cost, other;
    share own[LENGTHS];
    int start = start_of(in, count);
    int64_t raw = survey(in, count, start, &seen);
    if (raw < 0) return -1;
    int class = best_class(&seen, &cost);
    for (int64_t i = 0; i < count; i++) lengths[bit_length((uint64_t)(in[i] < 0 ? -in[i] : in[i]))]++;
    *head = put_lengths(out, own, lengths);
    other = 2048 * *head;
    for (int i = 0; i < LENGTHS; i++)
        if (lengths[i])
            other += lengths[i] * ((int64_t)floor(256 * log2((double)SCALE / own[i].width) + 0.5) +
                                   256 * (i ? i - 1 : 0));
    if (other < cost + 256 * raw + 2048) {
        memcpy(shares + codes, own, sizeof own);
        note(e, SECTION);
        for (int64_t i = 0; i < count; i++) put_length(e, in[i], signs, codes);
        return BY_LENGTH;
    }
    memcpy(shares + codes, hapfmt_classes[class].shares, sizeof hapfmt_classes[class].shares);
    out[0] = (uint8_t)start;
    *head = 1;
    put_integers(e, in, count, start, signs, codes, &again);
    return class;
}

/* The coded bytes of knots after the first one; *size: how many. */
static int encode_knots(const int64_t *ticks, const int64_t *indices, int64_t knots, int64_t components,
                        int linear, uint8_t *out, int64_t room, int64_t *size)
{
    int64_t further = knots - 1, gaps = further - (linear && further), differences = further * components;
    for (int64_t i = 0; i < knots * components; i++)
        if (indices[i] > FARTHEST_INDEX || indices[i] < -FARTHEST_INDEX) return BAD_INDEX;
    for (int64_t k = 0; k < knots; k++)
        if (ticks[k] < 0 || ticks[k] > FARTHEST || (k && ticks[k] <= ticks[k - 1])) return BAD_TICK;
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
    share shares[SIGN_PLACES + 2 * SIGN_CONTEXTS];
    uint8_t start[HEAD], *second = start;
    int64_t signs[2 * SIGN_CONTEXTS], head = 0, more = 0;
    room = room < HEAD ? 0 : room - HEAD;
    encoder_init(&e, w.codes, out + HEAD, room);
    int later = signs_pay(numbers + gaps, differences, signs), other = -1;
    int way = put_row(&e, numbers, gaps, UNSIGNED, 0, shares, start + 1, &head);
    if (way >= 0) {
        second = start + 1 + head;
        other = put_row(&e, numbers + gaps, differences, later ? UNSIGNED : RAW_SIGNS, ROW_CODES, shares,
                        second + 1, &more);
    }
    int status = other < 0 ? BAD_ERROR : DONE;
    if (!status) {
        if (later) note_signs(&e, numbers + gaps, differences, SIGN_PLACES);
        int four = e.noted >= MANY;
        start[0] = (uint8_t)(way | FOUR * four);
        second[0] = (uint8_t)(other | SIGNS_LATER * later);
        head += 2 + more;
        if (later) head += put_bits(shares + SIGN_PLACES, start + head, signs, SIGN_CONTEXTS);
        int64_t coded = encoder_finish(&e, shares, four ? 4 : 1, w.words);
        *size = coded > room ? coded + HEAD : head + coded;
        if (coded > room) status = NO_ROOM;
        else {
            memmove(out + head, out + HEAD, (size_t)coded);
            memcpy(out, start, (size_t)head);
        }
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
