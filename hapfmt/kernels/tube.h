/* Tubes and the lines in them: links.c chooses the knots, sweep.c sweeps the lines of one link. */
#ifndef HAPFMT_TUBE_H
#define HAPFMT_TUBE_H

#include "grid.h"
#include "kernels.h"

/* Counts, lower[t] <= upper[t], |count| <= 2^32, at most 2^24 ticks. */
typedef struct {
    const int64_t *lower, *upper;
    int32_t size;
} tube;

/* Through (x, y) with direction (dx >= 0, dy); y in half counts. */
typedef struct {
    int64_t y, dy;
    int32_t x, dx;
} line;

typedef struct {
    int64_t y;
    int32_t x;
} point;

typedef struct {
    line is;
    int32_t from;
} entry;

typedef struct {
    entry *entries;
    size_t size, room;
} line_log;

typedef struct {
    int32_t stop;
    int side;
    line_log highest, lowest;
} sweep;

/* One side of a convex hull; room for a point per tick and two. */
typedef struct {
    point *points;
    int64_t size;
} hull;

static inline int64_t round_at(const line *l, int32_t tick)
{
    return l->y + floor_div(l->dy * (tick - l->x), l->dx);
}

static inline const line *last_line(const line_log *log) { return &log->entries[log->size - 1].is; }

void hapfmt_hull_append(hull *h, int32_t tick, int64_t y);
/* 0, or -1 where memory ran out. sign -1: the tube upside down. */
int hapfmt_sweep_lines(const tube *t, int sign, int32_t first, hull *below, hull *above,
                       sweep *out);
/* How many knots; 0 where the grid has none for the tube, -1 where memory ran out. */
int64_t hapfmt_fewest_linear(const tube *in, const grid *g, int64_t *ticks, int64_t *values);
/* The same for ``count`` tubes of one size, if they need more than one knot. The knots are put at
   the end of ticks [size] and places [size, count]. */
int64_t hapfmt_fewest_joined(const tube *tubes, const grid *grids, int count, int64_t *ticks,
                             int64_t *places);

#endif
