/* Rice codes of SPEC 9.5: packets with flag *Rice*, and which predictor such a packet gets. The readable
   twins are hapfmt/codecs/rice.py and hapfmt/encoder/quick.py.

   Bits behind the end are 0, and no byte there is read. A code of up to 23 zeros takes at most 54 bits
   of the 56 that are there after each fill; a longer one fills twice. So u < 2^35 and |e| <= 2^34: the
   sums stay where lpcr.h says. */
#ifndef HAPFMT_RICE_H
#define HAPFMT_RICE_H

#include "search.h"

enum { BLOCK = 32, ZEROS = 24, RAW_BITS = 35, WIDTHS = 31, BAD_WIDTH = 6, BAD_BITS = 7 };
static const double QUICK_NOISE = 1e-6;
enum { QUICK_ORDERS = 12, QUICK_LAGS = 14, QUICK_POLYNOMIALS = 3, WEIGHED = 256, WEIGHED_OF = 4 };

#if defined(__GNUC__) && __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__
INLINE uint64_t load_word(const uint8_t *p)
{
    uint64_t w;
    memcpy(&w, p, 8);
    return __builtin_bswap64(w);
}

INLINE void store_word(uint8_t *p, uint64_t w)
{
    w = __builtin_bswap64(w);
    memcpy(p, &w, 8);
}
#else
#define load_word load_big

INLINE void store_word(uint8_t *p, uint64_t w)
{
    for (int i = 0; i < 8; i++) p[i] = (uint8_t)(w >> (56 - 8 * i));
}
#endif

/* ---- decoding ---- */

typedef struct {
    const uint8_t *data;
    int64_t size, at;
    uint64_t window;
    int left;
} bits;

INLINE uint64_t load_some(const bits *b)
{
    uint64_t w = 0;
    for (int64_t i = b->at; i < b->size; i++) w |= (uint64_t)b->data[i] << (56 - 8 * (i - b->at));
    return w;
}

/* At least 56 bits at the top of the window. */
INLINE void fill(bits *b)
{
    b->window |= (RARE(b->at + 8 > b->size) ? load_some(b) : load_word(b->data + b->at)) >> b->left;
    b->at += (63 - b->left) >> 3;
    b->left |= 56;
}

INLINE void drop(bits *b, int n)
{
    b->window <<= n;
    b->left -= n;
}

/* Top bits of the window, 1 to 63. */
INLINE uint64_t top(uint64_t window, int n)
{
    return window >> (64 - n);
}

INLINE int leading(uint64_t v)
{
    return 64 - bit_length(v | 1);
}

INLINE int64_t get_rice(bits *b, int k)
{
    uint64_t u;
    fill(b);
    int n = leading(b->window);
    if (RARE(n >= ZEROS)) {
        drop(b, ZEROS);
        fill(b);
        u = top(b->window, RAW_BITS);
        drop(b, RAW_BITS);
    } else {
        u = (uint64_t)n << k | (b->window << (n + 1) >> 1) >> (63 - k);
        drop(b, n + 1 + k);
    }
    return (int64_t)(u >> 1) ^ -(int64_t)(u & 1);
}

/* filter_init() with as few zeros in front as make the coefficients a multiple of 4. */
static void short_filter(filter *f, const plan *p)
{
    int spare;
    filter_init(f, p);
    spare = f->width - ((p->order + 3) & ~3);
    memmove(f->taps, f->taps + spare, (size_t)(ORDERS - spare) * sizeof *f->taps);
    memmove(f->real_taps, f->real_taps + spare, (size_t)(ORDERS - spare) * sizeof *f->real_taps);
    f->width -= spare;
}

/* ``g`` and ``width``, a multiple of 4 that the coefficients are padded to, known to the compiler, or
   width -1: as the filter says. */
INLINE int unrice_as(bits *given, const plan *p, const filter *f, int g, int width, int64_t *out)
{
    bits b = *given;
    int64_t history[ORDERS + RING], sums[DIFFERENCES + 1] = {0};
    int taken = width < 0 ? f->width : width, now = ORDERS, w = 0;
    const int64_t *c = f->taps;
    const int64_t base = p->base, limit = p->limit;
    if (taken) memset(history, 0, ORDERS * sizeof *history);
    for (int64_t from = 0; from < p->span; from += BLOCK) {
        int count = p->span - from < BLOCK ? (int)(p->span - from) : BLOCK;
        if (RARE(8 * b.at - b.left > 8 * b.size)) {
            *given = b;
            return BAD_BITS;
        }
        int64_t change = get_rice(&b, 0);
        if (RARE(change < -w || change > WIDTHS - w)) {
            *given = b;
            return BAD_WIDTH;
        }
        w += (int)change;
        for (int i = 0; i < count; i++) {
            int64_t fresh = w ? get_rice(&b, w - 1) : 0;
            if (taken) {
                const int64_t *past = history + now - taken;
                int64_t sum = (int64_t)1 << (SHIFT - 1);
                for (int j = 0; j < taken - 1; j++) sum += c[j] * past[j];
                fresh += (sum + c[taken - 1] * sums[g]) >> SHIFT;
                history[now++] = fresh;
            }
            sums[g] = fresh;
            for (int d = g - 1; d >= 0; d--) {
                fresh += sums[d];
                sums[d] = fresh;
            }
            fresh += base;
            if (RARE(fresh > limit || fresh < -limit)) {
                *given = b;
                return BAD_INDEX;
            }
            out[from + i] = fresh;
        }
        if (taken && now > ORDERS + RING - BLOCK) {
            memmove(history, history + now - ORDERS, ORDERS * sizeof *history);
            now = ORDERS;
        }
    }
    *given = b;
    return DONE;
}

static int unrice(bits *b, const plan *p, int64_t *out)
{
    filter f;
    short_filter(&f, p);
    int g = p->difference, width = f.width;
    int one = g == 1;
    if (!width) {
        if (g == 1) return unrice_as(b, p, &f, 1, 0, out);
        if (g == 2) return unrice_as(b, p, &f, 2, 0, out);
        return unrice_as(b, p, &f, g, 0, out);
    }
    if (width == 4 && one) return unrice_as(b, p, &f, 1, 4, out);
    if (width == 8 && one) return unrice_as(b, p, &f, 1, 8, out);
    if (width == 12 && one) return unrice_as(b, p, &f, 1, 12, out);
    return unrice_as(b, p, &f, g, -1, out);
}

/* Bytes taken so far. */
static int64_t bytes_taken(const bits *b)
{
    return b->at - b->left / 8;
}

/* Whether the last byte holds the last bit, and 0 behind it. */
static int ends(const bits *b)
{
    int rest = b->left % 8;
    return bytes_taken(b) == b->size && !(rest && top(b->window, rest));
}

/* ---- encoding ---- */

typedef struct {
    uint8_t *data;
    int64_t size, at;
    uint64_t window;
    int used;
} bit_sink;

/* At most 56 bits; the bytes behind the room are counted, not written. */
INLINE void put(bit_sink *s, uint64_t value, int n)
{
    s->window |= value << (64 - n - s->used);
    s->used += n;
    if (!RARE(s->at + 8 > s->size))
        store_word(s->data + s->at, s->window);
    else
        for (int i = 0; i < 8 && s->at + i < s->size; i++)
            s->data[s->at + i] = (uint8_t)(s->window >> (56 - 8 * i));
    s->at += s->used >> 3;
    s->window = s->window << (s->used & 56);
    s->used &= 7;
}

INLINE void put_rice(bit_sink *s, uint64_t u, int k)
{
    uint64_t q = u >> k;
    if (RARE(q >= ZEROS)) {
        put(s, 0, ZEROS);
        put(s, u, RAW_BITS);
    } else
        put(s, (uint64_t)1 << k | (u & (((uint64_t)1 << k) - 1)), (int)q + 1 + k);
}

INLINE uint64_t zigzag(int64_t e)
{
    return (uint64_t)e << 1 ^ (uint64_t)(e >> 63);
}

/* The smaller of the two parameters about the mean; 0: all are 0. */
INLINE int width_of(const uint64_t *u, int count)
{
    uint64_t sum = 0, upper = 0, lower = 0;
    for (int i = 0; i < count; i++) sum += u[i];
    if (!sum) return 0;
    int k = bit_length(11 * sum / (16 * (uint64_t)count));
    if (k > WIDTHS - 1) k = WIDTHS - 1;
    if (!k) return 1;
    for (int i = 0; i < count; i++) {
        upper += u[i] >> k;
        lower += u[i] >> (k - 1);
    }
    return upper + (uint64_t)count < lower ? k + 1 : k;
}

static int rice(bit_sink *s, const plan *p, const int64_t *indices, int64_t *written)
{
    filter f;
    int64_t y[ORDERS + PIECE] = {0}, e[PIECE];
    uint64_t u[BLOCK];
    int last = 0;
    if (!within(indices, p->span, p->limit)) return BAD_INDEX;
    short_filter(&f, p);
    for (int64_t from = 0; from < p->span; from += PIECE) {
        int64_t count = p->span - from < PIECE ? p->span - from : PIECE;
        differences(indices, from, count, p->difference, p->base, y + ORDERS);
        errors_of(&f, y, count, e);
        memmove(y, y + count, ORDERS * sizeof *y);
        for (int64_t at = 0; at < count; at += BLOCK) {
            int some = count - at < BLOCK ? (int)(count - at) : BLOCK;
            uint64_t most = 0;
            for (int i = 0; i < some; i++) most |= u[i] = zigzag(e[at + i]);
            if (RARE(most >> RAW_BITS)) return BAD_ERROR;
            int w = width_of(u, some);
            put_rice(s, zigzag(w - last), 0);
            last = w;
            if (w)
                for (int i = 0; i < some; i++) put_rice(s, u[i], w - 1);
        }
    }
    *written = s->at + (s->used > 0);
    return *written > s->size ? NO_ROOM : DONE;
}

/* ---- the choice of a predictor ---- */

/* x[0 ... ROOM + n - 1]: first differences of a piece, after those of the ROOM indices before it. */
INLINE void quick_differences(const int64_t *indices, int64_t from, int64_t n, int64_t *y)
{
    int64_t room = from < ROOM ? from : ROOM;
    memset(y, 0, (size_t)(ROOM - room) * sizeof *y);
    for (int64_t i = -room; i < n; i++)
        y[ROOM + i] = from + i ? indices[from + i] - indices[from + i - 1] : 0;
}

/* Autocorrelation of the first differences, lags 0 to 12, of one piece in two where there are more than
   four. Each is divided by its own energy, since bits go by its logarithm; 18 bits make sums exact. */
static void quick_sums(const int64_t *indices, int64_t count, double *r)
{
    double x[ROOM + PIECE], a[QUICK_LAGS];
    int64_t y[ROOM + PIECE], stride = count > 4 * PIECE ? 2 * PIECE : PIECE;
    for (int k = 0; k < LAGS; k++) r[k] = 0;
    for (int64_t from = 0; from < count; from += stride) {
        int64_t n = count - from < PIECE ? count - from : PIECE;
        uint64_t most = 0;
        quick_differences(indices, from, n, y);
        for (int64_t i = 0; i < ROOM + n; i++) most |= zigzag(y[i]);
        int shift = bit_length(most >> 1) - SCALED_BITS;
        if (shift < 0) shift = 0;
        for (int64_t i = 0; i < ROOM + n; i++) x[i] = (double)(y[i] >> shift);
        const double *now = x + ROOM, *then = x + ROOM - (QUICK_LAGS - 1);
#ifdef VECTORS
        __m128d v[QUICK_LAGS / 2];
        for (int k = 0; k < QUICK_LAGS / 2; k++) v[k] = _mm_setzero_pd();
        for (int64_t i = 0; i < n; i++) {
            __m128d z = _mm_set1_pd(now[i]);
            for (int k = 0; k < QUICK_LAGS / 2; k++)
                v[k] = _mm_add_pd(v[k], _mm_mul_pd(z, _mm_loadu_pd(then + i + 2 * k)));
        }
        for (int k = 0; k < QUICK_LAGS / 2; k++) _mm_storeu_pd(a + 2 * k, v[k]);
#else
        for (int k = 0; k < QUICK_LAGS; k++) a[k] = 0;
        for (int64_t i = 0; i < n; i++)
            for (int k = 0; k < QUICK_LAGS; k++) a[k] += now[i] * then[i + k];
#endif
        double energy = a[QUICK_LAGS - 1] + (double)n;
        for (int k = 0; k <= QUICK_ORDERS; k++) r[k] += a[QUICK_LAGS - 1 - k] / energy;
    }
}

/* 256 times about the bits of prediction errors, of one piece in four where there are more than four;
   -1: beyond what can be coded. */
static int64_t weigh(const plan *p, const int64_t *indices)
{
    filter f;
    int64_t y[ORDERS + WEIGHED] = {0}, e[WEIGHED], sum = 0;
    int stride = p->span > WEIGHED * WEIGHED_OF ? WEIGHED_OF : 1;
    short_filter(&f, p);
    for (int64_t from = 0; from < p->span; from += stride * WEIGHED) {
        int64_t count = p->span - from < WEIGHED ? p->span - from : WEIGHED;
        differences(indices, from, count, p->difference, p->base, y + ORDERS);
        if (stride > 1 && from) differences(indices, from - ORDERS, ORDERS, p->difference, p->base, y);
        errors_of(&f, y, count, e);
        memmove(y, y + count, ORDERS * sizeof *y);
        for (int64_t at = 0; at < count; at += BLOCK) {
            int64_t end = count - at < BLOCK ? count : at + BLOCK;
            uint64_t most = 0, all = 0;
            for (int64_t i = at; i < end; i++) {
                uint64_t u = zigzag(e[i]);
                most |= u;
                all += u;
            }
            if (most >> RAW_BITS) return -1;
            sum += log_of(BLOCK + 2 * all);
        }
    }
    return sum;
}

/* The predictor of a packet whose indices lie within INDEX_LIMIT: difference; reflections [12] and their
   coefficients, *order of them. */
static int choose(const int64_t *indices, int64_t count, const int32_t *sines, const double *limits,
                  const double *costs, int8_t *reflections, int32_t *coefficients, int *order)
{
    int64_t best = -1;
    double r[LAGS], energies[ORDERS], least = 0;
    int8_t found[ORDERS];
    plan p = {0};
    int g = 0;
    p.span = count;
    p.limit = INDEX_LIMIT;
    p.base = indices[0];
    for (int d = 0; d <= QUICK_POLYNOMIALS; d++) {
        p.difference = d;
        int64_t size = weigh(&p, indices);
        if (size < 0 || (best >= 0 && size >= best)) {
            if (d > 1) break;
            continue;
        }
        best = size;
        g = d;
    }
    *order = 0;
    quick_sums(indices, count, r);
    r[0] *= 1 + QUICK_NOISE;
    int most = count - 1 < QUICK_ORDERS ? (int)(count - 1) : QUICK_ORDERS, m = 0;
    int there = levinson(r, most, limits, found, energies);
    /* The last whose energy repays its coefficients. */
    for (int n = 1; n <= there; n++)
        if (energies[n - 1] > 0 && (!m || energies[n - 1] * costs[n - 1] < least)) {
            least = energies[n - 1] * costs[n - 1];
            m = n;
        }
    if (m && step_up(found, m, sines, coefficients)) {
        p.difference = 1;
        p.order = m;
        p.coefficients = coefficients;
        int64_t size = weigh(&p, indices);
        if (size >= 0 && (best < 0 || size < best)) {
            *order = m;
            memcpy(reflections, found, (size_t)m);
            g = 1;
        }
    }
    return g;
}

#endif
