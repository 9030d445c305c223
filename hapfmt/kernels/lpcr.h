/* The loops of SPEC 9.5 over the samples of a packet. The readable twin is hapfmt/codecs/predicted.py.

   What keeps every signed sum within 64 bits, whatever the bytes say: valid() admits |base| <= limit
   <= 2^32, |c| <= 2^21, at most 32 of them, g <= 1 with them, and cross terms of at most 2^54; each
   |e| < 2^34 and each |index| <= limit is checked before it is used. So |z| <= 2^33; its i-th
   differences 2^37; with coefficients |y| <= 2^34, predictions 2^5 * 2^21 * 2^34 = 2^60 before the
   shift, and y[t] 2^55 before the index is checked. Negative numbers are shifted to
   the right only, which rounds down on every compiler that builds CPython. */
#ifndef HAPFMT_LPCR_H
#define HAPFMT_LPCR_H

#include "integers.h"

enum { ORDERS = 32, DIFFERENCES = 4, SHIFT = 13, COEFFICIENT_LIMIT = 1 << 21 };
enum { RING = 1024, PIECE = 1024 };
static const int64_t INDEX_LIMIT = (int64_t)1 << 32, CROSS_LIMIT = (int64_t)1 << 54;

typedef struct {
    int difference, order, repeats;
    int64_t base, limit, span;
    const int32_t *coefficients;
    const int64_t *cross; /* what other components say of each sample, or NULL */
} plan;

/* Coefficients, the oldest sample's first, after zeros that make their number a multiple of 8. Sums of
   doubles are exact in any order where ``real`` says that they stay below 2^53. */
typedef struct {
    double real_taps[ORDERS];
    int64_t taps[ORDERS];
    int width, real;
} filter;

static int valid(const plan *p)
{
    int fits = p->order <= ORDERS && p->difference >= 0 &&
               p->difference <= (p->order ? 1 : DIFFERENCES) && p->limit >= 0 &&
               p->limit <= INDEX_LIMIT && p->base <= p->limit && p->base >= -p->limit;
    for (int j = 0; fits && j < p->order; j++)
        fits = p->coefficients[j] <= COEFFICIENT_LIMIT && p->coefficients[j] >= -COEFFICIENT_LIMIT;
    return fits;
}

static int within(const int64_t *indices, int64_t count, int64_t limit)
{
    /* The highest bit is set where one of them leaves the range, or 64 bits. */
    uint64_t beyond = 0, bound = (uint64_t)limit;
    for (int64_t t = 0; t < count; t++)
        beyond |= ((uint64_t)indices[t] + bound) | (bound - (uint64_t)indices[t]);
    return !(beyond >> 63);
}

static void filter_init(filter *f, const plan *p)
{
    int64_t sum = 0, largest = 2 * p->limit;
    memset(f, 0, sizeof *f);
    f->width = (p->order + 7) & ~7;
    for (int j = 0; j < p->order; j++) {
        int64_t c = p->coefficients[j];
        f->taps[f->width - 1 - j] = c;
        f->real_taps[f->width - 1 - j] = (double)c;
        sum += c < 0 ? -c : c;
    }
    f->real = sum * largest < (int64_t)1 << 52;
}

/* ``next`` points behind the newest sample. */
INLINE int64_t predict(const filter *f, const int64_t *next)
{
    int64_t sum = (int64_t)1 << (SHIFT - 1);
    next -= f->width;
    for (int j = 0; j < f->width; j++) sum += f->taps[j] * next[j];
    return sum >> SHIFT;
}

/* ``width`` as in the filter, known to the compiler. */
INLINE int64_t predict_real(const filter *f, const double *next, int width)
{
    const double *c = f->real_taps;
    int old = width - 4;
    next -= width;
    double sum = 1 << (SHIFT - 1);
#ifdef VECTORS
    __m128d a = _mm_setzero_pd(), b = _mm_setzero_pd();
    for (int j = 0; j < old; j += 4) {
        a = _mm_add_pd(a, _mm_mul_pd(_mm_loadu_pd(c + j), _mm_loadu_pd(next + j)));
        b = _mm_add_pd(b, _mm_mul_pd(_mm_loadu_pd(c + j + 2), _mm_loadu_pd(next + j + 2)));
    }
    a = _mm_add_pd(a, b);
    sum += _mm_cvtsd_f64(_mm_add_pd(a, _mm_unpackhi_pd(a, a)));
#else
    for (int j = 0; j < old; j++) sum += c[j] * next[j];
#endif
    c += old;
    next += old;
    /* The newest last: it is waited for. */
    sum += (c[0] * next[0] + c[1] * next[1]) + c[2] * next[2];
    return (int64_t)(sum + c[3] * next[3]) >> SHIFT;
}

/* ---- decoding ---- */

/* ``kind`` of the history: 0 none, 1 integers, else doubles, so many of them. */
INLINE int decode_as(decoder *d, models *m, const plan *p, const filter *f, int64_t *out, int kind,
                     int repeats, int crossed)
{
    int64_t sums[DIFFERENCES + 1] = {0}, history[ORDERS + RING];
    double real_history[ORDERS + RING];
    if (kind == 1) memset(history, 0, sizeof history);
    if (kind > 1) memset(real_history, 0, sizeof real_history);
    scale_state scales = FRESH_SCALES;
    int recent = 0, g = p->difference, now = ORDERS;
    int64_t base = p->base, limit = p->limit;
    for (int64_t t = 0; t < p->span; t++) {
        if (RARE(overrun(d))) return BAD_END;
        int same = 0;
        if (repeats && t) {
            same = get_bit(d, &m->repeats[recent]);
            recent = 2 * same + (recent >> 1);
        }
        if (same) {
            int64_t fresh = sums[0], older;
            for (int i = 1; i <= g; i++) {
                older = sums[i - 1];
                sums[i - 1] = fresh;
                fresh -= older;
            }
            sums[g] = fresh;
        } else {
            int64_t e, fresh;
            int status = get_integer(d, m, &scales, &e);
            if (RARE(status)) return status;
            fresh = e;
            if (crossed) fresh += p->cross[t];
            if (kind == 1) fresh += predict(f, history + now);
            if (kind > 1) fresh += predict_real(f, real_history + now, kind);
            sums[g] = fresh;
            for (int i = g - 1; i >= 0; i--) {
                fresh += sums[i];
                sums[i] = fresh;
            }
        }
        int64_t index = sums[0] + base;
        if (RARE(index > limit || index < -limit)) return BAD_INDEX;
        out[t] = index;
        if (kind == 1) history[now] = sums[g];
        if (kind > 1) real_history[now] = (double)sums[g];
        if (kind && ++now == ORDERS + RING) {
            memcpy(history, history + RING, ORDERS * sizeof *history);
            memcpy(real_history, real_history + RING, ORDERS * sizeof *real_history);
            now = ORDERS;
        }
    }
    return check_end(d);
}

#define DECODE(kind) \
    (p->repeats ? decode_as(d, m, p, f, out, kind, 1, 0) : decode_as(d, m, p, f, out, kind, 0, 0))

static int decode_plain(decoder *d, models *m, const plan *p, const filter *f, int64_t *out)
{
    return DECODE(0);
}

static int decode_real(decoder *d, models *m, const plan *p, const filter *f, int64_t *out)
{
    if (f->width == 8) return DECODE(8);
    if (f->width == 16) return DECODE(16);
    return f->width == 24 ? DECODE(24) : DECODE(32);
}

static int decode_wide(decoder *d, models *m, const plan *p, const filter *f, int64_t *out)
{
    return decode_as(d, m, p, f, out, 1, p->repeats, 0);
}

static int decode_crossed(decoder *d, models *m, const plan *p, const filter *f, int64_t *out)
{
    int kind = !p->order ? 0 : f->real ? f->width : 1;
    return decode_as(d, m, p, f, out, kind, p->repeats, 1);
}

static int decode(decoder *d, models *m, const plan *p, int64_t *out)
{
    filter f;
    filter_init(&f, p);
    return p->cross    ? decode_crossed(d, m, p, &f, out)
           : !p->order ? decode_plain(d, m, p, &f, out)
           : f.real    ? decode_real(d, m, p, &f, out)
                       : decode_wide(d, m, p, &f, out);
}

/* ---- encoding ---- */

/* y of a piece after the ORDERS ones before it: differences of indices[from] ... of the packet. */
INLINE void differences(const int64_t *indices, int64_t from, int64_t count, int g, int64_t base,
                        int64_t *y)
{
    int64_t z[PIECE + DIFFERENCES];
    for (int64_t i = -g; i < count; i++) z[i + g] = from + i < 0 ? 0 : indices[from + i] - base;
    for (int order = g; order > 0; order--)
        for (int64_t i = 0; i < count + order - 1; i++) z[i] = z[i + 1] - z[i];
    memcpy(y, z, (size_t)count * sizeof *y);
}

/* Prediction errors of a piece; y [ORDERS + count], the history first. */
INLINE void errors_of(const filter *f, const int64_t *y, int64_t count, int64_t *e)
{
    if (!f->width) {
        memcpy(e, y + ORDERS, (size_t)count * sizeof *e);
    } else if (f->real) {
        double real[ORDERS + PIECE], sums[PIECE];
        for (int64_t i = 0; i < ORDERS + count; i++) real[i] = (double)y[i];
        for (int64_t i = 0; i < count; i++) sums[i] = 1 << (SHIFT - 1);
        for (int j = 0; j < f->width; j += 4) {
            const double *x = real + ORDERS - f->width + j, *c = f->real_taps + j;
            for (int64_t i = 0; i < count; i++)
                sums[i] += (c[0] * x[i] + c[1] * x[i + 1]) + (c[2] * x[i + 2] + c[3] * x[i + 3]);
        }
        for (int64_t i = 0; i < count; i++) e[i] = y[ORDERS + i] - ((int64_t)sums[i] >> SHIFT);
    } else
        for (int64_t i = 0; i < count; i++) e[i] = y[ORDERS + i] - predict(f, y + ORDERS + i);
}

/* What the predictor leaves of the indices, whatever is coded. */
static void prediction_errors(const plan *p, const int64_t *indices, int64_t *out)
{
    filter f;
    int64_t y[ORDERS + PIECE] = {0};
    filter_init(&f, p);
    for (int64_t from = 0; from < p->span; from += PIECE) {
        int64_t count = p->span - from < PIECE ? p->span - from : PIECE;
        differences(indices, from, count, p->difference, p->base, y + ORDERS);
        errors_of(&f, y, count, out + from);
        memmove(y, y + count, ORDERS * sizeof *y);
    }
}

INLINE int encode_as(encoder *coder, models *m, const plan *p, const int64_t *indices, int repeats)
{
    filter f;
    int64_t y[ORDERS + PIECE] = {0}, e[PIECE];
    scale_state scales = FRESH_SCALES;
    int recent = 0;
    filter_init(&f, p);
    for (int64_t from = 0; from < p->span; from += PIECE) {
        int64_t count = p->span - from < PIECE ? p->span - from : PIECE;
        differences(indices, from, count, p->difference, p->base, y + ORDERS);
        errors_of(&f, y, count, e);
        memmove(y, y + count, ORDERS * sizeof *y);
        if (p->cross)
            for (int64_t i = 0; i < count; i++) e[i] -= p->cross[from + i];
        for (int64_t i = 0; i < count; i++) {
            if (repeats && from + i) {
                int same = indices[from + i] == indices[from + i - 1];
                put_bit(coder, same, &m->repeats[recent]);
                recent = 2 * same + (recent >> 1);
                if (same) continue;
            }
            int status = put_integer(coder, m, &scales, e[i]);
            if (RARE(status)) return status;
        }
    }
    return DONE;
}

static int encode(encoder *e, models *m, const plan *p, const int64_t *indices, int64_t *written)
{
    int status;
    if (!within(indices, p->span, p->limit)) return BAD_INDEX;
    status = p->repeats ? encode_as(e, m, p, indices, 1) : encode_as(e, m, p, indices, 0);
    if (status) return status;
    *written = encoder_finish(e);
    return *written > e->size ? NO_ROOM : DONE;
}

#endif
