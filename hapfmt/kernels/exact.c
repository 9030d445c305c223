/* The hot loops of LPCX (SPEC 9.7); the readable twin is hapfmt/codecs/exact.py.

   The input is hostile. ids are checked to be below their number; a field has at most 63 bits, and is
   read only where the bits hold it; what is remembered are at most as many nodes as samples. */
#include "kernels.h"

#include "coder.h"

enum { BAD_BITS = 6, LENGTHS = 64, ABSOLUTE = 255, HIGH_BITS = 10, REMEMBERED = 32 };
enum { FRESH = 0, SAME = 1, KNOWN = 2 };

typedef struct {
    bit_model lengths[LENGTHS], highs[1 << HIGH_BITS], recalls[3][REMEMBERED];
    int64_t last, *values;
    int32_t nodes, *links, *heads; /* links and heads: one more than a node, 0 for none */
} correction_model;

typedef struct {
    uint8_t *bytes;
    int64_t size, used; /* bytes there are, bits that were passed */
} bit_field;

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

static inline uint64_t get_field(bit_field *f, int size)
{
    uint64_t field = 0;
    int64_t at_byte = f->used >> 3;
    int at_bit = (int)(f->used & 7);
    if (at_byte + 8 <= f->size && at_bit + size <= 64) {
        for (int i = 0; i < 8; i++) field = field << 8 | f->bytes[at_byte + i];
        f->used += size;
        return field << at_bit >> (64 - size);
    }
    for (int left = size; left > 0;) {
        int at = (int)(f->used & 7), take = 8 - at < left ? 8 - at : left;
        uint8_t byte = f->bytes[f->used >> 3];
        field = field << take | (uint64_t)(byte >> (8 - at - take) & ((1 << take) - 1));
        f->used += take;
        left -= take;
    }
    return field;
}

static inline void put_field(bit_field *f, int size, uint64_t field)
{
    for (int left = size; left > 0;) {
        int at = (int)(f->used & 7), take = 8 - at < left ? 8 - at : left;
        uint8_t part = (uint8_t)(field >> (left - take) & ((1u << take) - 1));
        if (f->used >> 3 < f->size) {
            uint8_t *byte = &f->bytes[f->used >> 3];
            *byte = (uint8_t)((at ? *byte : 0) | part << (8 - at - take));
        }
        f->used += take;
        left -= take;
    }
}

static int decode_corrections(decoder *c, bit_field *f, correction_model *m, const int32_t *ids,
                              const uint8_t *widths, int64_t *out, int64_t span, int shift)
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
        if (widths[t] != ABSOLUTE) length = (widths[t] - length) & (LENGTHS - 1);
        int size = length - high_bits(length, shift);
        uint64_t high = get_tree(c, m->highs, length - size);
        if (f->used + size > 8 * f->size) return BAD_BITS;
        out[t] = 0;
        if (size) {
            uint64_t field = get_field(f, size), top = (uint64_t)1 << (size - 1);
            high |= (uint64_t)1 << (length - size);
            out[t] = (int64_t)(high << (size - 1) | (field & (top - 1)));
            if (field & top) out[t] = -out[t];
        }
        if (ids) remember(m, id, out[t]);
    }
    if (check_end(c)) return BAD_END;
    int spare = (int)(-f->used & 7);
    if (f->size != (f->used + 7) / 8) return BAD_BITS;
    return f->size && f->bytes[f->size - 1] & ((1 << spare) - 1) ? BAD_BITS : DONE;
}

static int encode_corrections(encoder *c, bit_field *f, correction_model *m, const int32_t *ids,
                              const uint8_t *widths, const int64_t *in, int64_t span,
                              int shift, int64_t *written)
{
    *written = 0;
    for (int64_t t = 0; t < span; t++) {
        int32_t id = ids ? ids[t] : 0;
        int found = 0;
        if (in[t] == INT64_MIN) return BAD_BITS;
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
        int symbol = widths[t] == ABSOLUTE ? length : (widths[t] - length) & (LENGTHS - 1);
        for (int i = 0; i < symbol; i++) put_bit(c, 1, &m->lengths[i]);
        if (symbol < LENGTHS - 1) put_bit(c, 0, &m->lengths[symbol]);
        if (size) {
            uint64_t top = (uint64_t)1 << (size - 1), rest = magnitude ^ (uint64_t)1 << (length - 1);
            put_tree(c, m->highs, rest >> (size - 1), length - size);
            put_field(f, size, (in[t] < 0 ? top : 0) | (rest & (top - 1)));
        }
    }
    *written = encoder_finish(c);
    return *written > c->size || (f->used + 7) / 8 > f->size ? NO_ROOM : DONE;
}

static int fits(const Py_buffer *ids, const Py_buffer *widths, const Py_buffer *corrections,
                const Py_buffer *work)
{
    int64_t span = widths->len;
    int right = ids->len % 4 == 0 && (uintptr_t)ids->buf % 4 == 0 &&
                corrections->len == 8 * span && (uintptr_t)corrections->buf % 8 == 0 &&
                (uintptr_t)work->buf % 8 == 0;
    if (!ids->len) return right;
    right = right && ids->len == 4 * span && work->len == 16 * span && span <= INT32_MAX;
    const int32_t *names = ids->buf;
    for (int64_t t = 0; right && t < span; t++) right = names[t] >= 0 && names[t] < span;
    return right;
}

/* (coded, bits, ids int32 or none, widths uint8, corrections int64, work int64 of zeros, shift)
   -> (status, bytes read or written, bits read or written) */
static PyObject *run_corrections(PyObject *args, int decoding)
{
    Py_buffer coded, bits, ids, widths, corrections, work;
    int shift, status = NO_ROOM;
    if (!PyArg_ParseTuple(args, decoding ? "y*y*y*y*w*w*i" : "w*w*y*y*y*w*i", &coded, &bits, &ids,
                          &widths, &corrections, &work, &shift))
        return NULL;
    PyObject *result = NULL;
    correction_model m;
    bit_field f = {bits.buf, bits.len, 0};
    int64_t span = widths.len, size = 0;
    if (shift < 0 || shift >= LENGTHS || !fits(&ids, &widths, &corrections, &work))
        PyErr_SetString(PyExc_ValueError, "not arrays of corrections");
    else {
        const int32_t *names = ids.len ? ids.buf : NULL;
        Py_BEGIN_ALLOW_THREADS
        corrections_init(&m, work.buf, names ? span : 0);
        if (decoding) {
            decoder d;
            decoder_init(&d, coded.buf, coded.len);
            status = decode_corrections(&d, &f, &m, names, widths.buf, corrections.buf, span,
                                        shift);
            size = (bits_taken(&d) - 15) / 8;
        } else {
            encoder e;
            encoder_init(&e, coded.buf, coded.len);
            status = encode_corrections(&e, &f, &m, names, widths.buf, corrections.buf, span,
                                        shift, &size);
        }
        Py_END_ALLOW_THREADS
        result = Py_BuildValue("iLL", status, (long long)size, (long long)f.used);
    }
    PyBuffer_Release(&coded);
    PyBuffer_Release(&bits);
    PyBuffer_Release(&ids);
    PyBuffer_Release(&widths);
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
