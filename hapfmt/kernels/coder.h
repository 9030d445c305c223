/* The range coder and the integer model of SPEC 9.4. The readable twin is hapfmt/codecs/adaptive.py;
   property tests hold both equal, bit for bit. Nothing is allocated here.

   The input is hostile: whatever the bytes say, every read is inside its buffer, a magnitude is
   checked against 2^34 before it is used, and averages of 256 * |e| stay below 2^42. */
#ifndef HAPFMT_CODER_H
#define HAPFMT_CODER_H

#include <stdint.h>
#include <string.h>

/* HAPFMT_PLAIN: the loops that every processor has. */
#if defined(__SSE2__) && !defined(HAPFMT_PLAIN)
#include <emmintrin.h>
#define VECTORS 1
#endif

#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#define RARE(x) __builtin_expect(!!(x), 0)
#else
#define INLINE static inline
#define RARE(x) (x)
#endif

enum { LEAST = 64, MOST = 65472, COUNT_LIMIT = 250, FAST_FROM = 8 };
enum { SYMBOLS = 16, ESCAPE = 15, CONTEXTS = 36, SCALED = 10, HALF = 1 << 15 };
enum { CONFIDENCE = 10, ESCAPE_CONFIDENCE = 2, ERROR_BITS = 34 };
enum { DONE = 0, BAD_ERROR = 2, BAD_INDEX = 3, BAD_END = 4, NO_ROOM = 5 };

typedef struct { uint16_t p, q; uint8_t n; } bit_model;
typedef struct { uint16_t z[SYMBOLS], n, unused[15]; } symbol_model;

/* What the integers before leave behind; the models beside it are shared by nobody else. */
typedef struct { int64_t f, s, t; int g; } scale_state;
#define FRESH_SCALES {32, 32, 0, 0}

typedef struct {
    symbol_model tables[CONTEXTS], lengths;
    bit_model signs[4], repeats[4];
} models;

static uint16_t rates[COUNT_LIMIT + 1];
static uint16_t first_tables[CONTEXTS][SYMBOLS];
static uint8_t buckets[44];
static const uint8_t edges[SYMBOLS] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 16, 20, 28, 44};
static const uint8_t extra[SYMBOLS] = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 2, 3, 4, 0};

static void build_tables(void)
{
    for (int n = 0; n <= COUNT_LIMIT; n++) rates[n] = (uint16_t)(131072 / (2 * n + 3));
    for (int k = 0; k < ESCAPE; k++)
        for (int w = edges[k]; w < edges[k + 1]; w++) buckets[w] = (uint8_t)k;
    for (int c = 0; c < CONTEXTS; c++) {
        int lg = (c + 8) / 4, fr = (c + 8) % 4;
        uint32_t s = ((9u + 2u * (uint32_t)fr) << lg >> 3) + 5, t = (65536u * s) / (s + 256u);
        uint64_t tail = 65536;
        for (int w = 1, k = 1; k < SYMBOLS; w++) {
            tail = tail * t >> 16;
            if (w == edges[k]) first_tables[c][k++ - 1] = (uint16_t)tail;
        }
        first_tables[c][ESCAPE] = 0;
    }
}

static inline void models_init(models *m)
{
    bit_model fresh = {32768, 32768, 0};
    memset(m, 0, sizeof *m);
    for (int c = 0; c < CONTEXTS; c++) {
        memcpy(m->tables[c].z, first_tables[c], sizeof first_tables[c]);
        m->tables[c].n = CONFIDENCE;
    }
    for (int i = 0; i < ESCAPE; i++) m->lengths.z[i] = (uint16_t)(4096 * (15 - i));
    m->lengths.n = ESCAPE_CONFIDENCE;
    for (int i = 0; i < 4; i++) m->signs[i] = m->repeats[i] = fresh;
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

INLINE uint64_t load_big(const uint8_t *p)
{
    uint64_t w = 0;
    for (int i = 0; i < 8; i++) w = w << 8 | p[i];
    return w;
}

/* ---- models ---- */

INLINE uint32_t probability(const bit_model *m)
{
    uint32_t mixed = m->n < FAST_FROM ? m->p : (3u * m->p + m->q) / 4;
    return mixed < LEAST ? LEAST : mixed > MOST ? MOST : mixed;
}

INLINE void update(bit_model *m, int bit)
{
    int32_t t = bit ? 65535 : 0;
    m->p = (uint16_t)(m->p + (((int64_t)(t - m->p) * rates[m->n]) >> 16));
    m->q = (uint16_t)(m->q + ((t - m->q) >> 4));
    m->n = (uint8_t)(m->n + (m->n < COUNT_LIMIT));
}

INLINE uint32_t bound(const symbol_model *m, uint32_t width, int i)
{
    return ((width - 16) * m->z[i] >> 16) + 15u - (uint32_t)i;
}

#ifdef VECTORS
static const uint16_t gaps[SYMBOLS] = {15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0};
static const uint16_t numbers[SYMBOLS] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};

INLINE __m128i eight(const uint16_t *p) { return _mm_loadu_si128((const __m128i *)p); }

/* Where ``up`` is all ones z nears 65535, elsewhere 0. */
INLINE void near(uint16_t *z, __m128i up, __m128i rate)
{
    __m128i d = _mm_xor_si128(eight(z), up);
    d = _mm_sub_epi16(d, _mm_mulhi_epu16(d, rate));
    _mm_storeu_si128((__m128i *)z, _mm_xor_si128(d, up));
}

INLINE void learn_symbol(symbol_model *m, int symbol)
{
    __m128i s = _mm_set1_epi16((short)symbol), rate = _mm_set1_epi16((short)rates[m->n]);
    near(m->z, _mm_cmplt_epi16(eight(numbers), s), rate);
    near(m->z + 8, _mm_cmplt_epi16(eight(numbers + 8), s), rate);
    m->n = (uint16_t)(m->n + (m->n < COUNT_LIMIT));
}

/* The symbol at x, its bounds; and the model learns it. */
INLINE int find_symbol(symbol_model *m, uint32_t width, uint32_t x, uint32_t *lower, uint32_t *upper)
{
    uint16_t bounds[SYMBOLS + 1];
    __m128i room = _mm_set1_epi16((short)(width - 16)), at = _mm_set1_epi16((short)x);
    __m128i zero = _mm_setzero_si128(), ones = _mm_set1_epi16(-1);
    __m128i a = _mm_add_epi16(_mm_mulhi_epu16(eight(m->z), room), eight(gaps));
    __m128i b = _mm_add_epi16(_mm_mulhi_epu16(eight(m->z + 8), room), eight(gaps + 8));
    _mm_storeu_si128((__m128i *)(bounds + 1), a);
    _mm_storeu_si128((__m128i *)(bounds + 9), b);
    bounds[0] = (uint16_t)width;
    /* All ones where x is not below the bound. */
    a = _mm_cmpeq_epi16(_mm_subs_epu16(a, at), zero);
    b = _mm_cmpeq_epi16(_mm_subs_epu16(b, at), zero);
    int symbol = __builtin_ctz((unsigned)_mm_movemask_epi8(_mm_packs_epi16(a, b)) | 1u << ESCAPE);
    *upper = bounds[symbol];
    *lower = bounds[symbol + 1];
    __m128i rate = _mm_set1_epi16((short)rates[m->n]);
    near(m->z, _mm_xor_si128(a, ones), rate);
    near(m->z + 8, _mm_xor_si128(b, ones), rate);
    m->n = (uint16_t)(m->n + (m->n < COUNT_LIMIT));
    return symbol;
}
#else
INLINE void learn_symbol(symbol_model *m, int symbol)
{
    uint32_t rate = rates[m->n];
    for (int i = 0; i < ESCAPE; i++) {
        uint32_t z = m->z[i];
        m->z[i] = (uint16_t)(i < symbol ? z + ((65535 - z) * rate >> 16) : z - (z * rate >> 16));
    }
    m->n = (uint16_t)(m->n + (m->n < COUNT_LIMIT));
}

INLINE int find_symbol(symbol_model *m, uint32_t width, uint32_t x, uint32_t *lower, uint32_t *upper)
{
    int symbol = 0;
    *upper = width;
    *lower = 0;
    for (; symbol < ESCAPE; symbol++) {
        uint32_t at = bound(m, width, symbol);
        if (x >= at) { *lower = at; break; }
        *upper = at;
    }
    learn_symbol(m, symbol);
    return symbol;
}
#endif

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

/* ---- integers ---- */

INLINE int scale(const scale_state *s, int *context)
{
    uint64_t mean = (uint64_t)(s->f + s->s) >> 1;
    int lg = bit_length(mean | 1) - 1, fr = (int)((mean << 2 >> lg) & 3), low = lg < SCALED ? lg : SCALED;
    int c = 4 * low + fr - 8;
    *context = c < 0 ? 0 : c;
    return lg - low;
}

INLINE void learn(scale_state *s, uint64_t magnitude, int negative)
{
    int64_t u = (int64_t)(magnitude << 8);
    int a = s->t >= 63 ? 7 : bit_length((uint64_t)s->t + 1);
    s->g = (magnitude != 0) - 2 * negative;
    s->f += (u - s->f) >> 3;
    s->s += (u - s->s) >> a;
    s->t++;
}

INLINE int put_integer(encoder *e, models *m, scale_state *s, int64_t value, int raw_signs)
{
    int context, h = scale(s, &context), negative = value < 0;
    uint64_t u = (uint64_t)(negative ? -value : value), w = u >> h;
    if (u >> ERROR_BITS) return BAD_ERROR;
    int k = w < edges[ESCAPE] ? buckets[w] : ESCAPE;
    put_symbol(e, k, &m->tables[context]);
    if (RARE(k == ESCAPE)) {
        uint64_t y = w - edges[ESCAPE] + 1;
        int length = bit_length(y) - 1;
        put_symbol(e, length < 15 ? length : 15, &m->lengths);
        if (length >= 15) put_raw(e, (uint64_t)length - 15, 5);
        put_raw(e, y, length);
        put_raw(e, u, h);
    } else
        put_raw(e, u - ((uint64_t)edges[k] << h), extra[k] + h);
    if (raw_signs) put_some(e, (uint64_t)negative, u != 0);
    else put_bit_if(e, negative, &m->signs[u ? s->g + 1 : 3], u != 0);
    learn(s, u, negative);
    return DONE;
}

INLINE int get_integer(decoder *d, models *m, scale_state *s, int64_t *value, int raw_signs)
{
    int context, h = scale(s, &context);
    int k = get_symbol(d, &m->tables[context]), negative = 0;
    uint64_t u;
    if (RARE(k == ESCAPE)) {
        int length = get_symbol(d, &m->lengths);
        if (length == 15) length += (int)get_raw(d, 5);
        uint64_t w = ((uint64_t)1 << length | get_raw(d, length)) + edges[ESCAPE] - 1;
        if (w >> (ERROR_BITS - h)) return BAD_ERROR;
        u = w << h | get_raw(d, h);
        if (raw_signs) negative = (int)get_raw(d, 1);
    } else {
        int bits = extra[k] + h;
        uint64_t word = raw_word(d);
        u = ((uint64_t)edges[k] << h) + (word & (((uint64_t)1 << bits) - 1));
        if (RARE(u >> ERROR_BITS)) return BAD_ERROR;
        if (raw_signs) {
            /* But for k = 0 the place of the next raw bits needs not wait for these. */
            int some = k > 0;
            if (RARE(!some && h)) some = u != 0;
            negative = (int)(word >> bits) & some;
            bits += some;
        }
        d->raw += bits;
    }
    /* A model of its own for no sign at all: that is quicker than a branch. */
    if (!raw_signs) negative = get_bit_if(d, &m->signs[u ? s->g + 1 : 3], u != 0);
    *value = negative ? -(int64_t)u : (int64_t)u;
    learn(s, u, negative);
    return DONE;
}

#endif
