/* QUAN in C: levels to canonical Huffman code words with zero runs and escapes, and back. The
   readable twin is hapfmt/codecs/quantised.py.

   The input of the decoder is hostile. Its codebook is checked here again. A packet that breaks a rule
   is left to the twin, which reports the rule. Widths: extra bits, at most 33, follow a code
   word of at most 15, so one load of 57 bits holds any symbol; a magnitude stays below 2^34, times a
   step of 2^31 below 2^63 only where it keeps ``bound``, which is checked first. */
#include "kernels.h"

enum { LENGTHS = 15, SYMBOLS = 4096, RUNS = 24, ESCAPES = 32, FIRST = 11 };
enum { ENTRIES = 1 << FIRST };
static const int64_t BOUND = (int64_t)1 << 33;

typedef struct {
    /* Symbol << 8 | bits of its code word; 0: it is longer. */
    uint32_t table[ENTRIES];
    /* For each length: the first code word, aligned to 15 bits, the end, and its place in order. */
    uint32_t first[LENGTHS + 1], end[LENGTHS + 1], place[LENGTHS + 1];
    uint32_t codes[SYMBOLS];
    uint16_t order[SYMBOLS];
    const uint8_t *lengths;
    int symbols, direct, runs, escapes, used, only;
} book;

/* 0 where the code words are not complete. */
static int prepare(book *b)
{
    uint32_t count[LENGTHS + 1] = {0}, at = 0, place = 0;
    b->used = 0;
    for (int s = 0; s < b->symbols; s++) {
        if (b->lengths[s] > LENGTHS) return 0;
        if (b->lengths[s]) {
            count[b->lengths[s]]++;
            b->only = s;
            b->used++;
        }
    }
    if (b->used == 1) {
        b->codes[b->only] = 0;
        return b->lengths[b->only] == 1;
    }
    b->only = -1;
    for (int length = 1; length <= LENGTHS; length++) {
        b->first[length] = at;
        b->place[length] = place;
        at += count[length] << (LENGTHS - length);
        b->end[length] = at;
        place += count[length];
    }
    if (at != 1u << LENGTHS) return 0;
    uint32_t next[LENGTHS + 1];
    memcpy(next, b->place, sizeof next);
    memset(b->table, 0, sizeof b->table);
    for (int s = 0; s < b->symbols; s++) {
        int length = b->lengths[s];
        if (!length) continue;
        uint32_t nth = next[length]++;
        b->order[nth] = (uint16_t)s;
        uint32_t start = b->first[length] + ((nth - b->place[length]) << (LENGTHS - length));
        b->codes[s] = start >> (LENGTHS - length);
        if (length <= FIRST)
            for (uint32_t i = 0; i < 1u << (FIRST - length); i++)
                b->table[(start >> (LENGTHS - FIRST)) + i] = (uint32_t)s << 8 | (uint32_t)length;
    }
    return 1;
}

/* 64 bits from ``at`` on, of which 57 are wanted; beyond the end they are 0. */
static inline uint64_t load(const uint8_t *data, int64_t size, int64_t at)
{
    const uint8_t *from = data + (at >> 3);
    uint64_t bits = 0;
    if ((at >> 3) + 8 <= size)
        bits = (uint64_t)from[0] << 56 | (uint64_t)from[1] << 48 | (uint64_t)from[2] << 40 |
               (uint64_t)from[3] << 32 | (uint64_t)from[4] << 24 | (uint64_t)from[5] << 16 |
               (uint64_t)from[6] << 8 | (uint64_t)from[7];
    else
        for (int i = 0; i < 8; i++) bits = bits << 8 | ((at >> 3) + i < size ? from[i] : 0);
    return bits << (at & 7);
}

static inline uint32_t find(const book *b, uint64_t bits)
{
    uint32_t entry = b->table[bits >> (64 - FIRST)];
    if (entry) return entry;
    uint32_t word = (uint32_t)(bits >> (64 - LENGTHS));
    int length = FIRST + 1;
    while (word >= b->end[length]) length++;
    uint32_t nth = b->place[length] + ((word - b->first[length]) >> (LENGTHS - length));
    return (uint32_t)b->order[nth] << 8 | (uint32_t)length;
}

typedef struct {
    const uint8_t *data;
    int64_t size, step, bound, low, high, total;
} packet;

/* 1, or 0 where a rule is broken. */
static int decode(const book *b, const packet *p, int32_t *out)
{
    int64_t at = 0, done = 0, stop = 8 * p->size;
    int first_run = 2 * b->direct + 1, first_escape = first_run + b->runs;
    int32_t zero = (int32_t)(p->low > 0 ? p->low : p->high < 0 ? p->high : 0);
    while (done < p->total) {
        uint64_t bits = load(p->data, p->size, at);
        uint32_t entry = b->only < 0 ? find(b, bits) : (uint32_t)b->only << 8;
        int symbol = (int)(entry >> 8), length = (int)(entry & 255);
        int64_t level, run = 1;
        bits <<= length;
        at += length;
        if (symbol < first_run)
            level = symbol & 1 ? (symbol + 1) >> 1 : -(symbol >> 1);
        else if (symbol < first_escape) {
            int extra = symbol - first_run + 1;
            run = ((int64_t)1 << extra) + (int64_t)(bits >> (64 - extra));
            at += extra;
            level = 0;
        } else {
            int extra = symbol - first_escape + 1;
            int64_t rest = (int64_t)(bits >> (64 - extra));
            level = b->direct + ((int64_t)1 << (extra - 1)) + (rest >> 1);
            if (rest & 1) level = -level;
            at += extra;
        }
        if (at > stop || run > p->total - done) return 0;
        if (level == 0) {
            for (int64_t end = done + run; done < end; done++) out[done] = zero;
            continue;
        }
        if (level > p->bound || level < -p->bound) return 0;
        int64_t count = level * p->step;
        out[done++] = (int32_t)(count < p->low ? p->low : count > p->high ? p->high : count);
    }
    if (p->size != (at + 7) / 8) return 0;
    return !(at & 7) || !(p->data[p->size - 1] & (0xFF >> (at & 7)));
}

typedef struct {
    uint8_t *out;
    int64_t size, written;
    uint64_t bits;
    int held;
} sink;

/* At most 48 bits, and fewer than 8 are held. */
static inline void put(sink *s, uint64_t value, int width)
{
    s->bits = s->bits << width | value;
    s->held += width;
    while (s->held >= 8) {
        s->held -= 8;
        if (s->written < s->size) s->out[s->written] = (uint8_t)(s->bits >> s->held);
        s->written++;
    }
}

static inline int bit_length(uint64_t v)
{
    int bits = 0;
    for (; v >= 256; v >>= 8) bits += 8;
    for (; v; v >>= 1) bits++;
    return bits;
}

static inline int put_symbol(sink *s, const book *b, int64_t symbol, uint64_t extra, int width)
{
    if (symbol >= b->symbols || !b->lengths[symbol]) return 0;
    int length = b->only < 0 ? b->lengths[symbol] : 0;
    put(s, (uint64_t)b->codes[symbol] << width | extra, length + width);
    return 1;
}

/* 1, or 0 where a level has no code word. */
static int encode(const book *b, const int64_t *levels, int64_t total, sink *s)
{
    int64_t longest = ((int64_t)2 << b->runs) - 1, first_run = 2 * (int64_t)b->direct + 1;
    for (int64_t t = 0; t < total;) {
        int64_t level = levels[t];
        if (level == 0) {
            int64_t run = 1;
            while (run < longest && t + run < total && levels[t + run] == 0) run++;
            int width = bit_length((uint64_t)run) - 1;
            if (!put_symbol(s, b, width ? first_run + width - 1 : 0,
                            (uint64_t)(run - ((int64_t)1 << width)), width))
                return 0;
            t += run;
            continue;
        }
        t++;
        if (level > BOUND || level < -BOUND) return 0;
        int64_t magnitude = level < 0 ? -level : level;
        int64_t beyond = magnitude - b->direct;
        if (beyond <= 0) {
            if (!put_symbol(s, b, 2 * magnitude - (level > 0), 0, 0)) return 0;
            continue;
        }
        int width = bit_length((uint64_t)beyond);
        uint64_t rest = (uint64_t)(beyond - ((int64_t)1 << (width - 1)));
        if (!put_symbol(s, b, first_run + b->runs + width - 1, rest << 1 | (level < 0), width))
            return 0;
    }
    if (s->held) put(s, 0, 8 - s->held);
    return 1;
}

static int valid(const book *b, const Py_buffer *lengths)
{
    return b->direct >= 0 && b->direct <= SYMBOLS && b->runs >= 0 && b->runs <= RUNS &&
           b->escapes >= 0 && b->escapes <= ESCAPES &&
           b->symbols == 2 * b->direct + 1 + b->runs + b->escapes && b->symbols <= SYMBOLS &&
           lengths->len == b->symbols;
}

/* (packet, lengths uint8 [symbols], direct levels, run classes, escape classes, step, largest level,
   least and largest count, int32 [levels], filled) -> whether it was decoded */
static PyObject *quan_decode(PyObject *self, PyObject *args)
{
    Py_buffer data, lengths, out;
    long long step, bound, low, high;
    int decoded = 0;
    (void)self;
    book *b = PyMem_Malloc(sizeof *b);
    if (!b) return PyErr_NoMemory();
    if (!PyArg_ParseTuple(args, "y*y*iiiLLLLw*", &data, &lengths, &b->direct, &b->runs, &b->escapes,
                          &step, &bound, &low, &high, &out)) {
        PyMem_Free(b);
        return NULL;
    }
    b->lengths = lengths.buf;
    b->symbols = lengths.len <= SYMBOLS ? (int)lengths.len : -1;
    int fits = valid(b, &lengths) && step > 0 && step <= BOUND && bound >= 0 &&
               bound <= BOUND / step && low <= high && low >= INT32_MIN && high <= INT32_MAX &&
               out.len % 4 == 0 && (uintptr_t)out.buf % 4 == 0 && prepare(b);
    if (fits) {
        packet p = {data.buf, data.len, step, bound, low, high, out.len / 4};
        Py_BEGIN_ALLOW_THREADS
        decoded = decode(b, &p, out.buf);
        Py_END_ALLOW_THREADS
    } else
        PyErr_SetString(PyExc_ValueError, "not a codebook, or not the limits of a packet of levels");
    PyMem_Free(b);
    PyBuffer_Release(&data);
    PyBuffer_Release(&lengths);
    PyBuffer_Release(&out);
    return fits ? PyBool_FromLong(decoded) : NULL;
}

/* (levels int64, lengths uint8 [symbols], direct levels, run classes, escape classes, buffer, filled)
   -> bytes it takes, maybe more than there is room for; -1 where a level has no code word */
static PyObject *quan_encode(PyObject *self, PyObject *args)
{
    Py_buffer levels, lengths, out;
    int64_t written = -1;
    (void)self;
    book *b = PyMem_Malloc(sizeof *b);
    if (!b) return PyErr_NoMemory();
    if (!PyArg_ParseTuple(args, "y*y*iiiw*", &levels, &lengths, &b->direct, &b->runs, &b->escapes,
                          &out)) {
        PyMem_Free(b);
        return NULL;
    }
    b->lengths = lengths.buf;
    b->symbols = lengths.len <= SYMBOLS ? (int)lengths.len : -1;
    int fits = valid(b, &lengths) && levels.len % 8 == 0 && (uintptr_t)levels.buf % 8 == 0 &&
               prepare(b);
    if (fits) {
        sink s = {out.buf, out.len, 0, 0, 0};
        Py_BEGIN_ALLOW_THREADS
        if (encode(b, levels.buf, levels.len / 8, &s)) written = s.written;
        Py_END_ALLOW_THREADS
    } else
        PyErr_SetString(PyExc_ValueError, "not a codebook, or not levels of 64 bits");
    PyMem_Free(b);
    PyBuffer_Release(&levels);
    PyBuffer_Release(&lengths);
    PyBuffer_Release(&out);
    return fits ? PyLong_FromLongLong(written) : NULL;
}

PyMethodDef hapfmt_huffman_methods[] = {
    {"quan_decode", quan_decode, METH_VARARGS, NULL},
    {"quan_encode", quan_encode, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
