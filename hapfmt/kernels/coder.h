/* The range coder of SPEC 9.4, raw bits from the back beside it. The readable twin is
   hapfmt/codecs/adaptive.py; property tests hold both equal, bit for bit. Nothing is allocated here.

   The input is hostile: whatever the bytes say, every read is inside its buffer. */
#ifndef HAPFMT_CODER_H
#define HAPFMT_CODER_H

#include "models.h"

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
    uint64_t w = 0;
    for (int i = 0; i < 8; i++) w = w << 8 | p[i];
    return w;
}

/* (v, r) of RNG-001. */
static uint64_t end_of(uint64_t low, uint32_t width, int *r)
{
    for (*r = 15;; (*r)--) {
        uint64_t unit = (uint64_t)1 << *r, v = (low + unit - 1) / unit * unit;
        if (*r == 14 || v + unit <= low + width) return v;
    }
}

/* ---- decoder: the number from the front, raw bits from the back ---- */

typedef struct {
    uint64_t x;     /* its 16 highest bits are x of the SPEC, bits of the number follow */
    uint32_t width;
    int ready;      /* how many of those that follow are there; -15 at the start */
    const uint8_t *in, *next, *end;
    int64_t beyond; /* bytes taken after the end */
    int64_t raw;    /* raw bits taken */
} decoder;

INLINE void refill(decoder *d)
{
    if (RARE(d->end - d->next < 8)) {
        while (d->ready <= 40) {
            if (d->next < d->end) d->x |= (uint64_t)*d->next++ << (40 - d->ready);
            else d->beyond++;
            d->ready += 8;
        }
    } else {
        /* Bits below those that count are the same when they come again. */
        int bytes = (48 - d->ready) >> 3;
        d->x |= load_big(d->next) >> (16 + d->ready);
        d->next += bytes;
        d->ready += 8 * bytes;
    }
}

INLINE void decoder_init(decoder *d, const uint8_t *in, int64_t size)
{
    decoder fresh = {0, HALF, -15, in, in, in + size, 0, 0};
    *d = fresh;
    refill(d);
}

INLINE void decoder_narrow(decoder *d, uint32_t lower, uint32_t width)
{
    int shift = 16 - bit_length(width);
    d->x = (d->x - ((uint64_t)lower << 48)) << shift;
    d->width = width << shift;
    d->ready -= shift;
    if (d->ready < 16) refill(d);
}

/* ``on`` 0: nothing is coded, 0 is returned. */
INLINE int get_bit_if(decoder *d, bit_model *m, int on)
{
    uint32_t at = d->width * probability(m) >> 16;
    uint32_t bit = (uint32_t)(d->x >> 48) < at, other = bit - 1;
    uint32_t lower = at & other, width = at + ((d->width - 2 * at) & other);
    decoder_narrow(d, on ? lower : 0, on ? width : d->width);
    update(m, (int)bit);
    return (int)bit & on;
}

INLINE int get_bit(decoder *d, bit_model *m) { return get_bit_if(d, m, 1); }

INLINE int get_symbol(decoder *d, symbol_model *m)
{
    uint32_t lower, upper;
    int symbol = find_symbol(m, d->width, (uint32_t)(d->x >> 48), &lower, &upper);
    decoder_narrow(d, lower, upper - lower);
    return symbol;
}

/* The next raw bits, 57 and more; zeros before the first byte. */
INLINE uint64_t raw_word(const decoder *d)
{
    int64_t passed = d->raw >> 3, size = d->end - d->in;
    uint64_t word = 0;
    if (RARE(size - passed < 8)) {
        for (int i = 0; i < 8 && passed + i < size; i++)
            word |= (uint64_t)d->end[-1 - passed - i] << (8 * i);
    } else
        word = load_big(d->end - 8 - passed);
    return word >> (d->raw & 7);
}

INLINE uint64_t get_raw(decoder *d, int bits)
{
    uint64_t word = raw_word(d);
    d->raw += bits;
    return word & (((uint64_t)1 << bits) - 1);
}

static int64_t bits_taken(const decoder *d)
{
    return 8 * (d->next - d->in + d->beyond) - d->ready;
}

/* RNG-001, before the end: more was read than the packet can hold. */
INLINE int overrun(const decoder *d)
{
    return bits_taken(d) - 15 + d->raw > 8 * (d->end - d->in);
}

/* RNG-001 */
static int check_end(const decoder *d)
{
    int64_t taken = bits_taken(d), size = d->end - d->in;
    uint64_t number = 0;
    for (int64_t at = taken < 16 ? 0 : taken - 16; at < taken; at++)
        number = number << 1 | (at / 8 < size ? d->in[at / 8] >> (7 - at % 8) & 1 : 0);
    uint32_t x = (uint32_t)(d->x >> 48);
    int r;
    uint64_t low = (number - x) & 0xFFFF, v = end_of(low, d->width, &r);
    int64_t front = taken - r;
    if (size != (front + d->raw + 7) / 8 || low + x < v || low + x >= v + ((uint64_t)1 << r))
        return BAD_END;
    for (int64_t at = front; at < 8 * size - d->raw; at++)
        if (d->in[at / 8] >> (7 - at % 8) & 1) return BAD_END;
    return DONE;
}

/* ---- encoder ---- */

typedef struct {
    uint64_t low, tail;
    uint32_t width;
    int bits, tail_bits;  /* of low, of tail */
    uint8_t *out;
    int64_t size, front, back;  /* bytes there are room for, and written at both ends */
} encoder;

INLINE void encoder_init(encoder *e, uint8_t *out, int64_t size)
{
    encoder fresh = {0, 0, HALF, 15, 0, out, size, 0, 0};
    *e = fresh;
}

static inline void put_bytes(encoder *e, int count)
{
    e->bits -= 8 * count;
    uint64_t top = e->low >> e->bits;
    e->low &= ((uint64_t)1 << e->bits) - 1;
    if (e->front + e->back + count <= e->size) {
        if (top >> (8 * count))
            for (int64_t at = e->front - 1; at >= 0 && ++e->out[at] == 0; at--) {}
        for (int i = 0; i < count; i++) e->out[e->front + i] = (uint8_t)(top >> (8 * (count - 1 - i)));
    }
    e->front += count;
}

INLINE void encoder_narrow(encoder *e, uint32_t lower, uint32_t width)
{
    int shift = 16 - bit_length(width);
    e->low = (e->low + lower) << shift;
    e->width = width << shift;
    e->bits += shift;
    if (e->bits >= 40) put_bytes(e, (e->bits - 16) >> 3);
}

/* ``on`` 0: nothing is coded. */
INLINE void put_bit_if(encoder *e, int bit, bit_model *m, int on)
{
    uint32_t at = e->width * probability(m) >> 16, other = (uint32_t)(bit != 0) - 1;
    uint32_t lower = at & other, width = at + ((e->width - 2 * at) & other);
    encoder_narrow(e, on ? lower : 0, on ? width : e->width);
    update(m, bit);
}

INLINE void put_bit(encoder *e, int bit, bit_model *m) { put_bit_if(e, bit, m, 1); }

INLINE void put_symbol(encoder *e, int symbol, symbol_model *m)
{
    uint32_t lower = symbol < ESCAPE ? bound(m, e->width, symbol) : 0;
    uint32_t upper = symbol ? bound(m, e->width, symbol - 1) : e->width;
    encoder_narrow(e, lower, upper - lower);
    learn_symbol(m, symbol);
}

static inline void put_back(encoder *e)
{
    if (e->front + e->back < e->size) e->out[e->size - 1 - e->back] = (uint8_t)e->tail;
    e->back++;
    e->tail >>= 8;
    e->tail_bits -= 8;
}

/* At most 32 bits. */
INLINE void put_some(encoder *e, uint64_t value, int bits)
{
    e->tail |= (value & (((uint64_t)1 << bits) - 1)) << e->tail_bits;
    e->tail_bits += bits;
    if (e->tail_bits >= 32)
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

/* Both ends are brought together; the bytes of the packet, or of what it needs. */
static int64_t encoder_finish(encoder *e)
{
    int r;
    while (e->tail_bits >= 8) put_back(e);
    uint64_t v = end_of(e->low, e->width, &r);
    int count = (e->bits - r + e->tail_bits + 7) / 8, grow = 8 * count - e->bits;
    e->low = grow >= 0 ? v << grow : v >> -grow;
    e->bits = 8 * count;
    put_bytes(e, count);
    if (e->front + e->back <= e->size) {
        if (e->tail_bits) e->out[e->front - 1] |= (uint8_t)e->tail;
        memmove(e->out + e->front, e->out + e->size - e->back, (size_t)e->back);
    }
    return e->front + e->back;
}

#endif
