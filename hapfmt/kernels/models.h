/* The bit model and the symbol model of SPEC 9.4, what they start with, and how they learn. The readable
   twin is hapfmt/codecs/adaptive.py. */
#ifndef HAPFMT_MODELS_H
#define HAPFMT_MODELS_H

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

#endif
