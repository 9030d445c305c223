/* DEFLATE with fixed codes. The readable twin is hapfmt/format/deflate.py: both write the same bytes. */
#include "kernels.h"
#include <stdlib.h>

enum { SHORTEST = 3, LONGEST = 258, WINDOW = 1 << 15, TRIES = 32, MARKED = 16, TABLE_BITS = 12, FIRST_LENGTH = 257 };

/* Chains of the places where three bytes begin: the last of each hash, and for each the one before. */
typedef struct { int32_t last[1 << TABLE_BITS], *before; } places;

typedef struct { uint64_t hold; int held; uint8_t *out; Py_ssize_t size; } bits;

static void put(bits *b, uint32_t value, int size)
{
    b->hold |= (uint64_t)value << b->held;
    b->held += size;
    for (; b->held >= 8; b->held -= 8, b->hold >>= 8) b->out[b->size++] = (uint8_t)b->hold;
}

static uint32_t reverse(uint32_t value, int size)
{
    uint32_t turned = 0;
    for (int i = 0; i < size; i++) turned |= (value >> i & 1) << (size - 1 - i);
    return turned;
}

static void put_symbol(bits *b, int symbol)
{
    uint32_t s = (uint32_t)symbol;
    if (s >= 280) put(b, reverse(0xC0 + s - 280, 8), 8);
    else if (s >= 256) put(b, reverse(s - 256, 7), 7);
    else if (s >= 144) put(b, reverse(0x190 + s - 144, 9), 9);
    else put(b, reverse(0x30 + s, 8), 8);
}

/* The code of a value, of which there are one bit more every ``step``, and what is above its least. */
static int code_of(uint32_t value, uint32_t least, int step, int first, uint32_t *above, int *size)
{
    int code = 0;
    for (;; code++) {
        *size = code < first ? 0 : (code - first) / step;
        if (value < least + (1u << *size)) break;
        least += 1u << *size;
    }
    *above = value - least;
    return code;
}

static void put_copy(bits *b, uint32_t length, uint32_t distance)
{
    uint32_t above = 0;
    int size = 0, code = length == LONGEST ? 28 : code_of(length, 3, 4, 4, &above, &size);
    put_symbol(b, FIRST_LENGTH + code);
    put(b, above, size);
    code = code_of(distance, 1, 2, 2, &above, &size);
    put(b, reverse((uint32_t)code, 5), 5);
    put(b, above, size);
}

static uint32_t hash_of(const uint8_t *at)
{
    return (((uint32_t)at[0] << 16 | (uint32_t)at[1] << 8 | at[2]) * 2654435761u) >> (32 - TABLE_BITS);
}

/* Length and distance of what is repeated from ``at`` on; 0: nothing. */
static int32_t longest(const uint8_t *in, int32_t count, int32_t at, const places *p, int32_t *distance)
{
    int32_t best = 0, most = count - at < LONGEST ? count - at : LONGEST;
    int tries = 0;
    if (most < SHORTEST) return 0;
    for (int32_t place = p->last[hash_of(in + at)]; place >= 0 && tries < TRIES; place = p->before[place]) {
        if (memcmp(in + place, in + at, SHORTEST)) continue;
        if (best == most || at - place > WINDOW) break;
        tries++;
        if (in[place + best] != in[at + best]) continue;
        int32_t length = SHORTEST;
        while (length < most && in[place + length] == in[at + length]) length++;
        if (length > best) {
            best = length;
            *distance = at - place;
        }
    }
    return best;
}

static Py_ssize_t deflate(const uint8_t *in, int32_t count, places *p, uint8_t *out)
{
    bits b = {3, 3, out, 0};
    memset(p->last, 0xFF, sizeof p->last);
    for (int32_t at = 0; at < count;) {
        int32_t distance = 0, length = longest(in, count, at, p, &distance), step = length ? length : 1;
        if (length) put_copy(&b, (uint32_t)length, (uint32_t)distance);
        else put_symbol(&b, in[at]);
        for (int32_t place = at; place < at + step && place < at + MARKED && place + SHORTEST <= count; place++) {
            uint32_t hash = hash_of(in + place);
            p->before[place] = p->last[hash];
            p->last[hash] = place;
        }
        at += step;
    }
    put_symbol(&b, 256);
    if (b.held) put(&b, 0, 8 - b.held);
    return b.size;
}

/* (bytes) -> one block with fixed codes */
static PyObject *deflate_(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer in;
    PyObject *result = NULL;
    if (!PyArg_ParseTuple(args, "y*", &in)) return NULL;
    if (in.len > 1 << 28) PyErr_SetString(PyExc_ValueError, "too much to be a description");
    else {
        places *p = malloc(sizeof *p);
        uint8_t *out = malloc(2 * (size_t)in.len + 16);
        int32_t *before = malloc(sizeof *before * ((size_t)in.len + 1));
        if (p && out && before) {
            p->before = before;
            result = PyBytes_FromStringAndSize((char *)out, deflate(in.buf, (int32_t)in.len, p, out));
        } else
            PyErr_NoMemory();
        free(before);
        free(out);
        free(p);
    }
    PyBuffer_Release(&in);
    return result;
}

PyMethodDef hapfmt_deflate_methods[] = {
    {"deflate", deflate_, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
