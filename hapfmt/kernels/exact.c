/* The hot loops of LPCX (SPEC 9.7); the readable twin is hapfmt/codecs/exact.py.

   The input is hostile. ids are checked to be below their number; 53 raw bits at most are taken at
   once; what is remembered are at most as many nodes as samples. */
#include "kernels.h"

#include "coder.h"

enum { LENGTHS = 64, HIGH_BITS = 10, REMEMBERED = 32 };
enum { FRESH = 0, SAME = 1, KNOWN = 2 };

typedef struct {
    bit_model lengths[LENGTHS], highs[1 << HIGH_BITS], recalls[3][REMEMBERED];
    int64_t last, *values;
    int32_t nodes, *links, *heads; /* links and heads: one more than a node, 0 for none */
} correction_model;

static void corrections_init(correction_model *m, int64_t *work, int64_t span)
{
    bit_model fresh = {32768, 32768, 0};
    for (int i = 0; i < LENGTHS; i++) m->lengths[i] = fresh;
    for (int i = 0; i < 1 << HIGH_BITS; i++) m->highs[i] = fresh;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < REMEMBERED; j++) m->recalls[i][j] = fresh;
    m->last = -1;
    m->nodes = 0;
    m->values = work;
    m->links = (int32_t *)(work + span);
    m->heads = m->links + span;
}

static inline bit_model *meet(correction_model *m, int32_t id)
{
    int context = !m->heads[id] ? FRESH : id == m->last ? SAME : KNOWN;
    m->last = id;
    return m->recalls[context];
}

/* A new correction becomes the first of its count; the last of 32 makes room. */
static inline void remember(correction_model *m, int32_t id, int64_t correction)
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

static inline void to_front(correction_model *m, int32_t id, int32_t *link)
{
    int32_t node = *link;
    *link = m->links[node - 1];
    m->links[node - 1] = m->heads[id];
    m->heads[id] = node;
}

static inline uint64_t get_tree(decoder *c, bit_model *models, int bits)
{
    int node = 1;
    for (int i = 0; i < bits; i++) node = 2 * node + get_bit(c, &models[node]);
    return (uint64_t)(node - (1 << bits));
}

static inline void put_tree(encoder *c, bit_model *models, uint64_t value, int bits)
{
    int node = 1;
    while (bits-- > 0) {
        int bit = (int)(value >> bits & 1);
        put_bit(c, bit, &models[node]);
        node = 2 * node + bit;
    }
}

/* Bits of a correction that belong to the exponent, below the leading 1: e of SPEC 9.7. */
static inline int high_bits(int length, int shift)
{
    int high = length + shift - 53;
    if (high > length - 1) high = length - 1;
    if (high > HIGH_BITS) high = HIGH_BITS;
    return high < 0 ? 0 : high;
}

static int decode_corrections(decoder *c, correction_model *m, const int32_t *ids, int64_t *out,
                              int64_t span, int shift)
{
    for (int64_t t = 0; t < span; t++) {
        if (overrun(c)) return BAD_END;
        int32_t id = ids ? ids[t] : 0;
        int found = 0;
        if (ids) {
            bit_model *models = meet(m, id);
            int32_t *link = &m->heads[id];
            if (!*link) {
                if (get_bit(c, &models[0])) {
                    out[t] = 0;
                    remember(m, id, 0);
                    continue;
                }
            } else
                for (int i = 0; *link && !found; i++) {
                    found = get_bit(c, &models[i]);
                    if (!found) link = &m->links[*link - 1];
                }
            if (found) {
                out[t] = m->values[*link - 1];
                to_front(m, id, link);
                continue;
            }
        }
        int length = 0;
        while (length < LENGTHS - 1 && get_bit(c, &m->lengths[length])) length++;
        int size = length - high_bits(length, shift);
        uint64_t high = get_tree(c, m->highs, length - size);
        out[t] = 0;
        if (size) {
            uint64_t field = get_raw(c, size), top = (uint64_t)1 << (size - 1);
            high |= (uint64_t)1 << (length - size);
            out[t] = (int64_t)(high << (size - 1) | (field & (top - 1)));
            if (field & top) out[t] = -out[t];
        }
        if (ids) remember(m, id, out[t]);
    }
    return check_end(c);
}

static int encode_corrections(encoder *c, correction_model *m, const int32_t *ids,
                              const int64_t *in, int64_t span, int shift, int64_t *written)
{
    *written = 0;
    for (int64_t t = 0; t < span; t++) {
        int32_t id = ids ? ids[t] : 0;
        int found = 0;
        if (in[t] == INT64_MIN) return BAD_ERROR;
        if (ids) {
            bit_model *models = meet(m, id);
            int32_t *link = &m->heads[id];
            if (!*link) {
                put_bit(c, !in[t], &models[0]);
                if (!in[t]) {
                    remember(m, id, 0);
                    continue;
                }
            } else
                for (int i = 0; *link && !found; i++) {
                    found = m->values[*link - 1] == in[t];
                    put_bit(c, found, &models[i]);
                    if (!found) link = &m->links[*link - 1];
                }
            if (found) {
                to_front(m, id, link);
                continue;
            }
            remember(m, id, in[t]);
        }
        uint64_t magnitude = (uint64_t)(in[t] < 0 ? -in[t] : in[t]);
        int length = bit_length(magnitude), size = length - high_bits(length, shift);
        for (int i = 0; i < length; i++) put_bit(c, 1, &m->lengths[i]);
        if (length < LENGTHS - 1) put_bit(c, 0, &m->lengths[length]);
        if (size) {
            uint64_t top = (uint64_t)1 << (size - 1), rest = magnitude ^ (uint64_t)1 << (length - 1);
            put_tree(c, m->highs, rest >> (size - 1), length - size);
            put_raw(c, (in[t] < 0 ? top : 0) | (rest & (top - 1)), size);
        }
    }
    *written = encoder_finish(c);
    return *written > c->size ? NO_ROOM : DONE;
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

/* (coded, ids int32 or none, corrections int64, work int64 of zeros, shift)
   -> (status, bytes read or written) */
static PyObject *run_corrections(PyObject *args, int decoding)
{
    Py_buffer coded, ids, corrections, work;
    int shift, status = NO_ROOM;
    if (!PyArg_ParseTuple(args, decoding ? "y*y*w*w*i" : "w*y*y*w*i", &coded, &ids, &corrections,
                          &work, &shift))
        return NULL;
    PyObject *result = NULL;
    correction_model m;
    int64_t span = corrections.len / 8, size = 0;
    if (shift < 0 || shift >= LENGTHS || !fits(&ids, &corrections, &work))
        PyErr_SetString(PyExc_ValueError, "not arrays of corrections");
    else {
        const int32_t *names = ids.len ? ids.buf : NULL;
        Py_BEGIN_ALLOW_THREADS
        corrections_init(&m, work.buf, names ? span : 0);
        if (decoding) {
            decoder d;
            decoder_init(&d, coded.buf, coded.len);
            status = decode_corrections(&d, &m, names, corrections.buf, span, shift);
            size = (bits_taken(&d) - 15) / 8;
        } else {
            encoder e;
            encoder_init(&e, coded.buf, coded.len);
            status = encode_corrections(&e, &m, names, corrections.buf, span, shift, &size);
        }
        Py_END_ALLOW_THREADS
        result = Py_BuildValue("iL", status, (long long)size);
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

void hapfmt_exact_prepare(void)
{
    build_tables();
}
