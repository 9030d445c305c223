/* The hot loops of LPCR in C99. The readable twin is hapfmt/codecs/adaptive.py and predicted.py;
   property tests hold both equal, bit for bit. Nothing is allocated, no Python object is touched
   while the GIL is released.

   The input is hostile. What keeps every signed sum within 64 bits, whatever the bytes say:
   valid() admits |base| <= limit <= 2^32, |c| <= 2^21, at most 32 of them, and g <= 1 with them; each
   |e| < 2^34 and each |index| <= limit is checked before it is used. So |z| <= 2^33; sums[i], its i-th
   differences, 2^37; with coefficients |y| <= 2^34, predictions 2^5 * 2^21 * 2^34 = 2^60 before the
   shift; averages of 256 * |e| 2^42. Negative numbers are shifted to the right only, which rounds
   down on every compiler that builds CPython. */
#define Py_LIMITED_API 0x030B0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdint.h>
#include <string.h>

enum { LEAST = 64, MOST = 65472, COUNT_LIMIT = 250, FAST_FROM = 8 };
enum { CONTEXTS = 40, BUCKETS = 80, ORDERS = 32, DIFFERENCES = 4, SHIFT = 13 };
enum { DONE = 0, BAD_BUCKET = 1, BAD_ERROR = 2, BAD_INDEX = 3, BAD_END = 4, NO_ROOM = 5 };
enum { ERROR_BITS = 34, COEFFICIENT_LIMIT = 1 << 21 };
static const int64_t INDEX_LIMIT = (int64_t)1 << 32;

typedef struct { uint16_t p, q; uint8_t n; } bit_model;

typedef struct {
    int64_t f, s, t;
    int g;
    bit_model buckets[CONTEXTS][BUCKETS], halves[CONTEXTS][BUCKETS], signs[3], repeats[4];
} integer_model;

typedef struct {
    uint32_t x1, x2, x;
    const uint8_t *in;
    uint8_t *out;
    int64_t size, shifts;
} coder;

static uint16_t rates[COUNT_LIMIT + 1];

static void model_init(integer_model *m)
{
    bit_model fresh = {32768, 32768, 0};
    m->f = m->s = m->t = m->g = 0;
    for (int i = 0; i < CONTEXTS; i++)
        for (int j = 0; j < BUCKETS; j++) m->buckets[i][j] = m->halves[i][j] = fresh;
    for (int i = 0; i < 3; i++) m->signs[i] = fresh;
    for (int i = 0; i < 4; i++) m->repeats[i] = fresh;
}

static inline uint32_t probability(const bit_model *m)
{
    uint32_t mixed = m->n < FAST_FROM ? m->p : (3u * m->p + m->q) / 4;
    return mixed < LEAST ? LEAST : mixed > MOST ? MOST : mixed;
}

static inline void update(bit_model *m, int bit)
{
    int32_t t = bit ? 65535 : 0;
    m->p = (uint16_t)(m->p + (((int64_t)(t - m->p) * rates[m->n]) >> 16));
    m->q = (uint16_t)(m->q + ((t - m->q) >> 4));
    m->n = (uint8_t)(m->n + (m->n < COUNT_LIMIT));
}

static inline uint32_t middle(const coder *c, uint32_t p)
{
    uint32_t r = c->x2 - c->x1;
    return c->x1 + (r >> 16) * p + (((r & 0xFFFF) * p) >> 16);
}

static inline int get(coder *c, uint32_t p)
{
    uint32_t m = middle(c, p);
    int bit = c->x <= m;
    if (bit) c->x2 = m; else c->x1 = m + 1;
    while (!((c->x1 ^ c->x2) >> 24)) {
        int64_t at = c->shifts + 4;
        c->x1 <<= 8;
        c->x2 = c->x2 << 8 | 255;
        c->x = c->x << 8 | (at < c->size ? c->in[at] : 0);
        c->shifts++;
    }
    return bit;
}

static inline int get_bit(coder *c, bit_model *m)
{
    int bit = get(c, probability(m));
    update(m, bit);
    return bit;
}

static inline uint64_t get_raw(coder *c, int bits)
{
    uint64_t value = 0;
    while (bits-- > 0) value = value << 1 | (uint64_t)get(c, 32768);
    return value;
}

static inline void put(coder *c, int bit, uint32_t p)
{
    uint32_t m = middle(c, p);
    if (bit) c->x2 = m; else c->x1 = m + 1;
    while (!((c->x1 ^ c->x2) >> 24)) {
        if (c->shifts < c->size) c->out[c->shifts] = (uint8_t)(c->x2 >> 24);
        c->shifts++;
        c->x1 <<= 8;
        c->x2 = c->x2 << 8 | 255;
    }
}

static inline void put_bit(coder *c, int bit, bit_model *m)
{
    put(c, bit, probability(m));
    update(m, bit);
}

static inline void put_raw(coder *c, uint64_t value, int bits)
{
    while (bits-- > 0) put(c, (int)(value >> bits & 1), 32768);
}

/* The last bytes, highest first, and how many (RNG-001). */
static int end_of(uint32_t x1, uint32_t x2, uint8_t *last)
{
    for (int k = 0; k < 5; k++) {
        uint64_t unit = (uint64_t)1 << (32 - 8 * k);
        uint64_t value = (x1 + unit - 1) / unit * unit;
        if (value <= x2) {
            for (int i = 0; i < k; i++) last[i] = (uint8_t)(value >> (24 - 8 * i));
            return k;
        }
    }
    return 0;
}

static inline int bit_length(uint64_t v)
{
#if defined(__GNUC__)
    return v ? 64 - __builtin_clzll(v) : 0;
#else
    int bits = 0;
    while (v) { v >>= 1; bits++; }
    return bits;
#endif
}

static inline int scale(const integer_model *m, int *context)
{
    uint64_t mean = (uint64_t)(m->f + m->s) >> 1;
    int lg = bit_length(mean) - 1, h, c;
    if (lg < 0) lg = 0;
    int fr = (int)((lg >= 2 ? mean >> (lg - 2) : mean << (2 - lg)) & 3);
    h = lg > 10 ? lg - 10 : 0;
    c = h ? 36 + fr : 4 * lg + fr - 8;
    *context = c < 0 ? 0 : !h && c > 35 ? 35 : c;
    return h;
}

static inline void learn(integer_model *m, int64_t e)
{
    int64_t u = (e < 0 ? -e : e) << 8;
    int a = m->t >= 63 ? 7 : bit_length((uint64_t)m->t + 1);
    m->g = (e > 0) - (e < 0);
    m->f += (u - m->f) >> 3;
    m->s += (u - m->s) >> (a < 7 ? a : 7);
    m->t++;
}

static inline int put_integer(coder *c, integer_model *m, int64_t e)
{
    int context, h = scale(m, &context), k, bits = 0;
    uint64_t u = (uint64_t)(e < 0 ? -e : e), w = u >> h, v = 0;
    if (u >> ERROR_BITS) return BAD_ERROR;
    if (w < 12) k = (int)w;
    else {
        v = w - 8;
        int l = bit_length(v) - 1;
        k = 2 * l + 8 + (int)(v >> (l - 1) & 1);
        bits = l - 1;
    }
    bit_model *models = m->buckets[context];
    for (int i = 0; i < k; i++) put_bit(c, 1, &models[i]);
    put_bit(c, 0, &models[k]);
    put_raw(c, v, bits);
    if (h) {
        put_bit(c, (int)(u >> (h - 1) & 1), &m->halves[context][k]);
        put_raw(c, u, h - 1);
    }
    if (u) put_bit(c, e < 0, &m->signs[m->g + 1]);
    learn(m, e);
    return DONE;
}

static inline int get_integer(coder *c, integer_model *m, int64_t *e)
{
    int context, h = scale(m, &context), k = 0;
    bit_model *models = m->buckets[context];
    while (get_bit(c, &models[k]))
        if (++k == BUCKETS) return BAD_BUCKET;
    uint64_t w = (uint64_t)k;
    if (k >= 12) {
        int l = (k - 8) >> 1;
        w = ((uint64_t)(2 + (k & 1)) << (l - 1) | get_raw(c, l - 1)) + 8;
    }
    /* h <= 31. Not after the shift: w has up to 36 bits, and a sum of 67 would wrap to a small u. */
    if (w >> (ERROR_BITS - h)) return BAD_ERROR;
    uint64_t u = w << h;
    if (h) {
        u |= (uint64_t)get_bit(c, &m->halves[context][k]) << (h - 1);
        u |= get_raw(c, h - 1);
    }
    *e = u && get_bit(c, &m->signs[m->g + 1]) ? -(int64_t)u : (int64_t)u;
    learn(m, *e);
    return DONE;
}

typedef struct {
    int difference, order, repeats;
    int64_t base, limit, span;
    const int32_t *coefficients;
} plan;

static inline int64_t predict(const plan *p, const int64_t *newest)
{
    int64_t sum = (int64_t)1 << (SHIFT - 1);
    for (int j = 0; j < p->order; j++) sum += p->coefficients[j] * newest[-j];
    return sum >> SHIFT;
}

enum { RING = 4096 };

static int decode(coder *c, integer_model *m, const plan *p, int64_t *out)
{
    int64_t sums[DIFFERENCES + 1] = {0}, history[ORDERS + RING] = {0};
    int64_t *now = history + ORDERS - 1;
    int recent = 0, g = p->difference;
    for (int64_t t = 0; t < p->span; t++) {
        int64_t fresh[DIFFERENCES + 1] = {0};
        int same = 0;
        if (p->repeats && t) {
            same = get_bit(c, &m->repeats[recent]);
            recent = 2 * same + (recent >> 1);
        }
        if (same) {
            fresh[0] = sums[0];
            for (int i = 1; i <= g; i++) fresh[i] = fresh[i - 1] - sums[i - 1];
        } else {
            int64_t e;
            int status = get_integer(c, m, &e);
            if (status) return status;
            fresh[g] = predict(p, now) + e;
            for (int i = g - 1; i >= 0; i--) fresh[i] = fresh[i + 1] + sums[i];
        }
        memcpy(sums, fresh, sizeof sums);
        int64_t index = sums[0] + p->base;
        if (index > p->limit || index < -p->limit) return BAD_INDEX;
        out[t] = index;
        if (p->order) {
            if (++now == history + ORDERS + RING) {
                memcpy(history, now - ORDERS, ORDERS * sizeof *history);
                now = history + ORDERS;
            }
            *now = sums[g];
        }
    }
    uint8_t last[4];
    int k = end_of(c->x1, c->x2, last);
    if (c->size != c->shifts + k || memcmp(c->in + c->shifts, last, (size_t)k)) return BAD_END;
    return DONE;
}

static int encode(coder *c, integer_model *m, const plan *p, const int64_t *indices)
{
    for (int64_t t = 0; t < p->span; t++)
        if (indices[t] > p->limit || indices[t] < -p->limit) return BAD_INDEX;
    int64_t sums[DIFFERENCES + 1] = {0}, history[ORDERS + RING] = {0};
    int64_t *now = history + ORDERS - 1;
    int recent = 0, g = p->difference;
    for (int64_t t = 0; t < p->span; t++) {
        int64_t fresh[DIFFERENCES + 1] = {0};
        int same = t && indices[t] == indices[t - 1];
        fresh[0] = indices[t] - p->base;
        for (int i = 1; i <= g; i++) fresh[i] = fresh[i - 1] - sums[i - 1];
        memcpy(sums, fresh, sizeof sums);
        if (p->repeats && t) {
            put_bit(c, same, &m->repeats[recent]);
            recent = 2 * same + (recent >> 1);
        }
        if (!(p->repeats && same)) {
            int status = put_integer(c, m, sums[g] - predict(p, now));
            if (status) return status;
        }
        if (p->order) {
            if (++now == history + ORDERS + RING) {
                memcpy(history, now - ORDERS, ORDERS * sizeof *history);
                now = history + ORDERS;
            }
            *now = sums[g];
        }
    }
    uint8_t last[4];
    int k = end_of(c->x1, c->x2, last);
    for (int i = 0; i < k; i++, c->shifts++)
        if (c->shifts < c->size) c->out[c->shifts] = last[i];
    return c->shifts > c->size ? NO_ROOM : DONE;
}

static int valid(const plan *p, const Py_buffer *coefficients, const Py_buffer *indices)
{
    int fits = coefficients->len % 4 == 0 && (uintptr_t)coefficients->buf % 4 == 0 &&
               indices->len % 8 == 0 && (uintptr_t)indices->buf % 8 == 0 &&
               coefficients->len <= 4 * ORDERS && p->difference >= 0 &&
               p->difference <= (p->order ? 1 : DIFFERENCES) && p->limit >= 0 &&
               p->limit <= INDEX_LIMIT && p->base <= p->limit && p->base >= -p->limit;
    for (int j = 0; fits && j < p->order; j++)
        fits = p->coefficients[j] <= COEFFICIENT_LIMIT && p->coefficients[j] >= -COEFFICIENT_LIMIT;
    return fits;
}

/* (bytes or writable buffer, coefficients int32, difference, repeats, base, limit, indices int64)
   -> (status, bytes read or written) */
static PyObject *run(PyObject *args, int decoding)
{
    Py_buffer data, coefficients, indices;
    int difference, repeats, status = NO_ROOM;
    long long base, limit;
    const char *format = decoding ? "y*y*ipLLw*" : "w*y*ipLLy*";
    if (!PyArg_ParseTuple(args, format, &data, &coefficients, &difference, &repeats, &base, &limit,
                          &indices))
        return NULL;
    PyObject *result = NULL;
    integer_model *m = PyMem_Malloc(sizeof *m);
    coder c = {0, 0xFFFFFFFFu, 0, data.buf, data.buf, data.len, 0};
    plan p = {difference, (int)(coefficients.len / 4), repeats, base, limit, indices.len / 8,
              coefficients.buf};
    if (!m)
        PyErr_NoMemory();
    else if (!valid(&p, &coefficients, &indices))
        PyErr_SetString(PyExc_ValueError, "not a predictor, or not arrays of its integers");
    else {
        Py_BEGIN_ALLOW_THREADS
        model_init(m);
        if (decoding) {
            for (int i = 0; i < 4; i++) c.x = c.x << 8 | (i < c.size ? c.in[i] : 0);
            status = decode(&c, m, &p, indices.buf);
        } else
            status = encode(&c, m, &p, indices.buf);
        Py_END_ALLOW_THREADS
        result = Py_BuildValue("iL", status, (long long)c.shifts);
    }
    PyMem_Free(m);
    PyBuffer_Release(&data);
    PyBuffer_Release(&coefficients);
    PyBuffer_Release(&indices);
    return result;
}

static PyObject *lpcr_decode(PyObject *self, PyObject *args) { (void)self; return run(args, 1); }
static PyObject *lpcr_encode(PyObject *self, PyObject *args) { (void)self; return run(args, 0); }

#include "exact.h"

static PyMethodDef methods[] = {
    EXACT_METHODS
    {"lpcr_decode", lpcr_decode, METH_VARARGS, NULL},
    {"lpcr_encode", lpcr_encode, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_kernels", NULL, 0, methods,
                                    NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernels(void)
{
    for (int n = 0; n <= COUNT_LIMIT; n++) rates[n] = (uint16_t)(131072 / (2 * n + 3));
    return PyModule_Create(&module);
}
