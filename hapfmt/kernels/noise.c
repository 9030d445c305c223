/* NOIS: noise through an all-pole filter (SPEC 9.10). The readable twin is
   hapfmt/codecs/noise.py.

   Widths, whatever the bytes say: gains below 2^40, so that a gain between two of them takes 2^52, and
   times the noise 2^50. The state g stays within 32 bits, and an excitation within 2^30. So f is below
   2^30 + 32 * 2^31 < 2^37, and a product with a sine below 2^52. */
#include "kernels.h"

#include "coded.h"

#ifdef WIDE
#include <immintrin.h>
#endif

enum { ORDERS = 32, GAIN_MOST = 112, K_MOST = 127, SINES = 128, BAD_GAIN = 7, BAD_COEFFICIENT = 8 };
enum { GAIN_BITS = 20, FRACTION_BITS = 6, SINE_BITS = 15, TICKS = 1 << 12 };

typedef struct {
    int order, density, first, lanes, shift, intervals;
    int class[2], start[2];
    uint32_t seed;
    int64_t span, low, high;
    const int32_t *sines;
} model;

static int64_t gain_of(int64_t q)
{
    static const int64_t roots[4] = {4096, 4871, 5793, 6889};
    return q ? roots[(q - 1) & 3] << ((q - 1) >> 2) : 0;
}

INLINE int64_t clamped(int64_t x, int64_t low, int64_t high)
{
    x = x < low ? low : x;
    return x > high ? high : x;
}

/* The excitation of ``count`` ticks from ``tick`` on; the gain goes from one value to another in an interval. */
INLINE void excite_as(const model *p, int64_t tick, int count, int64_t from, int64_t to, int32_t *e)
{
    uint32_t first = p->seed + (uint32_t)tick * 2654435769u;
    uint32_t density = p->density ? (uint32_t)p->density : 256;
    int32_t n[TICKS];
    for (int i = 0; i < count; i++) {
        uint32_t w = first + (uint32_t)i * 2654435769u;
        w = (w ^ w >> 16) * 2246822507u;
        w = (w ^ w >> 13) * 3266489909u;
        w ^= w >> 16;
        int32_t sum = (int32_t)((w >> 8 & 255) + (w >> 16 & 255) + (w >> 24));
        n[i] = (w & 255) < density ? 2 * sum - 765 : 0;
    }
    int64_t step = to - from;
    for (int i = 0; i < count; i++) {
        int64_t gain = from + (step * i >> p->shift);
        e[i] = (int32_t)((gain * n[i] + (1 << (GAIN_BITS - 1))) >> GAIN_BITS);
    }
}

#ifdef WIDE
WIDE static void excite_wide(const model *p, int64_t tick, int count, int64_t from, int64_t to, int32_t *e)
{
    excite_as(p, tick, count, from, to, e);
}
#endif

static void excite(const model *p, int64_t tick, int count, int64_t from, int64_t to, int32_t *e)
{
#ifdef WIDE
    if (wide()) {
        excite_wide(p, tick, count, from, to, e);
        return;
    }
#endif
    excite_as(p, tick, count, from, to, e);
}

/* ``g`` [width]; coefficients beyond the order are 0, and change nothing. */
INLINE void filter_as(const int64_t *k, int64_t *g, const int32_t *e, int count, int64_t low, int64_t high,
                      int32_t *out, int width)
{
    const int64_t half = 1 << (SINE_BITS - 1), most = INT32_MAX, least = INT32_MIN;
    int64_t s[ORDERS + 1];
    for (int j = 0; j < width; j++) s[j] = g[j];
    for (int i = 0; i < count; i++) {
        int64_t f = e[i];
        uint64_t beyond = 0;
        for (int j = width - 1; j >= 0; j--) {
            int64_t old = s[j];
            f += (k[j] * old + half) >> SINE_BITS;
            s[j + 1] = old - ((k[j] * f + half) >> SINE_BITS);
            beyond |= (uint64_t)s[j + 1] + ((uint64_t)1 << 31);
        }
        s[0] = f;
        beyond |= (uint64_t)f + ((uint64_t)1 << 31);
        if (RARE(beyond >> 32))
            for (int j = 0; j <= width; j++) s[j] = clamped(s[j], least, most);
        out[i] = (int32_t)clamped((s[0] + (1 << (FRACTION_BITS - 1))) >> FRACTION_BITS, low, high);
    }
    for (int j = 0; j < width; j++) g[j] = s[j];
}

#ifdef WIDE
enum { FOUR = 4, MOST_FOURS = ORDERS / FOUR };

/* (x * y + half) >> SINE_BITS, and 2^32, of products below 2^47. */
WIDE static inline __m256i products(__m256i x, __m256i y)
{
    const __m256i bias = _mm256_set1_epi64x(((int64_t)1 << (32 + SINE_BITS)) + (1 << (SINE_BITS - 1)));
    return _mm256_srli_epi64(_mm256_add_epi64(_mm256_mul_epi32(x, y), bias), SINE_BITS);
}

/* The same four coefficients at a time. f of each is what all from it on add up to. A tick in which a
   number leaves 32 bits is left to the loop above. */
WIDE INLINE void filter_fours(const int64_t *k, int64_t *g, const int32_t *e, int count, int64_t low,
                             int64_t high, int32_t *out, int width)
{
    const int fours = width / FOUR;
    const __m256i zero = _mm256_setzero_si256(), one = _mm256_set1_epi64x((int64_t)1 << 32);
    const __m256i terms = _mm256_set_epi64x((int64_t)1 << 32, (int64_t)2 << 32, (int64_t)3 << 32, (int64_t)4 << 32);
    const __m256i least = _mm256_set1_epi64x((int64_t)1 << 31), above = _mm256_set1_epi64x(-((int64_t)1 << 32));
    __m256i K[MOST_FOURS], G[MOST_FOURS], H[MOST_FOURS];
    for (int v = 0; v < fours; v++) {
        K[v] = _mm256_loadu_si256((const __m256i *)(k + FOUR * v));
        G[v] = _mm256_loadu_si256((const __m256i *)(g + FOUR * v));
    }
    for (int i = 0; i < count; i++) {
        __m256i f = _mm256_set1_epi64x(e[i]), beyond = zero, first = zero;
        UNROLL
        for (int v = fours - 1; v >= 0; v--) {
            __m256i u = products(K[v], G[v]), s;
            s = _mm256_add_epi64(u, _mm256_blend_epi32(_mm256_permute4x64_epi64(u, 0x39), zero, 0xC0));
            s = _mm256_add_epi64(s, _mm256_permute2x128_si256(s, s, 0x81));
            s = _mm256_sub_epi64(s, terms);
            __m256i all = _mm256_permute4x64_epi64(s, 0), F = _mm256_add_epi64(s, f);
            f = _mm256_add_epi64(f, all);
            H[v] = _mm256_sub_epi64(_mm256_add_epi64(G[v], one), products(K[v], F));
            beyond = _mm256_or_si256(beyond, _mm256_add_epi64(F, least));
            beyond = _mm256_or_si256(beyond, _mm256_add_epi64(H[v], least));
        }
        first = f;
        if (RARE(!_mm256_testz_si256(beyond, above))) {
            for (int v = 0; v < fours; v++) _mm256_storeu_si256((__m256i *)(g + FOUR * v), G[v]);
            filter_as(k, g, e + i, 1, low, high, out + i, width);
            for (int v = 0; v < fours; v++) G[v] = _mm256_loadu_si256((const __m256i *)(g + FOUR * v));
            continue;
        }
        int64_t last = _mm_cvtsi128_si64(_mm256_castsi256_si128(f));
        out[i] = (int32_t)clamped((last + (1 << (FRACTION_BITS - 1))) >> FRACTION_BITS, low, high);
        UNROLL
        for (int v = 0; v < fours; v++) {
            G[v] = _mm256_alignr_epi8(H[v], _mm256_permute2x128_si256(first, H[v], 0x21), 8);
            first = H[v];
        }
    }
    for (int v = 0; v < fours; v++) _mm256_storeu_si256((__m256i *)(g + FOUR * v), G[v]);
}
WIDE static void filter_wide(const int64_t *k, int64_t *g, const int32_t *e, int count, int64_t low,
                             int64_t high, int32_t *out, int width)
{
    if (width == ORDERS) filter_fours(k, g, e, count, low, high, out, ORDERS);
    else filter_fours(k, g, e, count, low, high, out, width);
}
#endif

#define WIDTH(w) \
    case w: filter_as(k, g, e, count, p->low, p->high, out, w); break

static void filter(const model *p, const int64_t *k, int64_t *g, const int32_t *e, int count, int32_t *out)
{
#ifdef WIDE
    if (p->order > 16 && wide()) {
        filter_wide(k, g, e, count, p->low, p->high, out, (p->order + FOUR - 1) / FOUR * FOUR);
        return;
    }
#endif
    switch (p->order > 16 ? (p->order + 7) & ~7 : (p->order + 1) & ~1) {
        WIDTH(0); WIDTH(2); WIDTH(4); WIDTH(6); WIDTH(8); WIDTH(10); WIDTH(12); WIDTH(14); WIDTH(16);
        WIDTH(24); WIDTH(32);
    }
}

/* numbers: gain indices, after them the coefficients of the blocks that are not silent. */
static void synthesise(const model *p, const int64_t *numbers, int64_t count, int32_t *out)
{
    int64_t k[ORDERS] = {0}, g[ORDERS] = {0}, before = numbers[0];
    const int64_t *coefficients = numbers + count;
    int32_t e[TICKS];
    for (int64_t s = 0; s < count; s++) {
        int64_t start = s << p->shift, left = p->span - start;
        int size = left >> p->shift ? 1 << p->shift : (int)left;
        if (s % p->intervals == 0) {
            int silent = 1;
            for (int64_t i = s; silent && i < count && i < s + p->intervals; i++) silent = !numbers[i];
            for (int j = 0; !silent && j < p->order; j++) {
                int64_t index = *coefficients++;
                k[j] = index < 0 ? -(int64_t)p->sines[-index] : p->sines[index];
            }
        }
        if (!before && !numbers[s]) {
            memset(g, 0, sizeof g);
            for (int i = 0; i < size; i++) out[start + i] = (int32_t)clamped(0, p->low, p->high);
        } else {
            excite(p, start, size, gain_of(before), gain_of(numbers[s]), e);
            filter(p, k, g, e, size, out + start);
        }
        before = numbers[s];
    }
}

/* Differences to numbers, each from the one ``every`` places before; whether all lie between. */
static int add_up(int64_t *numbers, int64_t count, int every, int64_t least, int64_t most)
{
    int64_t beyond = 0;
    for (int64_t i = 0; i < count && !beyond; i++) {
        if (i >= every) numbers[i] += numbers[i - every];
        beyond = numbers[i] < least || numbers[i] > most;
    }
    return !beyond;
}

static int64_t loud_blocks(const model *p, const int64_t *gains, int64_t count)
{
    int64_t loud = 0;
    for (int64_t s = 0; s < count;) {
        int64_t stop = s + p->intervals < count ? s + p->intervals : count, any = 0;
        for (; s < stop; s++) any |= gains[s];
        loud += any != 0;
    }
    return loud;
}

/* ``in`` has a margin on both sides; numbers [count + as many coefficients as blocks may have]. */
static int decode(uint8_t *in, int64_t size, const model *p, int64_t *numbers, int64_t count, int32_t *out,
                  int64_t *taken)
{
    decoder d;
    int64_t written = 0;
    *taken = 0;
    decoder_init(&d, in, 0, size, p->lanes);
    int status = overrun(&d) ? BAD_END : DONE;
    numbers[0] = p->first;
    if (!status) status = get_integers(&d, p->class[0], p->start[0], count - 1, numbers + 1, RAW_SIGNS);
    if (!status && !add_up(numbers, count, 1, 0, GAIN_MOST)) status = BAD_GAIN;
    if (!status && p->order) {
        written = p->order * loud_blocks(p, numbers, count);
        status = get_integers(&d, p->class[1], p->start[1], written, numbers + count, RAW_SIGNS);
        if (!status && !add_up(numbers + count, written, p->order, -K_MOST, K_MOST))
            status = BAD_COEFFICIENT;
    }
    if (!status) status = check_end(&d);
    *taken = front_taken(&d);
    if (!status) synthesise(p, numbers, count, out);
    return status;
}

static int valid(const model *p)
{
    int fits = p->order >= 0 && p->order <= ORDERS && p->density >= 0 && p->density < 256 &&
               p->first >= 0 && p->first <= GAIN_MOST && (p->lanes == 1 || p->lanes == 4) &&
               p->shift >= 3 && p->shift <= 12 && p->intervals > 0 && p->intervals < 256 &&
               (int64_t)p->intervals << p->shift >= 64 && p->span > 0 && p->low <= p->high &&
               p->low >= INT32_MIN && p->high <= INT32_MAX;
    for (int i = 0; i < 2; i++)
        fits = fits && p->class[i] >= 0 && p->class[i] < CLASSES && p->start[i] >= 0 && p->start[i] <= START_MOST;
    for (int i = 0; fits && i < SINES; i++) fits = p->sines[i] >= 0 && p->sines[i] < 1 << SINE_BITS;
    return fits;
}

/* (coded bytes, order, density, seed, first gain, class and start of the gains, of the coefficients, states,
   shift, intervals, least and largest count, sines int32 [128], int32 [span]) -> (status, bytes read) */
static PyObject *noise_decode(PyObject *self, PyObject *args)
{
    (void)self;
    Py_buffer data, sines, counts;
    model p;
    unsigned int seed;
    long long low, high;
    int status = 0, memory = 0;
    int64_t taken = 0;
    if (!PyArg_ParseTuple(args, "y*iiIiiiiiiiiLLy*w*", &data, &p.order, &p.density, &seed, &p.first,
                          &p.class[0], &p.start[0], &p.class[1], &p.start[1], &p.lanes, &p.shift,
                          &p.intervals, &low, &high, &sines, &counts))
        return NULL;
    PyObject *result = NULL;
    p.seed = seed;
    p.low = low;
    p.high = high;
    p.span = counts.len / 4;
    p.sines = sines.buf;
    if (!whole(&counts, 4) || !whole(&sines, 4) || sines.len != 4 * SINES || !valid(&p))
        PyErr_SetString(PyExc_ValueError, "not a model of noise, or no room for its counts");
    else {
        Py_BEGIN_ALLOW_THREADS
        int64_t count = ((p.span - 1) >> p.shift) + 1, blocks = (count - 1) / p.intervals + 1;
        int64_t *numbers = malloc((size_t)(8 * (count + p.order * blocks)));
        uint8_t *copy = with_margins(data.buf, data.len);
        memory = numbers && copy;
        if (memory) status = decode(copy + MARGIN, data.len, &p, numbers, count, counts.buf, &taken);
        free(copy);
        free(numbers);
        Py_END_ALLOW_THREADS
        if (memory) result = Py_BuildValue("iL", status, (long long)taken);
        else PyErr_NoMemory();
    }
    PyBuffer_Release(&data);
    PyBuffer_Release(&sines);
    PyBuffer_Release(&counts);
    return result;
}

PyMethodDef hapfmt_noise_methods[] = {
    {"noise_decode", noise_decode, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};
