/* The choice of a packet's predictor, by estimates. The readable twin is hapfmt/encoder/predict.py: both
   choose the same, bit for bit. Sums have one order, or are exact in any. */
#ifndef HAPFMT_CHOICE_H
#define HAPFMT_CHOICE_H

#include <math.h>

#include "search.h"

enum { PART = 48, FRONT = 40, COSTED = 32, POLYNOMIALS = 5, SETS = 4, WAYS = 24, TOGETHER = 12 };
enum { COEFFICIENT_COST = 8, REPEAT_SHARE = 50, BIT = 256, QUIET_BITS = 141 };
enum { CALM_BITS = 384, LEVEL_BITS = 128 };

/* What is searched. ``sets``: sums of first differences where quiet and loud parts count alike, and plain
   ones; the same of the samples, as bits. One part of ``stride`` is estimated. ``other``: more orders,
   and sums that are not likely to help. ``written``: packets of which the smallest stays. */
typedef struct { int orders, stride, sets, other, written; } scope;

typedef struct {
    int difference, order, repeats, set;
    int8_t reflections[ORDERS];
    int32_t coefficients[ORDERS];
    double taps[ORDERS]; /* on the samples or their first differences */
    int width;           /* taps, a multiple of four */
    int64_t bits;        /* BIT times them; -1: it cannot be coded */
} way;

/* rows: samples without their mean, and their first differences, after FRONT zeros. */
typedef struct {
    const int64_t *indices;
    int64_t count, first, mean, seen, marks;
    scope how;
    double *rows[2], *gains, largest[2], sums[SETS][LAGS], noise[SETS];
    int64_t polynomials[POLYNOMIALS];
} search;

#if defined(__GNUC__)
typedef double four __attribute__((vector_size(32)));
#endif

/* sums[k] += now[i] * now[i - k]. */
INLINE void add_products(const double *now, int64_t n, int lags, double *sums)
{
    for (int from = 0; from < lags; from += TOGETHER) {
        const double *then = now - from;
        double a[TOGETHER] = {0};
#if defined(__GNUC__)
        four b[3] = {{0}, {0}, {0}};
        for (int64_t i = 0; i < n; i++) {
            double v = now[i];
            four x = {v, v, v, v};
            for (int k = 0; k < 3; k++) {
                four y;
                memcpy(&y, then + i - 4 * k - 3, sizeof y);
                b[k] += x * y;
            }
        }
        for (int k = 0; k < TOGETHER; k++) a[k] = b[k / 4][3 - k % 4];
#else
        for (int64_t i = 0; i < n; i++)
            for (int k = 0; k < TOGETHER; k++) a[k] += now[i] * then[i - k];
#endif
        for (int k = 0; k < TOGETHER && from + k < lags; k++) sums[from + k] += a[k];
    }
}

INLINE double size_of(double v) { return v < 0 ? -v : v; }

/* The sum of magnitudes that are whole numbers. */
INLINE double sum_of(const double *e, int64_t n)
{
    double s[4] = {0};
    int64_t i = 0;
    for (; i + 4 <= n; i += 4)
        for (int j = 0; j < 4; j++) s[j] += size_of(e[i + j]);
    for (; i < n; i++) s[0] += size_of(e[i]);
    return (s[0] + s[1]) + (s[2] + s[3]);
}

/* BIT times the bits of prediction errors, added to *bits; it becomes -1 where one cannot be coded. */
INLINE void add_bits(const double *e, int64_t n, int64_t *bits)
{
    for (int64_t at = 0; at < n && *bits >= 0; at += COSTED) {
        int64_t size = n - at < COSTED ? n - at : COSTED;
        double sum = sum_of(e + at, size);
        *bits += size * (log_of(32 * (uint64_t)size + 87 * (uint64_t)sum) - log_of(32 * (uint64_t)size));
        if (RARE(sum >= 17179869184.0))
            for (int64_t i = at; i < at + size; i++)
                if (size_of(e[i]) >= 17179869184.0) *bits = -1;
    }
}

/* Samples minus their predictions, which are rounded as the decoder does. */
INLINE void errors_with(const way *w, const double *x, int64_t n, double *e)
{
    const double far = 6755399441055744.0, more = 1.0 / 16384;
    double s[PART] = {0};
    for (int j = 0; j < w->width; j += 4) {
        const double *y = x - j - 1, *c = w->taps + j;
        for (int64_t i = 0; i < n; i++)
            s[i] += (c[0] * y[i] + c[1] * y[i - 1]) + (c[2] * y[i - 2] + c[3] * y[i - 3]);
    }
    for (int64_t i = 0; i < n; i++) e[i] = x[i] - (((s[i] + more) + far) - far);
}

INLINE int64_t part_at(const search *s, int64_t from)
{
    return s->count - from < PART ? s->count - from : PART;
}

INLINE void load(search *s)
{
    double mean = (double)s->mean, last = (double)s->first, most = 0, steepest = 0;
    double *x = s->rows[0] + FRONT, *y = s->rows[1] + FRONT;
    memset(s->rows[0], 0, FRONT * sizeof *x);
    memset(s->rows[1], 0, FRONT * sizeof *x);
    for (int64_t i = 0; i < s->count; i++) {
        double now = (double)s->indices[i];
        x[i] = now - mean;
        y[i] = now - last;
        last = now;
        s->marks += i && y[i] == 0;
        most = size_of(x[i]) > most ? size_of(x[i]) : most;
        steepest = size_of(y[i]) > steepest ? size_of(y[i]) : steepest;
    }
    s->largest[0] = most;
    s->largest[1] = steepest;
}

/* Bits of fixed polynomials, and how much each part counts where all count alike. */
INLINE void measure_polynomials(search *s)
{
    double d[3][4 + PART];
    int part = 0;
    for (int64_t from = 0; from < s->count; from += PART, part++) {
        int64_t n = part_at(s, from);
        const double *x = s->rows[0] + FRONT + from, *y = s->rows[1] + FRONT + from;
        for (int64_t i = 1; i < 4 + n; i++) d[0][i] = y[i - 4] - y[i - 5];
        for (int64_t i = 2; i < 4 + n; i++) d[1][i] = d[0][i] - d[0][i - 1];
        for (int64_t i = 3; i < 4 + n; i++) d[2][i] = d[1][i] - d[1][i - 1];
        const double *rows[POLYNOMIALS] = {x, y, d[0] + 4, d[1] + 4, d[2] + 4};
        double least = sum_of(x, n);
        for (int g = 1; g < POLYNOMIALS; g++) {
            double sum = sum_of(rows[g], n);
            least = sum < least ? sum : least;
        }
        s->gains[part + 1] = least / (double)n + 0.3;
        if (part % s->how.stride) continue;
        for (int g = 0; g < POLYNOMIALS; g++) add_bits(rows[g], n, s->polynomials + g);
        s->seen += n;
    }
    double before = s->gains[1];
    for (int k = 1; k <= part; k++) {
        double own = s->gains[k], next = k < part ? s->gains[k + 1] : own;
        s->gains[k] = 4 / (before + 2 * own + next);
        before = own;
    }
    s->gains[0] = s->gains[1];
    s->gains[part + 1] = s->gains[part];
}

/* Plain sums are for packets of few bits, sums of samples for those that vary about one level. */
INLINE void choose_sums(search *s)
{
    int64_t least = s->polynomials[0], *p = s->polynomials;
    for (int g = 1; g < POLYNOMIALS; g++) least = p[g] < least ? p[g] : least;
    int calm = least < CALM_BITS * s->seen;
    if (!calm) s->how.sets &= ~8;
    if (s->how.other) return;
    if (!calm) s->how.sets &= ~2;
    if (p[0] >= p[1] + LEVEL_BITS * s->seen) s->how.sets &= ~4;
}

INLINE void sum_products(search *s)
{
    double loud[2][FRONT + PART] = {{0}};
    const double *a = s->gains;
    for (int64_t from = 0; from < s->count; from += PART, a++) {
        int64_t n = part_at(s, from);
        for (int set = 0; set < SETS; set++) {
            if (!(s->how.sets >> set & 1)) continue;
            const double *x = s->rows[set < 2] + FRONT + from;
            double each = 1;
            if (!(set & 1)) {
                double *y = loud[set < 2] + FRONT;
                memmove(y - FRONT, y - FRONT + PART, FRONT * sizeof *y);
                for (int64_t i = 0; i < n; i++) {
                    const double *b = a + (i >= PART / 2);
                    y[i] = x[i] * (b[0] + (b[1] - b[0]) * ((double)((i + PART / 2) % PART) / PART));
                }
                x = y;
                each = a[1] * a[1];
            }
            add_products(x, n, s->how.orders + 1, s->sums[set]);
            s->noise[set] += (double)n * each;
        }
    }
}

INLINE void measure_ways(const search *s, way *ways, int count)
{
    double e[PART];
    for (way *w = ways; w < ways + count; w++) {
        const double *x = s->rows[w->difference > 0] + FRONT;
        w->bits = 0;
        for (int64_t from = 0; from < s->count && w->bits >= 0; from += (int64_t)s->how.stride * PART) {
            int64_t n = part_at(s, from);
            errors_with(w, x + from, n, e);
            add_bits(e, n, &w->bits);
        }
    }
}

/* BIT times the bits of the same parts where samples that repeat are marked. */
INLINE int64_t bits_with_repeats(const search *s, const way *w)
{
    double e[PART];
    const double *x = s->rows[w->difference > 0] + FRONT, *y = s->rows[1] + FRONT;
    int64_t bits = 0, counts[2 * REPEAT_CONTEXTS] = {0};
    for (int64_t from = 0; from < s->count && bits >= 0; from += (int64_t)s->how.stride * PART) {
        int64_t n = part_at(s, from), fresh = 0;
        int recent = 0;
        errors_with(w, x + from, n, e);
        for (int64_t i = 0; i < n; i++) {
            int same = from + i && y[from + i] == 0;
            counts[2 * recent + same]++;
            recent = 2 * same + (recent >> 1);
            e[fresh] = e[i];
            fresh += !same;
        }
        add_bits(e, fresh, &bits);
    }
    for (int i = 0; i < REPEAT_CONTEXTS && bits >= 0; i++) {
        int p = probability_of(counts[2 * i], counts[2 * i + 1]);
        bits += counts[2 * i] * bit_cost(BIT - p) + counts[2 * i + 1] * bit_cost(p);
    }
    return bits;
}

static int linear_way(way *w, int set, const int8_t *reflections, int order, const int32_t *sines)
{
    memset(w, 0, sizeof *w);
    if (!step_up(reflections, order, sines, w->coefficients)) return 0;
    memcpy(w->reflections, reflections, (size_t)order);
    w->set = set;
    w->difference = set < 2;
    w->order = order;
    w->width = (order + 3) & ~3;
    for (int j = 0; j < order; j++) w->taps[j] = (double)w->coefficients[j] / (1 << SHIFT);
    return 1;
}

static void polynomial_way(way *w, int difference, int64_t bits)
{
    static const double taps[POLYNOMIALS][3] = {{0}, {0}, {1}, {2, -1}, {3, -3, 1}};
    memset(w, 0, sizeof *w);
    w->difference = difference;
    memcpy(w->taps, taps[difference], sizeof *taps);
    w->width = difference > 1 ? 4 : 0;
    w->bits = bits;
}

/* The order whose energy best repays its coefficients; 0: none. */
static int best_order(const double *energies, int there, int64_t count)
{
    double a = 1.3862943611198906 * COEFFICIENT_COST / (double)count, each = 1 + a + a * a / 2;
    double factor = 1, least = 0;
    int best = 0;
    for (int m = 1; m <= there; m++) {
        factor *= each;
        double cost = energies[m - 1] * factor;
        if (energies[m - 1] > 0 && (!best || cost < least)) {
            least = cost;
            best = m;
        }
    }
    return best;
}

INLINE int least_of(const way *ways, int count)
{
    int best = -1;
    for (int k = 0; k < count; k++)
        if (ways[k].bits >= 0 && (best < 0 || ways[k].bits < ways[best].bits)) best = k;
    return best;
}

/* ways [WAYS], the best first: how many there are. */
INLINE int rank_ways(search *s, const int32_t *sines, const double *limits, way *ways)
{
    int8_t found[SETS][ORDERS];
    int there[SETS] = {0}, count = 0, kept = 0;
    double energies[ORDERS];
    load(s);
    measure_polynomials(s);
    choose_sums(s);
    sum_products(s);
    int most = s->count - 1 < s->how.orders ? (int)(s->count - 1) : s->how.orders;
    for (int set = 0; set < SETS; set++) {
        if (!(s->how.sets >> set & 1)) continue;
        double *r = s->sums[set];
        r[0] = r[0] * (1 + 1e-9) + s->noise[set] / 12;
        there[set] = levinson(r, most, limits, found[set], energies);
        int m = best_order(energies, there[set], s->count);
        count += m && linear_way(ways + count, set, found[set], m, sines);
    }
    measure_ways(s, ways, count);
    int best = least_of(ways, count);
    if (s->how.other && best >= 0) {
        int from = count, set = ways[best].set, order = ways[best].order;
        for (int m = 1; m <= there[set]; m += m < 4 ? 1 : 4)
            count += m != order && linear_way(ways + count, set, found[set], m, sines);
        measure_ways(s, ways + from, count - from);
    }
    for (int g = 0; g < POLYNOMIALS; g++) polynomial_way(ways + count++, g, s->polynomials[g]);
    best = least_of(ways, count);
    int quiet = best >= 0 && ways[best].bits < QUIET_BITS * s->seen;
    if (quiet) {
        int low = count;
        count += there[1] >= 1 && linear_way(ways + count, 1, found[1], 1, sines);
        count += there[3] >= 3 && linear_way(ways + count, 3, found[3], 3, sines);
        measure_ways(s, ways + low, count - low);
    }
    for (int k = 0; k < count; k++) {
        way w = ways[k];
        int at = kept;
        if (w.bits < 0) continue;
        w.bits = w.bits * s->count / s->seen + 8 * BIT * w.order;
        for (; at && ways[at - 1].bits > w.bits; at--) ways[at] = ways[at - 1];
        ways[at] = w;
        kept++;
    }
    if (!kept) return 0;
    for (int at = 1; quiet && ways[0].order && at < kept; at++)
        if (!ways[at].order) {
            way first = ways[at];
            memmove(ways + 1, ways, (size_t)at * sizeof first);
            ways[0] = first;
            if (s->how.written < 2) s->how.written = 2;
        }
    way w = ways[0];
    if (s->marks * REPEAT_SHARE > s->count && (w.bits = bits_with_repeats(s, &w)) >= 0) {
        w.repeats = 1;
        w.bits = w.bits * s->count / s->seen + 8 * BIT * (w.order + REPEAT_CONTEXTS);
        int at = w.bits < ways[0].bits ? 0 : 1;
        memmove(ways + at + 1, ways + at, (size_t)(kept++ - at) * sizeof w);
        ways[at] = w;
        s->how.written += quiet && s->how.written == 2;
    }
    return kept;
}

static int rank_plain(search *s, const int32_t *sines, const double *limits, way *ways)
{
    return rank_ways(s, sines, limits, ways);
}

INLINE void errors_as(const search *s, const way *w, int64_t *errors)
{
    double e[PART];
    const double *x = s->rows[w->difference > 0] + FRONT;
    for (int64_t from = 0; from < s->count; from += PART) {
        int64_t n = part_at(s, from);
        errors_with(w, x + from, n, e);
        for (int64_t i = 0; i < n; i++) errors[from + i] = (int64_t)e[i];
    }
}

static void errors_plain(const search *s, const way *w, int64_t *errors) { errors_as(s, w, errors); }

/* The same loops with wider registers; BEST: of the two. */
#ifdef WIDE
#define BEST(name) (wide() ? name##_wide : name##_plain)
WIDE static int rank_wide(search *s, const int32_t *sines, const double *limits, way *ways)
{
    return rank_ways(s, sines, limits, ways);
}
WIDE static void errors_wide(const search *s, const way *w, int64_t *errors) { errors_as(s, w, errors); }
#else
#define BEST(name) name##_plain
#endif

/* ---- where packets are cut ---- */

enum { SHORTEST_CUT = 4096, PIECES = 16, CUT_ORDER = 11, CUT_LAGS = CUT_ORDER + 1, CUTS_TRIED = 6 };
/* Bits that a cut must save: a row of 12 bytes, the first states, averages that start from one byte. */
enum { CUT_BITS = 496 };

/* The pieces of a packet: samples, sums of products of first differences, and what each counts. */
typedef struct {
    int pieces;
    int64_t edges[PIECES + 1];
    double sums[PIECES][CUT_LAGS], weights[PIECES];
} cutting;

static double log_2(double v)
{
    const double root = 0.7071067811865476;
    int power;
    double m = frexp(v, &power), t = (m - root) / (m + root), q = t * t;
    double rest = 1 + q * (1.0 / 3 + q * (1.0 / 5 + q * (1.0 / 7 + q / 9)));
    return power - 0.5 + 2.8853900817779268 * (t * rest);
}

INLINE void sum_pieces(const int64_t *indices, cutting *c)
{
    double x[FRONT + PART];
    for (int k = 0; k < c->pieces; k++) {
        int64_t last = indices[c->edges[k]];
        memset(x, 0, sizeof x);
        for (int64_t from = c->edges[k]; from < c->edges[k + 1]; from += PART) {
            int64_t rest = c->edges[k + 1] - from, n = rest < PART ? rest : PART;
            for (int64_t i = 0; i < n; i++) {
                x[FRONT + i] = (double)(indices[from + i] - last);
                last = indices[from + i];
            }
            add_products(x + FRONT, n, CUT_LAGS, c->sums[k]);
            memmove(x, x + n, FRONT * sizeof *x);
        }
    }
}

static void sum_pieces_plain(const int64_t *indices, cutting *c) { sum_pieces(indices, c); }

#ifdef WIDE
WIDE static void sum_pieces_wide(const int64_t *indices, cutting *c) { sum_pieces(indices, c); }
#endif

/* Bits of one packet of these pieces; *energy: that of its errors. */
static double bits_together(const cutting *c, int first, int stop, const int32_t *sines,
                            const double *limits, double *energy)
{
    static const int tried[CUTS_TRIED] = {0, 1, 2, 4, 8, CUT_ORDER};
    double r[LAGS] = {0}, energies[ORDERS], noise = 0, least = 0;
    int8_t found[ORDERS];
    int32_t taps[ORDERS];
    for (int k = first; k < stop; k++) {
        for (int lag = 0; lag < CUT_LAGS; lag++) r[lag] += c->weights[k] * c->sums[k][lag];
        noise += c->weights[k] * (double)(c->edges[k + 1] - c->edges[k]);
    }
    r[0] = r[0] * (1 + 1e-9) + noise / 12;
    int there = levinson(r, CUT_ORDER, limits, found, energies);
    for (int at = 0; at < CUTS_TRIED && tried[at] <= there; at++) {
        int order = tried[at];
        double a[CUT_LAGS + 1] = {1}, products[CUT_LAGS], bits = COEFFICIENT_COST * order, all = 0;
        if (!step_up(found, order, sines, taps)) break;
        for (int j = 0; j < order; j++) a[j + 1] = -(double)taps[j] / (1 << SHIFT);
        for (int lag = 0; lag <= order; lag++) {
            products[lag] = 0;
            for (int j = 0; j + lag <= order; j++) products[lag] += a[j] * a[j + lag];
            if (lag) products[lag] *= 2;
        }
        for (int k = first; k < stop; k++) {
            double n = (double)(c->edges[k + 1] - c->edges[k]), left = 0;
            for (int lag = 0; lag <= order; lag++) left += products[lag] * c->sums[k][lag];
            left = (left > 0 ? left : 0) + n / 12;
            bits += n * log_2(1 + 3.8 * sqrt(left / n));
            all += left;
        }
        if (!at || bits < least) {
            least = bits;
            *energy = all;
        }
    }
    return least + CUT_BITS;
}

/* Where packets begin that take few bits: of the shortest ones those neighbours become one that save most
   by that, until none does. starts [PIECES]: how many. */
static int find_cuts(const int64_t *indices, int64_t count, const int32_t *sines, const double *limits,
                     int64_t *starts)
{
    cutting c = {0};
    double costs[PIECES], joint[PIECES], energy = 1;
    int left[PIECES + 2];
    c.pieces = count / SHORTEST_CUT < PIECES ? (int)(count / SHORTEST_CUT) : PIECES;
    starts[0] = 0;
    if (c.pieces < 2) return 1;
    for (int k = 0; k <= c.pieces; k++) {
        c.edges[k] = count * k / c.pieces;
        left[k] = k;
    }
    left[c.pieces + 1] = c.pieces;
    BEST(sum_pieces)(indices, &c);
    for (int k = 0; k < c.pieces; k++) {
        c.weights[k] = 1;
        costs[k] = bits_together(&c, k, k + 1, sines, limits, &energy);
        c.weights[k] = (double)(c.edges[k + 1] - c.edges[k]) / energy;
    }
    int n = c.pieces;
    for (int k = 0; k + 1 < n; k++) joint[k] = bits_together(&c, k, k + 2, sines, limits, &energy);
    while (n > 1) {
        int best = 0;
        for (int k = 1; k + 1 < n; k++)
            if (joint[k] - costs[k] - costs[k + 1] < joint[best] - costs[best] - costs[best + 1]) best = k;
        if (joint[best] - costs[best] - costs[best + 1] >= 0) break;
        costs[best] = joint[best];
        for (int k = best + 1; k + 1 < n; k++) {
            costs[k] = costs[k + 1];
            joint[k - 1] = joint[k];
        }
        for (int k = best + 1; k < n; k++) left[k] = left[k + 1];
        n--;
        for (int k = best - 1; k <= best; k++)
            if (k >= 0 && k + 1 < n)
                joint[k] = bits_together(&c, left[k], left[k + 2], sines, limits, &energy);
    }
    for (int k = 0; k < n; k++) starts[k] = c.edges[left[k]];
    return n;
}

/* Prediction errors where doubles have them exactly; whether they do. */
static int exact_errors(const search *s, const way *w, int64_t *errors)
{
    double sum = 0;
    for (int j = 0; j < w->width; j++) sum += size_of(w->taps[j]);
    if (sum * s->largest[w->difference > 0] >= 274877906944.0) return 0;
    BEST(errors)(s, w, errors);
    return 1;
}

#endif
