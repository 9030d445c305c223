/* The hot loops of LPCX (SPEC 9.7); the readable twin is hapfmt/codecs/exact.py.

   The input is hostile: every id is checked to be below the number of ids. At most as many nodes are
   remembered as there are samples. */
#include "kernels.h"

#include "coded.h"

#if defined(__GNUC__)
/* Not every function of the headers is used here. */
#pragma GCC diagnostic ignored "-Wunused-function"
#endif

enum { REMEMBERED = 32, RECALL = 1, FOUR = 2 };
enum { FRESH = 0, SAME = 1, KNOWN = 2, RECALLS = 3, RANKS = 6, LENGTH_CODES = 2 * RECALLS * RANKS };

/* The corrections of each count, in lists. */
typedef struct {
    int64_t *values;
    int32_t nodes, *links, *heads; /* links and heads: one more than a node, 0 for none */
} memory;

static void memory_init(memory *m, int64_t *work, int64_t span)
{
    m->nodes = 0;
    m->values = work;
    m->links = (int32_t *)(work + span);
    m->heads = m->links + span;
}

/* A new correction becomes the first of its count; the last of 32 makes room. */
static inline void remember(memory *m, int32_t id, int64_t correction)
{
    int32_t *link = &m->heads[id], node;
    int known = 0;
    while (*link && known < REMEMBERED - 1) {
        link = &m->links[*link - 1];
        known++;
    }
    if (*link) {
        node = *link;
        *link = 0;
    } else
        node = ++m->nodes;
    m->values[node - 1] = correction;
    m->links[node - 1] = m->heads[id];
    m->heads[id] = node;
}

static inline void to_front(memory *m, int32_t id, int32_t *link)
{
    int32_t node = *link;
    *link = m->links[node - 1];
    m->links[node - 1] = m->heads[id];
    m->heads[id] = node;
}

/* ---- decoding ---- */

typedef struct {
    int recall, lanes;
    uint8_t p[RECALLS][REMEMBERED];
    length_table lengths;
} heading;

/* Bytes of the heading before the coded bytes; 0 if the heading is not defined. */
static int64_t take_heading(const uint8_t *in, int64_t size, heading *h)
{
    int64_t at = 2;
    if (size < 2) return 0;
    h->recall = in[0] & RECALL;
    h->lanes = in[0] & FOUR ? 4 : 1;
    for (int x = 0; h->recall && x < RECALLS; x++) {
        int count = at < size ? in[at++] : 0xFF;
        if (count > REMEMBERED || at + count > size) return 0;
        for (int i = 0; i < REMEMBERED; i++)
            h->p[x][i] = count ? in[at + (i < count ? i : count - 1)] : 128;
        for (int i = 0; i < count; i++)
            if (!in[at + i]) return 0;
        at += count;
    }
    int64_t taken = take_lengths(in + at, size - at, &h->lengths);
    return taken ? at + taken : 0;
}

/* ``ranks`` [span]: the place on the list of its count, -1 where a correction is coded in full;
   ``known`` [span] of zeros: how long the lists are. */
static int get_ranks(decoder *d, const heading *h, const int32_t *ids, int64_t span, int8_t *ranks,
                     uint8_t *known)
{
    int lane = 0;
    int32_t last = -1;
    for (int64_t t = 0; t < span; t++) {
        int32_t id = ids[t];
        int x = !known[id] ? FRESH : id == last ? SAME : KNOWN, count = known[id] ? known[id] : 1;
        ranks[t] = -1;
        for (int i = 0; i < count && ranks[t] < 0; i++) {
            if (get_bit(d, lane, h->p[x][i])) ranks[t] = (int8_t)i;
            lane = (lane + 1) & (d->lanes - 1);
            if (overrun(d)) return BAD_END;
        }
        if (x == FRESH) known[id] = 1;
        else if (ranks[t] < 0 && known[id] < REMEMBERED) known[id]++;
        last = id;
    }
    return DONE;
}

static int decode_corrections(uint8_t *in, int64_t size, const int32_t *ids, int64_t *out,
                              int64_t span, int64_t *work, int64_t *taken)
{
    heading h;
    decoder d;
    memory m;
    int64_t head = take_heading(in, size, &h);
    int lane = 0;
    *taken = 0;
    if (!head) return BAD_CODING;
    int8_t *ranks = calloc((size_t)span + 1, 2);
    if (!ranks) return NO_MEMORY;
    decoder_init(&d, in, head, size, h.lanes);
    int status = overrun(&d) ? BAD_END : DONE;
    if (ids && !status) status = get_ranks(&d, &h, ids, span, ranks, (uint8_t *)ranks + span);
    memory_init(&m, work, ids ? span : 0);
    for (int64_t t = 0; t < span && !status; t++) {
        int rank = ids ? ranks[t] : -1;
        if (rank >= 0 && !m.heads[ids[t]]) {
            out[t] = 0;
            remember(&m, ids[t], 0);
        } else if (rank >= 0) {
            int32_t *link = &m.heads[ids[t]];
            while (rank-- > 0) link = &m.links[*link - 1];
            out[t] = m.values[*link - 1];
            to_front(&m, ids[t], link);
        } else {
            status = get_length(&d, &h.lengths, lane, out + t);
            lane = (lane + 1) & (d.lanes - 1);
            if (ids) remember(&m, ids[t], out[t]);
        }
    }
    free(ranks);
    if (!status) status = check_end(&d);
    *taken = head + front_taken(&d);
    return status;
}

/* ---- encoding ---- */

static int rank_code(int x, int i, int bit) { return 2 * (RANKS * x + (i < RANKS ? i : RANKS - 1)) + bit; }

/* Notes the bits of all ranks. ``full``: the corrections that are on no list; how many. */
static int64_t note_ranks(encoder *e, memory *m, const int32_t *ids, const int64_t *in, int64_t span,
                          int64_t *full, int64_t *counts)
{
    int32_t last = -1;
    int64_t count = 0;
    note(e, SECTION);
    for (int64_t t = 0; t < span; t++) {
        int32_t id = ids[t], *link = &m->heads[id];
        int x = !*link ? FRESH : id == last ? SAME : KNOWN, found = 0;
        for (int i = 0; !found && (*link || (x == FRESH && !i)); i++) {
            found = x == FRESH ? !in[t] : m->values[*link - 1] == in[t];
            int code = rank_code(x, i, found);
            note(e, code);
            counts[code]++;
            if (!found && x != FRESH) link = &m->links[*link - 1];
        }
        if (found && x != FRESH) to_front(m, id, link);
        else remember(m, id, in[t]);
        if (!found) full[count++] = in[t];
        last = id;
    }
    return count;
}

static int64_t put_recall(uint8_t *out, share *shares, const int64_t *counts)
{
    int64_t at = 0;
    for (int x = 0; x < RECALLS; x++) {
        const int64_t *these = counts + rank_code(x, 0, 0);
        int used = 0;
        for (int i = 0; i < RANKS; i++)
            if (these[2 * i] + these[2 * i + 1]) used = i + 1;
        out[at++] = (uint8_t)used;
        at += put_bits(shares + rank_code(x, 0, 0), out + at, these, used);
    }
    return at;
}

static int encode_corrections(uint8_t *out, int64_t size, const int32_t *ids, const int64_t *in,
                              int64_t span, int shift, int64_t *work, int64_t *written)
{
    enum { HEAD = 2 + RECALLS * (1 + RANKS) + 2 + LENGTHS };
    memory m;
    encoder e;
    int64_t counts[LENGTH_CODES + LENGTHS] = {0}, full = span, head = 2, room = size - HEAD;
    share shares[LENGTH_CODES + LENGTHS];
    uint8_t start[HEAD];
    *written = size + HEAD;
    if (room < 0) return NO_ROOM;
    for (int64_t t = 0; t < span; t++)
        if (in[t] == INT64_MIN) return BAD_ERROR;
    /* A rank takes up to 32 bits. */
    int64_t most = ids ? 34 * span + 8 : span + 8;
    uint16_t *codes = malloc((size_t)(2 * most));
    int64_t *rest = malloc((size_t)(8 * span + 8));
    uint16_t *words = NULL;
    int status = codes && rest ? DONE : NO_MEMORY;
    if (!status) {
        encoder_init(&e, codes, out + HEAD, room);
        memory_init(&m, work, ids ? span : 0);
        if (ids) full = note_ranks(&e, &m, ids, in, span, rest, counts);
        else memcpy(rest, in, (size_t)(8 * span));
        note(&e, SECTION);
        for (int64_t i = 0; i < full; i++) {
            int length = bit_length((uint64_t)(rest[i] < 0 ? -rest[i] : rest[i]));
            counts[LENGTH_CODES + length]++;
            put_length(&e, rest[i], LENGTH_CODES);
        }
        words = malloc((size_t)(2 * (e.noted + 8)));
        if (!words) status = NO_MEMORY;
    }
    if (!status) {
        int four = e.noted >= MANY;
        start[0] = (uint8_t)((ids ? RECALL : 0) | FOUR * four);
        start[1] = (uint8_t)shift;
        if (ids) head += put_recall(start + head, shares, counts);
        head += put_lengths(start + head, shares + LENGTH_CODES, counts + LENGTH_CODES);
        int64_t coded = encoder_finish(&e, shares, four ? 4 : 1, words);
        *written = coded > room ? coded + HEAD : head + coded;
        if (coded > room) status = NO_ROOM;
        else {
            memmove(out + head, out + HEAD, (size_t)coded);
            memcpy(out, start, (size_t)head);
        }
    }
    free(codes);
    free(rest);
    free(words);
    return status;
}

static int fits(const Py_buffer *ids, const Py_buffer *corrections, const Py_buffer *work)
{
    int64_t span = corrections->len / 8;
    int right = whole(ids, 4) && whole(corrections, 8) && whole(work, 8);
    if (!ids->len) return right;
    right = right && ids->len == 4 * span && work->len == 16 * span && span <= INT32_MAX;
    const int32_t *names = ids->buf;
    for (int64_t t = 0; right && t < span; t++) right = names[t] >= 0 && names[t] < span;
    return right;
}

/* (exact values of a packet, ids int32 or none, corrections int64, work int64 of zeros, shift)
   -> (status, bytes read or written) */
static PyObject *run_corrections(PyObject *args, int decoding)
{
    Py_buffer coded, ids, corrections, work;
    int shift, status = NO_ROOM;
    if (!PyArg_ParseTuple(args, decoding ? "y*y*w*w*i" : "w*y*y*w*i", &coded, &ids, &corrections,
                          &work, &shift))
        return NULL;
    PyObject *result = NULL;
    int64_t span = corrections.len / 8, size = 0;
    if (shift < 0 || shift >= LENGTHS || !fits(&ids, &corrections, &work))
        PyErr_SetString(PyExc_ValueError, "not arrays of corrections");
    else {
        const int32_t *names = ids.len ? ids.buf : NULL;
        Py_BEGIN_ALLOW_THREADS
        if (decoding) {
            uint8_t *copy = with_margins(coded.buf, coded.len);
            status = !copy ? NO_MEMORY : decode_corrections(copy + MARGIN, coded.len, names,
                                                            corrections.buf, span, work.buf, &size);
            free(copy);
        } else
            status = encode_corrections(coded.buf, coded.len, names, corrections.buf, span, shift,
                                        work.buf, &size);
        Py_END_ALLOW_THREADS
        result = status == NO_MEMORY ? PyErr_NoMemory() : Py_BuildValue("iL", status, (long long)size);
    }
    PyBuffer_Release(&coded);
    PyBuffer_Release(&ids);
    PyBuffer_Release(&corrections);
    PyBuffer_Release(&work);
    return result;
}

static PyObject *exact_decode(PyObject *self, PyObject *args)
{
    (void)self;
    return run_corrections(args, 1);
}

static PyObject *exact_encode(PyObject *self, PyObject *args)
{
    (void)self;
    return run_corrections(args, 0);
}

PyMethodDef hapfmt_exact_methods[] = {
    {"exact_decode", exact_decode, METH_VARARGS, NULL},
    {"exact_encode", exact_encode, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
