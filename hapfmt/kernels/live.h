/* Which predictor a packet of LPCR gets while a recording grows: that of the packet before, or the best
   by its estimate. The readable twins are search() of hapfmt/encoder/live_many.py, and for the estimate
   choose_predictors() of hapfmt/encoder/predict.py, whose every step is taken in the same order. */
#ifndef HAPFMT_LIVE_H
#define HAPFMT_LIVE_H

#include <math.h>

#include "quick.h"

enum { REPEATS = 8, QUICK = 128, HEADER = 2 + ORDERS + 8 };
enum { COEFFICIENT_COST = 8, LONG = 6000, STRIDE = 3 };
static const int WEIGHED_ORDERS[] = {1, 2, 3, 4, 6, 8, 12, 16, 20, 24, 28, 32};
static const int TRIED_ORDERS[] = {3, 8, 20};
static const double NOISE = 1e-9, REPEAT_SHARE = 0.02, QUICK_REPEATS = 0.25;

/* A predictor but for its base. */
typedef struct {
    int32_t difference, order, way, unused;
    int32_t coefficients[ORDERS];
    int8_t reflections[ORDERS];
} habit;

typedef struct {
    const int32_t *sines;
    const double *limits, *costs;
} choice;

/* A packet's indices: the first, the mean, and how far from 0 they go. */
typedef struct {
    const int64_t *indices;
    int64_t count, first, mean, extent;
} row;

static int64_t rounded_mean(const int64_t *x, int64_t count)
{
    int64_t sum = 0;
    for (int64_t i = 0; i < count; i++) sum += x[i];
    int64_t n = 2 * sum + count, q = n / (2 * count);
    return q - (n % (2 * count) < 0);
}

static row row_of(const int64_t *x, int64_t count)
{
    row r = {x, count, x[0], rounded_mean(x, count), 0};
    for (int64_t i = 0; i < count; i++) {
        int64_t size = x[i] < 0 ? -x[i] : x[i];
        if (size > r.extent) r.extent = size;
    }
    return r;
}

static plan plan_of(const habit *h, const row *r)
{
    plan p = {0};
    p.difference = h->difference;
    p.order = h->order;
    p.repeats = (h->way & REPEATS) != 0;
    p.base = h->difference ? r->first : r->mean;
    p.limit = INDEX_LIMIT;
    p.span = r->count;
    p.coefficients = h->coefficients;
    return p;
}

static double saving(int64_t a, int64_t b)
{
    double n = (double)(a + b), sum = 0;
    if (!(a + b)) return 0;
    if (a) sum += (double)a * log2((double)a / n);
    if (b) sum += (double)b * log2((double)b / n);
    return n + sum;
}

/* estimate() of predict.py; infinite where an error cannot be coded. */
static double bits_of(const habit *h, const row *r, int counted)
{
    int64_t counts[COUNTS];
    plan p = plan_of(h, r);
    int64_t base = p.base < 0 ? -p.base : p.base;
    int stride = counted || r->count < LONG ? 1 : STRIDE;
    p.limit = base > r->extent ? base : r->extent;
    int64_t cost = valid(&p) ? estimate(&p, counted, stride, r->indices, counts) : -1;
    if (cost < 0) return HUGE_VAL;
    double header = COEFFICIENT_COST * p.order;
    if (!counted) {
        int64_t round = stride * SAMPLE, rest = r->count % round;
        int64_t seen = r->count / round * SAMPLE + (rest < SAMPLE ? rest : SAMPLE);
        if (stride == 1) seen = r->count;
        return ((double)cost / 256 + (double)counts[COUNTS - 1]) * (double)r->count / (double)seen + header;
    }
    double marks = 0, saved = 0;
    for (int i = 0; i < 7; i++) {
        double less = saving(counts[2 * i], counts[2 * i + 1]);
        if (i < 3) saved += less;
        else marks += (double)(counts[2 * i] + counts[2 * i + 1]) - less;
    }
    return (double)cost / 256 + (double)counts[COUNTS - 1] - saved + marks + header;
}

static void shorten(habit *h, int order, const int32_t *sines)
{
    h->order = order;
    memset(h->reflections + order, 0, (size_t)(ORDERS - order));
    /* What the recursion may give and SPEC LPC-005 does not allow is no predictor. */
    if (!step_up(h->reflections, order, sines, h->coefficients)) h->order = ORDERS + 1;
}

/* All reflections of a row's differences, and in ``best`` the order that repays its coefficients. */
static int reflect(const row *r, int difference, const choice *ways, habit *h, int *best)
{
    int64_t sums[LAGS];
    double lags[LAGS], energies[ORDERS], least = 0;
    memset(h, 0, sizeof *h);
    h->difference = difference;
    autocorrelate(r->indices, r->count, difference, difference ? r->first : r->mean, sums);
    for (int i = 0; i < LAGS; i++) lags[i] = (double)sums[i];
    lags[0] = lags[0] * (1 + NOISE) + (double)r->count / 12;
    int most = r->count - 1 < ORDERS ? (int)(r->count - 1) : ORDERS;
    int there = levinson(lags, most, ways->limits, h->reflections, energies);
    *best = 0;
    for (size_t i = 0; i < sizeof WEIGHED_ORDERS / sizeof *WEIGHED_ORDERS; i++) {
        int m = WEIGHED_ORDERS[i];
        if (m > there || !(energies[m - 1] > 0)) continue;
        double bits = (double)r->count / 2 * log2(energies[m - 1]) + COEFFICIENT_COST * m;
        if (!*best || bits < least) {
            least = bits;
            *best = m;
        }
    }
    return there;
}

/* The best by its estimate. */
static habit best_guess(const row *r, const choice *ways)
{
    habit best, tried, all = {0};
    double least = HUGE_VAL, before = HUGE_VAL, chosen = HUGE_VAL;
    int some = 0, there = 0;
    memset(&best, 0, sizeof best);
    for (int g = 0; g <= DIFFERENCES; g++) {
        memset(&tried, 0, sizeof tried);
        tried.difference = g;
        double bits = bits_of(&tried, r, 0);
        if (bits < least) {
            least = bits;
            best = tried;
        }
        if (bits >= before) break;
        before = bits;
    }
    for (int g = 0; g < 2; g++) {
        int order, found = reflect(r, g, ways, &tried, &order);
        if (!found) continue;
        habit whole = tried;
        shorten(&tried, order, ways->sines);
        double bits = bits_of(&tried, r, 0);
        if (bits < least) {
            least = bits;
            best = tried;
        }
        if (!some || bits < chosen) {
            chosen = bits;
            all = whole;
            there = found;
        }
        some = 1;
    }
    for (size_t i = 0; some && i < sizeof TRIED_ORDERS / sizeof *TRIED_ORDERS; i++) {
        tried = all;
        shorten(&tried, TRIED_ORDERS[i] < there ? TRIED_ORDERS[i] : there, ways->sines);
        double bits = bits_of(&tried, r, 0);
        if (bits < least) {
            least = bits;
            best = tried;
        }
    }
    if (bits_of(&best, r, 1) == HUGE_VAL) memset(&best, 0, sizeof best);
    return best;
}

static int mostly_repeats(const row *r, double share)
{
    int64_t same = 0;
    for (int64_t i = 1; i < r->count; i++) same += r->indices[i] == r->indices[i - 1];
    return (double)same > share * (double)r->count;
}

#endif
