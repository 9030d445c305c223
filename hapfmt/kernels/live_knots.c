/* A block of counts as the fewest knots within its deadband: a packet of KNOT. The readable twin is
   pack_knots() of hapfmt/encoder/live_knots.py.

   Counts lie within 33 bits, widths within 49: a tube is cut to 2^32, as wide as knots may lie. */
#include "live_knots.h"

#include "tube.h"

static const int64_t BOUND = (int64_t)1 << 32;

static inline int64_t size_of(int64_t x) { return x < 0 ? -x : x; }

/* floor(n / step) by its inverse, which is at most one off. */
static inline int64_t quotient(int64_t n, int64_t step, double inverse)
{
    int64_t q = (int64_t)((double)n * inverse), rest = n - q * step;
    return q + (rest >= step) - (rest < 0);
}

/* Of counts from the zero of the grid on. */
static void widen(const task *t, const int64_t *x, int64_t count, int64_t *lower, int64_t *upper)
{
    for (int64_t i = 0; i < count; i++) {
        int64_t width = size_of(x[i] - t->felt) * t->kn / t->kd, at = x[i] - t->zero;
        if (width < t->slack) width = t->slack;
        lower[i] = at - width < -BOUND ? -BOUND : at - width;
        upper[i] = at + width > BOUND ? BOUND : at + width;
    }
}

/* The index of the nearest count of the grid. */
static int64_t index_of(const task *t, const cells *g, int64_t at)
{
    if (!g) return floor_div(2 * at + t->step, 2 * t->step);
    int64_t cell = first_from(g->tops, g->count, size_of(at), 0);
    return at < 0 ? -cell : cell;
}

/* The places of the grid within the tube; 0 where there is none at a tick. */
static int to_places(const grid *g, int64_t count, int64_t *lower, int64_t *upper)
{
    double inverse = 1.0 / (double)g->step;
    int64_t a = 0, b = 0, last = g->count - 1;
    for (int64_t i = 0; i < count; i++) {
        if (g->levels) {
            lower[i] = a = first_from(g->levels, g->count, lower[i], a);
            b = first_from(g->levels, g->count, upper[i] + 1, b);
            upper[i] = b - 1;
        } else {
            int64_t from = -quotient(g->first - lower[i], g->step, inverse);
            int64_t to = quotient(upper[i] - g->first, g->step, inverse);
            lower[i] = from < 0 ? 0 : from;
            upper[i] = to > last ? last : to;
        }
        if (lower[i] > upper[i]) return 0;
    }
    return 1;
}

static int is_kept(const task *t, int64_t x, int64_t at)
{
    int64_t y = at + t->zero;
    y = y < t->low ? t->low : y > t->high ? t->high : y;
    int64_t e = size_of(x - y);
    return e <= t->floor || e * t->kd <= size_of(x - t->felt) * t->kn;
}

/* Whether what the knots say of every tick keeps the contract. */
static int keeps(const task *t, const int64_t *x, int64_t count, const int64_t *ticks,
                 const int64_t *values, int64_t knots)
{
    for (int64_t k = 0; k < knots; k++) {
        int64_t stop = k + 1 < knots ? ticks[k + 1] : count, run = stop - ticks[k];
        int64_t rise = t->way == JOINED && k + 1 < knots ? values[k + 1] - values[k] : 0;
        for (int64_t i = ticks[k]; i < stop; i++) {
            int64_t at = values[k];
            if (rise) at += floor_div(2 * rise * (i - ticks[k]) + run, 2 * run);
            if (!is_kept(t, x[i], at)) return 0;
        }
    }
    return 1;
}

int64_t hapfmt_live_knots(const task *t, const cells *g, const int64_t *x, int64_t count,
                          int64_t *rows, uint8_t *packet, int64_t room)
{
    int64_t *lower = rows, *upper = lower + count, *ticks = upper + count, *values = ticks + count;
    int64_t least = x[0], most = x[0], knots;
    for (int64_t i = 1; i < count; i++) {
        if (x[i] < least) least = x[i];
        if (x[i] > most) most = x[i];
    }
    int64_t first = index_of(t, g, least - t->zero), last = index_of(t, g, most - t->zero);
    if (g && (first <= -g->count || last >= g->count)) return OUTSIDE;
    grid window = {g ? g->all + g->count - 1 + first : NULL, first * t->step, t->step, last - first + 1};
    if (g) window.step = 1;
    widen(t, x, count, lower, upper);
    tube in = {lower, upper, (int32_t)count};
    if (t->way == HELD) {
        if (!to_places(&window, count, lower, upper)) return BROKEN;
        knots = hapfmt_fewest_hold(&in, ticks, values);
    } else {
        knots = hapfmt_fewest_linear(&in, &window, ticks, values);
        if (knots < 0) return FULL;
        if (!knots) return BROKEN;
    }
    /* In place of the tube: the indices of the knots, and the counts that they stand for. */
    int64_t *indices = lower, *counts = upper;
    for (int64_t k = 0; k < knots; k++) {
        int64_t place = values[k];
        if (t->way == JOINED)
            place = g ? first_from(window.levels, window.count, place, 0)
                      : floor_div(place - window.first, window.step);
        indices[k] = first + place;
        counts[k] = g ? window.levels[place] : window.first + place * window.step;
    }
    if (!keeps(t, x, count, ticks, counts, knots)) return BROKEN;
    return hapfmt_pack_knots(ticks, indices, knots, t->way == JOINED, packet, room);
}
