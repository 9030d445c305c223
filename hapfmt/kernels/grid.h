/* The values that knots may have, in ascending order; the readable twin is encoder/gridded.py. */
#ifndef HAPFMT_GRID_H
#define HAPFMT_GRID_H

#include <stdint.h>

/* count >= 1 values of at most 2^34 in magnitude: those of ``levels``, or first + step * place
   where it is NULL. */
typedef struct {
    const int64_t *levels;
    int64_t first, step, count;
} grid;

static inline int64_t floor_div(int64_t n, int64_t d)
{
    int64_t q = n / d;
    return q - (n % d < 0);
}

static inline int64_t clamp(int64_t x, int64_t low, int64_t high)
{
    return x < low ? low : x > high ? high : x;
}

static inline int64_t value_of(const grid *g, int64_t place)
{
    return g->levels ? g->levels[place] : g->first + g->step * place;
}

/* The first place whose value is at least ``value``; the number of places where there is none. */
static inline int64_t place_from(const grid *g, int64_t value)
{
    if (!g->levels) return clamp(-floor_div(g->first - value, g->step), 0, g->count);
    int64_t low = 0, high = g->count;
    while (low < high) {
        int64_t middle = (low + high) / 2;
        if (g->levels[middle] < value) low = middle + 1;
        else high = middle;
    }
    return low;
}

/* The last place whose value is at most ``value``; -1 where there is none. */
static inline int64_t place_to(const grid *g, int64_t value)
{
    if (!g->levels) return clamp(floor_div(value - g->first, g->step), -1, g->count - 1);
    return place_from(g, value + 1) - 1;
}

#endif
