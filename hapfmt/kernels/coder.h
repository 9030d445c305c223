/* The entropy coder of SPEC 9.4: symbols of fixed frequencies from the front of the coded bytes, raw bits
   from their back. The readable twin is hapfmt/codecs/entropy.py; property tests hold both equal, bit
   for bit.

   The input is hostile. It is copied between two margins of zeros, so that a block of eight numbers may
   read past either end before its bounds are checked. */
#ifndef HAPFMT_CODER_H
#define HAPFMT_CODER_H

#include <stdint.h>
#include <string.h>

/* HAPFMT_PLAIN: the loops that every processor has. */
#if defined(__SSE2__) && !defined(HAPFMT_PLAIN)
#include <emmintrin.h>
#define VECTORS 1
#endif

/* WIDE: of functions with vectors of 256 bits, where wide() says that the processor has them. */
#if defined(__GNUC__) && defined(__x86_64__) && !defined(HAPFMT_PLAIN)
#define WIDE __attribute__((target("avx2")))
static inline int wide(void) { return __builtin_cpu_supports("avx2"); }
#endif

#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#define RARE(x) __builtin_expect(!!(x), 0)
#define UNROLL _Pragma("GCC unroll 8")
#else
#define INLINE static inline
#define RARE(x) (x)
#define UNROLL
#endif

enum { SYMBOLS = 16, ESCAPE = 15, CONTEXTS = 36, CLASSES = 16, BLOCK = 8, ERROR_BITS = 34 };
enum { SCALE_BITS = 12, SCALE = 1 << SCALE_BITS, LANES_MOST = 4, MANY = 4096, MARGIN = 128 };
enum { DONE = 0, BAD_ERROR = 2, BAD_INDEX = 3, BAD_END = 4, NO_ROOM = 5 };
static const uint32_t LEAST_STATE = 1 << 16;

/* A symbol's part of the 4096: its first, and how many. */
typedef struct { uint16_t first, width; } share;

/* By the highest bits of a slot: the symbol of the first slot that has them. */
enum { COARSE_BITS = 9, FINE_BITS = SCALE_BITS - COARSE_BITS };

typedef struct {
    share shares[CONTEXTS][SYMBOLS];
    share coarse[CONTEXTS][1 << COARSE_BITS];
    uint8_t symbols[CONTEXTS][1 << COARSE_BITS];
    uint16_t costs[CONTEXTS][SYMBOLS]; /* 256 times the bits */
} class_table;

extern class_table hapfmt_classes[CLASSES];

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

INLINE uint64_t load_big(const uint8_t *p)
{
#if defined(__GNUC__) && __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
    uint64_t w;
    memcpy(&w, p, 8);
    return __builtin_bswap64(w);
#else
    uint64_t w = 0;
    for (int i = 0; i < 8; i++) w = w << 8 | p[i];
    return w;
#endif
}

INLINE share bit_share(int bit, int p)
{
    share s = {(uint16_t)(bit ? SCALE - 16 * p : 0), (uint16_t)(bit ? 16 * p : SCALE - 16 * p)};
    return s;
}

/* ---- decoder ---- */

typedef struct {
    uint32_t x[LANES_MOST];
    int lanes;
    const uint8_t *in, *next, *end;
    int64_t raw; /* raw bits taken */
} decoder;

/* Coded bytes from in[head] on, with a margin on both sides. The head has been read: it becomes zeros,
   which raw bits find beyond the coded bytes. */
INLINE void decoder_init(decoder *d, uint8_t *in, int64_t head, int64_t size, int lanes)
{
    memset(in, 0, (size_t)head);
    in += head;
    size -= head;
    d->lanes = lanes;
    d->in = in;
    d->next = in;
    d->end = in + size;
    d->raw = 0;
    for (int i = 0; i < LANES_MOST; i++) d->x[i] = LEAST_STATE;
    for (int i = 0; i < lanes; i++, d->next += 4)
        d->x[i] = (uint32_t)(load_big(d->next) >> 32);
}

/* Bytes taken at the front. */
INLINE int64_t front_taken(const decoder *d) { return d->next - d->in; }

/* Whether more was read than there is. */
INLINE int overrun(const decoder *d)
{
    return front_taken(d) + (d->raw + 7) / 8 > d->end - d->in;
}

INLINE uint32_t advance(uint32_t x, share s, const uint8_t **next)
{
    uint32_t slot = x & (SCALE - 1);
    x = s.width * (x >> SCALE_BITS) + slot - s.first;
    uint32_t more = x << 16 | (uint32_t)(*next)[0] << 8 | (*next)[1];
    int needs = x < LEAST_STATE;
    *next += 2 * needs;
    return needs ? more : x;
}

INLINE int get_bit(decoder *d, int lane, int p)
{
    int bit = (int)(d->x[lane] & (SCALE - 1)) >= SCALE - 16 * p;
    d->x[lane] = advance(d->x[lane], bit_share(bit, p), &d->next);
    return bit;
}

/* The next raw bits, 57 and more. */
INLINE uint64_t raw_word(const uint8_t *end, int64_t raw)
{
    return load_big(end - 8 - (raw >> 3)) >> (raw & 7);
}

/* At most 57. */
INLINE uint64_t get_raw(decoder *d, int bits)
{
    uint64_t word = raw_word(d->end, d->raw);
    d->raw += bits;
    return word & (((uint64_t)1 << bits) - 1);
}

/* RNG-001 */
static inline int check_end(const decoder *d)
{
    int rest = (int)(d->raw & 7);
    uint32_t all = 0;
    for (int i = 0; i < d->lanes; i++) all |= d->x[i] ^ LEAST_STATE;
    if (all || front_taken(d) + (d->raw + 7) / 8 != d->end - d->in) return BAD_END;
    return rest && *d->next >> rest ? BAD_END : DONE;
}

/* ---- encoder: symbols are noted, and coded from the last to the first ---- */

/* Where the noted symbols have their shares: ``codes`` number them; 0xFFFF begins a section. */
typedef struct {
    uint16_t *codes;
    int64_t noted;
    uint8_t *out;
    int64_t size, back;
    uint64_t tail;
    int tail_bits;
} encoder;

/* A code with the bit FLAG has its share within: a bit, and how many of the 4096 a 1 has. */
enum { SECTION = 0xFFFF, FLAG = 0x8000 };

INLINE void encoder_init(encoder *e, uint16_t *codes, uint8_t *out, int64_t size)
{
    encoder fresh = {codes, 0, out, size, 0, 0, 0};
    *e = fresh;
}

INLINE void note(encoder *e, int code) { e->codes[e->noted++] = (uint16_t)code; }

INLINE int64_t raw_bits(const encoder *e) { return 8 * e->back + e->tail_bits; }

static inline void put_back(encoder *e)
{
    if (e->back < e->size) e->out[e->size - 1 - e->back] = (uint8_t)e->tail;
    e->back++;
    e->tail >>= 8;
    e->tail_bits -= 8;
}

/* At most 32 bits. */
INLINE void put_some(encoder *e, uint64_t value, int bits)
{
    e->tail |= (value & (((uint64_t)1 << bits) - 1)) << e->tail_bits;
    e->tail_bits += bits;
    if (e->tail_bits < 32) return;
#if defined(__GNUC__) && __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
    if (e->back + 4 <= e->size) {
        uint32_t four = __builtin_bswap32((uint32_t)e->tail);
        e->back += 4;
        memcpy(e->out + e->size - e->back, &four, 4);
        e->tail >>= 32;
        e->tail_bits -= 32;
        return;
    }
#endif
    for (int i = 0; i < 4; i++) put_back(e);
}

INLINE void put_raw(encoder *e, uint64_t value, int bits)
{
    if (RARE(bits > 32)) {
        put_some(e, value, 32);
        value >>= 32;
        bits -= 32;
    }
    put_some(e, value, bits);
}

/* 2^44 over each width, rounded up. Below 2^20 times the width that is enough for exact quotients: the
   product is too large by less than the width over 2^24 of 2^44, which is less than 2^44 over the width. */
extern uint64_t hapfmt_inverses[SCALE + 1];

INLINE uint32_t absorb(uint32_t x, share s, uint16_t **words)
{
    int full = x >= (uint64_t)s.width << (32 - SCALE_BITS);
    (*words)[-1] = (uint16_t)x;
    *words -= full;
    x >>= 16 * full;
    uint32_t q = (uint32_t)(x * hapfmt_inverses[s.width] >> 44);
    return (q << SCALE_BITS) + (x - q * s.width) + s.first;
}

INLINE share flag_share(int code)
{
    int bit = code >> SCALE_BITS & 1, width = code & (SCALE - 1);
    share s = {(uint16_t)(bit ? SCALE - width : 0), (uint16_t)(bit ? width : SCALE - width)};
    return s;
}

/* The coded bytes into ``out``: how many, or how many it takes. ``words``: as many as symbols, and eight.
   ``flags``: there are codes with FLAG. */
INLINE int64_t encoder_finish_as(encoder *e, const share *shares, int lanes, uint16_t *words, int flags)
{
    uint32_t x[LANES_MOST];
    uint16_t *end = words + e->noted + 2 * LANES_MOST, *at = end;
    int64_t last = e->noted;
    for (int i = 0; i < LANES_MOST; i++) x[i] = LEAST_STATE;
    while (last > 0) {
        int64_t first = last - 1;
        while (e->codes[first] != SECTION) first--;
        for (int64_t i = last - 1; i > first; i--) {
            int lane = (int)(i - first - 1) & (lanes - 1);
            int code = e->codes[i];
            x[lane] = absorb(x[lane], flags && code & FLAG ? flag_share(code) : shares[code], &at);
        }
        last = first;
    }
    for (int i = lanes - 1; i >= 0; i--) {
        *--at = (uint16_t)x[i];
        *--at = (uint16_t)(x[i] >> 16);
    }
    while (e->tail_bits > 0) put_back(e);
    int64_t front = 2 * (end - at);
    if (front + e->back <= e->size) {
        for (int64_t i = 0; i < front / 2; i++) {
            e->out[2 * i] = (uint8_t)(at[i] >> 8);
            e->out[2 * i + 1] = (uint8_t)at[i];
        }
        memmove(e->out + front, e->out + e->size - e->back, (size_t)e->back);
    }
    return front + e->back;
}

static inline int64_t encoder_finish(encoder *e, const share *shares, int lanes, uint16_t *words)
{
    return encoder_finish_as(e, shares, lanes, words, 0);
}

#endif
