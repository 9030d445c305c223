/* Estimates of a packet's size for the encoder. The readable twin is hapfmt/encoder/predict.py. Both
   give the same numbers, bit for bit: sums are exact, and the few floating-point steps have the same
   order. */
#ifndef HAPFMT_SEARCH_H
#define HAPFMT_SEARCH_H

#include "lpcr.h"

enum { SCALED_BITS = 18, SUM_BLOCK = 4096, LAGS = ORDERS + 1 };
enum { LANES = 12, ROOM = 36 };

/* sums[k] of now[i] * then[i + k]; lanes: an even constant once it is inlined. */
INLINE void products(const double *now, const double *then, int64_t n, int lanes, double *sums)
{
#ifdef VECTORS
    __m128d a[LANES / 2];
    for (int k = 0; k < lanes / 2; k++) a[k] = _mm_setzero_pd();
    for (int64_t i = 0; i < n; i++) {
        __m128d x = _mm_set1_pd(now[i]);
        for (int k = 0; k < lanes / 2; k++)
            a[k] = _mm_add_pd(a[k], _mm_mul_pd(x, _mm_loadu_pd(then + i + 2 * k)));
    }
    for (int k = 0; k < lanes / 2; k++) _mm_storeu_pd(sums + 2 * k, a[k]);
#else
    for (int k = 0; k < lanes; k++) sums[k] = 0;
    for (int64_t i = 0; i < n; i++)
        for (int k = 0; k < lanes; k++) sums[k] += now[i] * then[i + k];
#endif
}

/* Sums of x[i] * x[i + lag], x being the differences shifted to at most 18 bits: products below 2^36,
   4096 of them below 2^48, so doubles are exact in any order. sums [lags]. */
static void autocorrelate(const int64_t *indices, int64_t count, int g, int64_t base, int lags, int64_t *sums)
{
    double x[ROOM + SUM_BLOCK];
    int64_t y[PIECE];
    uint64_t most = 0;
    memset(sums, 0, (size_t)lags * sizeof *sums);
    for (int64_t from = 0; from < count; from += PIECE) {
        int64_t n = count - from < PIECE ? count - from : PIECE;
        differences(indices, from, n, g, base, y);
        for (int64_t i = 0; i < n; i++) most |= (uint64_t)(y[i] < 0 ? -y[i] : y[i]);
    }
    int shift = bit_length(most) - SCALED_BITS;
    if (shift < 0) shift = 0;
    memset(x, 0, sizeof x);
    for (int64_t from = 0; from < count; from += SUM_BLOCK) {
        int64_t n = count - from < SUM_BLOCK ? count - from : SUM_BLOCK;
        /* x[ROOM] ... are the block, the ROOM before it those that they are multiplied with. */
        for (int64_t at = 0; at < n; at += PIECE) {
            int64_t some = n - at < PIECE ? n - at : PIECE;
            differences(indices, from + at, some, g, base, y);
            for (int64_t i = 0; i < some; i++) x[ROOM + at + i] = (double)(y[i] >> shift);
        }
        for (int lag = 0; lag < lags; lag += LANES) {
            double a[LANES];
            products(x + ROOM, x + ROOM - lag - (LANES - 1), n, LANES, a);
            for (int k = 0; k < LANES && lag + k < lags; k++) sums[lag + k] += (int64_t)a[LANES - 1 - k];
        }
        memmove(x, x + n, ROOM * sizeof *x);
    }
}

/* Reflection coefficients nearest in the arcsine domain, ``limits`` being the middles between them,
   and the energy left after each; how many there are. */
static int levinson(const double *r, int orders, const double *limits, int8_t *found, double *energies)
{
    double p[ORDERS], before[ORDERS], error = r[0];
    int order = 0;
    while (order < orders && error > 0) {
        double sum = 0;
        for (int j = 0; j < order; j++) sum += p[j] * r[order - j];
        double k = (r[order + 1] - sum) / error, magnitude = k < 0 ? -k : k;
        if (!(magnitude < 1)) break;
        int low = 0, high = 127;
        while (low < high) {
            int middle = (low + high) / 2;
            if (magnitude < limits[middle]) high = middle; else low = middle + 1;
        }
        found[order] = (int8_t)(k < 0 ? -low : low);
        memcpy(before, p, (size_t)order * sizeof *p);
        for (int j = 0; j < order; j++) p[j] = before[j] - k * before[order - 1 - j];
        p[order] = k;
        error *= 1 - k * k;
        energies[order++] = error;
    }
    return order;
}

/* 256 times the binary logarithm, the mantissa taken for its own logarithm. */
INLINE int64_t log_of(uint64_t v)
{
    int lg = bit_length(v) - 1;
    return 256 * lg + (int64_t)((lg >= 8 ? v >> (lg - 8) : v << (8 - lg)) & 255);
}

#endif
