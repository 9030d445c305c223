/* A block as knots within a deadband, and what is shared of it (see live.c). */
#ifndef HAPFMT_LIVE_KNOTS_H
#define HAPFMT_LIVE_KNOTS_H

#include "grid.h"

enum { OUTSIDE = -1, NO_CODE = -2, FULL = -3, BROKEN = -4 };
enum { AS_INDICES = 0, HELD = 1, JOINED = 2 };

/* What one channel asks for. ``grid``: the place of its levels and tops, -1 for multiples of the step.
   ``kd`` 0: there is no contract to check. Knots keep within ``slack`` where the floor allows less than
   a count. */
typedef struct {
    int64_t low, high, step, zero, grid, kn, kd, floor, felt, way, slack;
} task;

/* A deadband's grid: magnitudes of counts, the largest that stands for each, and all counts in
   ascending order about 0, 2 * count - 1 of them. */
typedef struct {
    const int64_t *levels, *tops;
    int64_t *all;
    int64_t count;
} cells;

/* The first place of ascending numbers that is not below x; near the hint it is found soon. */
static inline int64_t first_from(const int64_t *row, int64_t count, int64_t x, int64_t hint)
{
    int64_t low = 0, high = count, step = 1;
    if (hint < count && row[hint] < x) {
        low = hint + 1;
        while (low + step < count && row[low + step] < x) {
            low += step + 1;
            step *= 2;
        }
        if (low + step < count) high = low + step;
    } else {
        high = hint < count ? hint : count;
        while (high - step >= 0 && row[high - step] >= x) {
            high -= step;
            step *= 2;
        }
        if (high - step >= 0) low = high - step + 1;
    }
    while (low < high) {
        int64_t middle = (low + high) / 2;
        if (row[middle] < x) low = middle + 1; else high = middle;
    }
    return low;
}

/* Bytes of the packet of counts x [count], or what went wrong; ``rows``: int64 [4 * count] to work
   in. */
int64_t hapfmt_live_knots(const task *t, const cells *g, const int64_t *x, int64_t count,
                          int64_t *rows, uint8_t *packet, int64_t room);

#endif
